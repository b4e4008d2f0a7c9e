"""Whole turns for the gyroscope: which are wanted, and whether a move between two stills was one (docs/gyroscope.md).

Rolled edge over edge about a horizontal axis, gravity itself closes a turn; on a turntable or flat surface the axis is vertical
and the stop must be the same. Here a turn is only recognised, from the uncalibrated gyroscope; its exact angle is the business
of ``calibrate``, which finds the move by the times that the event holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imufield.guide.events import RefusalCode
from imufield.guide.hold.checks import Refusal
from imufield.guide.positions import angle_deg
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray

HORIZONTAL = "horizontal"
VERTICAL = "vertical"
NOT_A_TURN_DEG = 180.0
"""A move that turned by less is the way to another side."""
WHOLE_DEG = 45.0
"""Largest distance from whole turns: an uncalibrated scale and a bad stop; what is right is decided when solving."""
TILT_DEG = 20.0
ASIDE_DEG = 60.0
"""Net turn about the other axes."""


@dataclass(frozen=True, slots=True)
class WantedTurn:
    """One whole turn about a body axis."""

    axis: int
    sense: int
    about: str

    @property
    def words(self) -> str:
        """What to do."""
        name = AXES[self.axis]
        first, second = (AXES[(self.axis + k) % 3] for k in (1, 2))
        way = f"{first} goes towards {second}" if self.sense > 0 else f"{second} goes towards {first}"
        if self.about == HORIZONTAL:
            return f"lay axis {name} level, roll it edge over edge about {name} ({way}), one whole turn, back on the same side"
        up = "up" if self.sense > 0 else "up, the other way round"
        return f"{name} {up}: turn it on the table against a stop, one whole turn ({way}), back to the stop"


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeTurn:
    """A move that was whole turns."""

    wanted: WantedTurn
    turns: int
    start_s: float
    end_s: float
    turned_deg: float
    tilt_deg: float


def plan_turns(about: str | None, each_way: int) -> list[WantedTurn]:
    """Return the turns of a session: each axis, both ways, ``each_way`` times, ways alternating."""
    if about is None:
        return []
    return [WantedTurn(axis, sense, about) for axis in range(3) for _ in range(each_way) for sense in (1, -1)]


class TurnFollower:
    """Adds up the gyroscope from one still to the next.

    Parameters
    ----------
    cell_s : float
    """

    def __init__(self, cell_s: float) -> None:
        self._cell_s = cell_s
        self._up: FloatArray | None = None
        self._bias = np.zeros(3)
        self._angle = np.zeros(3)
        self._slot: int | None = None
        self._start_s = math.nan
        self._end_s = math.nan

    def begin(self, still_mean: list[float], cells: Cells, row: int, scale: RoughScale) -> None:
        """Begin with the mean of the still before (6 raw rates) and the first cell of motion."""
        mean = np.array(still_mean)
        self._up, self._bias = scale.specific_force(mean[:3]), mean[3:]
        self._angle, self._slot = np.zeros(3), None
        self._start_s = float(cells.start_s[row])
        self.follow(cells, row, scale)

    def follow(self, cells: Cells, row: int, scale: RoughScale) -> None:
        """Take one cell of motion."""
        if self._up is None or not scale.gyroscope:
            return
        slot = int(cells.slot[row])
        steps = 1 if self._slot is None else slot - self._slot
        self._slot, self._end_s = slot, float(cells.end_s[row])
        rate = (cells.mean[row, 3:] - self._bias) / scale.gyroscope
        self._angle = self._angle + np.where(np.isfinite(rate), rate, 0.0) * self._cell_s * steps

    def end(self, still_mean: list[float], left: list[WantedTurn], scale: RoughScale) -> MadeTurn | Refusal | None:
        """Return what the move was, now that the unit is still: a turn, a bad one, or only a move (None)."""
        before, self._up = self._up, None
        if before is None or not scale.gyroscope:
            return None
        angle = np.degrees(self._angle)
        axis = int(np.argmax(np.abs(angle)))
        if abs(angle[axis]) < NOT_A_TURN_DEG:
            return None
        tilt = angle_deg(before, scale.specific_force(np.array(still_mean[:3])))
        turns = round(abs(angle[axis]) / 360.0) * int(np.sign(angle[axis]))
        off = abs(abs(angle[axis]) - 360.0 * abs(turns)) if turns else abs(angle[axis])
        aside = float(np.linalg.norm(np.delete(angle, axis)))
        up = before / np.linalg.norm(before)
        about = VERTICAL if abs(float(up[axis])) > math.cos(math.radians(TILT_DEG)) else HORIZONTAL
        fitting = [one for one in left if (one.axis, one.sense, one.about) == (axis, int(np.sign(turns)), about)]
        if off > WHOLE_DEG or aside > ASIDE_DEG or tilt > TILT_DEG:
            return _not_whole(AXES[axis], float(angle[axis]), tilt, aside)
        if not fitting:
            return None
        return MadeTurn(
            wanted=fitting[0],
            turns=turns,
            start_s=self._start_s,
            end_s=self._end_s,
            turned_deg=float(angle[axis]),
            tilt_deg=tilt,
        )


def _not_whole(axis: str, angle: float, tilt: float, aside: float) -> Refusal:
    if tilt > TILT_DEG:
        found, measured, limit = f"it came to rest {tilt:.0f} deg from where it began", tilt, TILT_DEG
    elif aside > ASIDE_DEG:
        found, measured, limit = f"it turned by {aside:.0f} deg about the other axes", aside, ASIDE_DEG
    else:
        measured, limit = abs(abs(angle) - 360.0 * max(round(abs(angle) / 360.0), 1)), WHOLE_DEG
        found = f"it turned by {angle:.0f} deg, {measured:.0f} deg from whole turns"
    return Refusal(
        reason=RefusalCode.NOT_WHOLE,
        words=f"no whole turn about {axis}: {found} (limit {limit:g} deg)",
        remedy="begin on a side, turn by a whole turn about one axis, and end on the same side",
        measured=measured,
        limit=limit,
        unit="deg",
        axis=axis,
    )
