"""Does the accelerometer show the sides that were asked for? Axis signs from the sides alone, without a gyroscope.

Whoever follows the guide shows what is asked. Where the axes of the driver are mirrored or exchanged the guide sees something
else, each time, and one signed permutation explains all of it: after four such sides it is found. Or the same side is asked for
again and again, and what is seen is another one that is measured already. Somebody who goes an order of his own shows other
sides than those asked for, too; hardly ever ones that a single permutation explains, but the sentence leaves room for it. A
triad negated as a whole, which the moves cannot show, is seen here.

Is an axis of the accelerometer dead? One that never changes at all while the others show noise and the unit is turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.cross_checks.axes import signed_permutations
from imufield.guide.events import RefusalCode
from imufield.guide.hold.checks import Refusal
from imufield.guide.positions import nearest_cube_direction
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray

_SIDES_FOR_A_DEAD_AXIS = 3
TURNED_M_S2 = 0.8 * STANDARD_GRAVITY_M_S2
"""Span of another axis that tells that the unit was turned."""


class DeadAxis:
    """Remembers what each axis of the accelerometer has shown."""

    def __init__(self) -> None:
        self._low = np.full(3, np.inf)
        self._high = np.full(3, -np.inf)
        self._sides = 0
        self._told = False

    def follow(self, cells: Cells, row: int) -> None:
        """Take a cell."""
        self._low = np.fmin(self._low, cells.low[row, :3])
        self._high = np.fmax(self._high, cells.high[row, :3])

    def leave_side(self, floor: NoiseFloor | None, scale: RoughScale) -> Refusal | None:
        """Take the end of a still stretch; return what to say where an axis is dead, once."""
        self._sides += 1
        if self._told or self._sides < _SIDES_FOR_A_DEAD_AXIS or floor is None or not scale.accelerometer:
            return None
        span = self._high - self._low
        dead = np.flatnonzero(span == 0)
        # Without noise an axis may stay at one step of the output for all turns about it.
        noisy = np.delete(floor.sigma[:3], dead) > 0
        if len(dead) != 1 or not noisy.all() or not span.max() > TURNED_M_S2 * scale.accelerometer:
            return None
        self._told = True
        axis = AXES[int(dead[0])]
        return Refusal(
            reason=RefusalCode.INVALID,
            words=f"accelerometer axis {axis} is dead: it stayed at {self._low[dead[0]] + 0.0:g} (raw) on {self._sides} sides "
            "and in the turns between",
            remedy="check the instrument, its range, and which column or field the driver or protocol takes for this axis; "
            "nothing can be calibrated without it",
            measured=0.0,
            limit=float(np.delete(floor.sigma[:3], dead).min()),
            unit="raw unit",
            axis=axis,
        )


ENOUGH_SIDES = 4
ENOUGH_TIMES = 3
"""The same answer to the same question."""
LEFT_DEG = 45.0
NEAR_DEG = 25.0
"""Placement of 15 degrees, and what an uncalibrated accelerometer misjudges."""


@dataclass(frozen=True, slots=True)
class _Side:
    asked: FloatArray
    shown: FloatArray


class SidesCheck:
    """Remembers the sides that were not those asked for, since the last one that was."""

    def __init__(self) -> None:
        self._sides: list[_Side] = []
        self._left = True
        # Arrangements of the axes that agree with all sides shown as asked; once it is only one, the axes are right.
        self._could_be = signed_permutations()

    def follow(self, direction: FloatArray) -> None:
        """Take where up is while the unit moves: a side counts again only after it was left."""
        if self._sides and not self._left:
            self._left = _angle_deg(self._sides[-1].shown, direction) > LEFT_DEG

    def note(self, asked: FloatArray, shown: FloatArray, *, chosen: bool = True) -> Refusal | None:
        """Take a side, unit vectors (3,) of up in the body; return what to say where the axes are contradicted.

        ``chosen`` is False where what is asked for was taken from what the accelerometer saw, which proves nothing.
        """
        if _angle_deg(asked, shown) <= NEAR_DEG:
            self._sides = []
            if chosen:
                along = np.einsum("i,pij,j->p", asked, self._could_be, asked)
                self._could_be = self._could_be[along >= np.cos(np.radians(NEAR_DEG))]
            return None
        if self._sides and not self._left:
            return None
        self._sides.append(_Side(asked, shown))
        self._left = False
        refusal = self._same_again() or self._all_explained()
        if refusal is not None:
            self._sides = []
        return refusal

    def _same_again(self) -> Refusal | None:
        last = self._sides[-ENOUGH_TIMES:]
        same = all(np.allclose(one.asked, last[0].asked) and _angle_deg(one.shown, last[0].shown) <= NEAR_DEG for one in last)
        if len(last) < ENOUGH_TIMES or not same:
            return None
        asked, seen = (nearest_cube_direction(side) for side in (last[0].asked, last[0].shown))
        if len(self._could_be) == 1:
            angle_deg = _angle_deg(last[-1].asked, last[-1].shown)
            return Refusal(
                reason=RefusalCode.OTHER_SIDE,
                words=f"the unit is on another side than asked: {seen} is up, {asked} up is asked for",
                remedy=f"bring it to {asked} up, or to any other pending position",
                measured=angle_deg,
                limit=NEAR_DEG,
                unit="deg",
            )
        return _refusal(f"{ENOUGH_TIMES} times {asked} up was asked for and the accelerometer saw {seen} up", ENOUGH_TIMES)

    def _all_explained(self) -> Refusal | None:
        open_still = len(self._could_be) > 1 and len(self._sides) >= ENOUGH_SIDES
        found = self._explanation() if open_still else None
        if found is None:
            return None
        axes = ", ".join(
            f"{AXES[row]} = {'+' if values.sum() > 0 else '-'}{AXES[int(np.abs(values).argmax())]}"
            for row, values in enumerate(found)
        )
        count = len(self._sides)
        words = f"the last {count} sides were none of those asked for, but all would be with the accelerometer's {axes}"
        return _refusal(words, ENOUGH_SIDES)

    def _explanation(self) -> FloatArray | None:
        """Return the only signed permutation that turns all that was shown into what was asked, None without one."""
        asked = np.array([side.asked for side in self._sides])
        shown = np.array([side.shown for side in self._sides])
        permutations = signed_permutations()
        along = np.einsum("pij,nj,ni->pn", permutations, shown, asked)
        fitting = np.flatnonzero((along >= np.cos(np.radians(NEAR_DEG))).all(axis=1))
        return permutations[fitting[0]] if len(fitting) == 1 else None


def _refusal(words: str, limit: int) -> Refusal:
    return Refusal(
        reason=RefusalCode.AXES,
        words=words,
        remedy="if you showed what was asked for, axes or signs in the driver or protocol are wrong: quit and correct them; "
        "if you go your own way, go on",
        measured=float(limit),
        limit=float(limit),
        unit="sides",
    )


def _angle_deg(first: FloatArray, second: FloatArray) -> float:
    return float(np.degrees(np.arccos(np.clip(first @ second, -1.0, 1.0))))
