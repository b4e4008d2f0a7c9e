"""Is an axis of the accelerometer dead? One that never changes at all while the others show noise and the unit is turned."""

from __future__ import annotations

import numpy as np

from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.cells import Cells
from imufield.guide.checks import Refusal
from imufield.guide.events import RefusalCode
from imufield.guide.noise_floor import NoiseFloor
from imufield.guide.scale import RoughScale
from imufield.samples import AXES

ENOUGH_SIDES = 3
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
        if self._told or self._sides < ENOUGH_SIDES or floor is None or not scale.accelerometer:
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
            RefusalCode.INVALID,
            f"accelerometer axis {axis} is dead: it stayed at {self._low[dead[0]] + 0.0:g} (raw) on {self._sides} sides and in "
            "the turns between",
            "check the instrument, its range, and which column or field the driver or protocol takes for this axis; nothing "
            "can be calibrated without it",
            0.0,
            float(np.delete(floor.sigma[:3], dead).min()),
            "raw unit",
            axis,
        )
