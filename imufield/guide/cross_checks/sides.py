"""Does the accelerometer show the sides that were asked for? Axis signs from the sides alone, without a gyroscope.

A person who follows the guide shows the side that is asked for. Where the axes of the driver are mirrored or exchanged the
guide measures another side each time, and one signed permutation explains all of them: four such sides are enough. Or the same
side is asked for repeatedly, and the measured one is another that is done already. A person with an order of their own shows
other sides than those asked for, too; hardly ever ones that a single permutation explains, but the sentence allows for it. A
triad that is negated as a whole, which the moves cannot show, is found here.

Also a dead axis of the accelerometer: one that never changes at all while the others show noise and the unit is turned.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.rotation import signed_permutations
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide import refusals
from imufield.guide.cross_checks.axes import axes_words
from imufield.guide.positions import angle_deg, nearest_cube_direction
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray

_SIDES_FOR_A_DEAD_AXIS = 3  # Two may show the same value by chance, where the output is coarse.
_TURNED_M_S2 = 0.8 * STANDARD_GRAVITY_M_S2  # Span of another axis that proves that the unit was turned.
ENOUGH_SIDES = 4  # Fewer are often explained by several permutations.
_ENOUGH_TIMES = 3  # The same answer to the same question is no slip then.
_LEFT_DEG = 45.0  # A side was left where the unit points farther from it: more than a person moves in putting it right.
_NEAR_DEG = 25.0  # Placement of 15 degrees, and the error of an uncalibrated accelerometer.


class DeadAxis:
    """Follows the still stretches for an axis of the accelerometer that never changes."""

    def __init__(self) -> None:
        self._sides = 0
        self._told = False

    def leave_side(
        self, extremes: tuple[FloatArray, FloatArray], floor: NoiseFloor | None, scale: RoughScale
    ) -> Refusal | None:
        """Add the end of a still stretch, with the extremes of all outputs so far; return the refusal of a dead axis, once."""
        self._sides += 1
        if self._told or self._sides < _SIDES_FOR_A_DEAD_AXIS or floor is None or not scale.accelerometer:
            return None
        low, high = (end[:3] for end in extremes)
        span = high - low
        dead = np.flatnonzero(span == 0)
        # Without noise an axis may stay at one step of the output for all turns about it.
        noise = np.delete(floor.sigma[:3], dead)
        if len(dead) != 1 or not (noise > 0).all() or not span.max() > _TURNED_M_S2 * scale.accelerometer:
            return None
        self._told = True
        reading = float(low[dead[0]] + 0.0)  # Minus zero reads as zero.
        axis = AXES[int(dead[0])]
        return refusals.DEAD_AXIS.refusal(0.0, float(noise.min()), axis=axis, reading=reading, sides=self._sides)


class SidesCheck:
    """Follows the sides that were not those asked for, since the last one that was."""

    def __init__(self) -> None:
        self._sides: list[tuple[FloatArray, FloatArray]] = []  # Up as asked for and as shown, unit vectors in the body.
        self._left = True
        # Arrangements of the axes that agree with all sides shown as asked; once it is only one, the axes are right.
        self._could_be = signed_permutations()

    def follow(self, direction: FloatArray) -> None:
        """Add a direction of up while the unit moves: a side counts again only after it was left."""
        if self._sides and not self._left:
            self._left = angle_deg(self._sides[-1][1], direction) > _LEFT_DEG

    def note(self, asked: FloatArray, shown: FloatArray, *, chosen: bool = True) -> Refusal | None:
        """Add a side, unit vectors (3,) of up in the body; return the refusal where the axes are contradicted.

        ``chosen`` is False where the side asked for is the one that the accelerometer showed, which proves nothing.
        """
        if angle_deg(asked, shown) <= _NEAR_DEG:
            self._sides = []
            if chosen:
                along = np.einsum("i,pij,j->p", asked, self._could_be, asked)
                self._could_be = self._could_be[along >= np.cos(np.radians(_NEAR_DEG))]
            return None
        if self._sides and not self._left:
            return None
        self._sides.append((asked, shown))
        self._left = False
        refusal = self._check_same_side() or self._check_permutation()
        if refusal is not None:
            self._sides = []
        return refusal

    def _check_same_side(self) -> Refusal | None:
        """Refuse the same wrong side, shown several times for the same one asked for."""
        last = self._sides[-_ENOUGH_TIMES:]
        first_asked, first_shown = last[0]
        same = all(np.allclose(asked, first_asked) and angle_deg(shown, first_shown) <= _NEAR_DEG for asked, shown in last)
        if len(last) < _ENOUGH_TIMES or not same:
            return None
        asked_name, shown_name = (nearest_cube_direction(side) for side in last[0])
        if len(self._could_be) == 1:
            return refusals.OTHER_SIDE.refusal(angle_deg(*last[-1]), _NEAR_DEG, asked=asked_name, shown=shown_name)
        times = float(_ENOUGH_TIMES)
        return refusals.SAME_SIDE_AGAIN.refusal(times, times, asked=asked_name, shown=shown_name)

    def _check_permutation(self) -> Refusal | None:
        """Refuse sides of which a single signed permutation turns all that were shown into those asked for."""
        if len(self._could_be) <= 1 or len(self._sides) < ENOUGH_SIDES:
            return None
        asked, shown = (np.array(sides) for sides in zip(*self._sides, strict=True))
        permutations = signed_permutations()
        along = np.einsum("pij,nj,ni->pn", permutations, shown, asked)
        fitting = np.flatnonzero((along >= np.cos(np.radians(_NEAR_DEG))).all(axis=1))
        if len(fitting) != 1:
            return None
        axes, enough = axes_words(permutations[fitting[0]]), float(ENOUGH_SIDES)
        return refusals.SIDES_EXPLAINED.refusal(enough, enough, count=len(self._sides), axes=axes)
