"""Where the unit rested last and whether it was moved since; and whether it lingers without becoming still."""

from __future__ import annotations

import math

import numpy as np

from imufield.guide.positions import angle_deg
from imufield.guide.stillness.cells import CELL_S
from imufield.samples import FloatArray

# A unit that moved for less than both was not lifted: it rests where it was.
_MOVED_S = 1.0
_MOVED_DEG = 10.0
# Nobody puts a unit down again within this while the link is gone; one that nobody touched stays within a tenth of it.
_MOVED_UNSEEN_DEG = 0.5
# A unit that keeps its direction this long without becoming still: somebody waits for the guide.
_LINGER_S = 5.0
_LINGER_COSINE = math.cos(math.radians(5.0))


class Resting:
    """The position accepted last, as long as the unit may still be there."""

    def __init__(self) -> None:
        self.position: int | None = None
        self._direction: FloatArray | None = None
        self._moved_cells = 0
        self._moved_deg = 0.0
        self._unobserved = False  # Samples are missing since: it may have been moved meanwhile.

    def begin(self, position: int, direction: FloatArray) -> None:
        """Remember where the unit rests; ``direction`` is that of up in the body, unit vector (3,)."""
        self.position, self._direction, self._unobserved = position, direction, False
        # The way here was observed already; only a move from here makes the next rest another one.
        self.lift()

    def lift(self) -> None:
        """Begin to watch whether the unit is lifted or only knocked."""
        self._moved_cells, self._moved_deg = 0, 0.0

    def lose_link(self) -> None:
        """Remember that samples are missing."""
        self._unobserved = True

    def forget(self) -> None:
        """Let the unit be measured again where it is."""
        self.position = None

    def follow(self, direction: FloatArray, *, moving: bool) -> None:
        """Add a cell that is not still, and where it has up."""
        self._moved_cells += moving
        if self._direction is not None:
            self._moved_deg = max(self._moved_deg, angle_deg(self._direction, direction))

    def check(self, direction: FloatArray) -> int | None:
        """Return the position where the unit still rests, forgotten where it was moved; ``direction`` is that of up now."""
        lifted = self._moved_cells * CELL_S > _MOVED_S or self._moved_deg > _MOVED_DEG
        before = self._direction
        if lifted or (self._unobserved and before is not None and angle_deg(before, direction) > _MOVED_UNSEEN_DEG):
            self.position = None
        return self.position


class Lingering:
    """Watches for a unit that keeps its direction and does not become still."""

    def __init__(self) -> None:
        self._direction: FloatArray | None = None
        self._from_s = math.nan

    def forget(self) -> None:
        """Begin anew."""
        self._direction = None

    def lasts(self, now_s: float, direction: FloatArray) -> bool:
        """Add where up is in the body, unit vector (3,); return whether the unit has lingered there for long enough."""
        before = self._direction
        # Written so that NaN begins anew, and so does a clock that was set back.
        if before is None or not now_s >= self._from_s or not float(np.dot(before, direction)) > _LINGER_COSINE:
            self._direction, self._from_s = direction, now_s
            return False
        return now_s - self._from_s > _LINGER_S
