"""Holds that shake: the unit keeps its direction for seconds, and vibrates too much to be still."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imufield.guide.positions import angle_deg
from imufield.guide.refusals import NOT_STILL, Refusal
from imufield.guide.stillness.cells import CellRun, Cells, cells_in
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.limits import largest_activity, vibration_ratio
from imufield.guide.stillness.stretch import Judgement, Phase
from imufield.samples import FloatArray

_BLOCK_S = 1.0  # Its mean force shows the direction, however the unit shakes.
_LEAST_S = 4.0  # A turn, or a hand that puts the unit down, does not keep one direction for so long.
_MOST_S = 60.0  # Nobody holds for longer: the unit is carried, or a vehicle drives.
_KEPT_DEG = 3.0  # Between the directions of blocks: a slow turn by hand makes 10 in the same time.


class RefusedHold(NamedTuple):
    """A stretch that would be a hold if it did not shake, or lasted longer."""

    start_s: float
    mean_raw: FloatArray
    """Of the accelerometer, shape (3,)."""
    refusal: Refusal


class ShakenHolds:
    """Finds them among the cells that are not still; keeps no more than one of them."""

    def __init__(self) -> None:
        self.found: list[RefusedHold] = []
        self._run: list[Cells] = []  # Blocks of one direction.
        self._block = CellRun()
        self._slot = 0  # Of the cell before.

    def follow(self, judgement: Judgement, detector: StillnessDetector, rest_raw: FloatArray) -> None:
        """Take the next cell; ``rest_raw`` is the gyroscope at rest, shape (3,), NaN where not known."""
        cells, row = judgement.cells, judgement.row
        before, self._slot = self._slot, int(cells.slot[row])
        is_broken = bool(self._block) and self._slot - before not in (1, 2)
        if judgement.phase is Phase.STILL or is_broken or not cells.usable[row]:
            if self._run or self._block:
                self.end(detector)
            return
        self._block.add(cells, row)
        if len(self._block) < cells_in(_BLOCK_S):
            return
        block, self._block = self._block.cells(), CellRun()
        if self._run and not self._is_as_before(block, detector, rest_raw):
            self.end(detector)
        self._run.append(block)

    def end(self, detector: StillnessDetector) -> None:
        """End the stretch here, and note it where it is as long as a hold and shakes all the time."""
        run, self._run, self._block = self._run, [], CellRun()
        if not cells_in(_LEAST_S) <= sum(map(len, run)) <= cells_in(_MOST_S):
            return
        variance = np.array([block.variance.mean(axis=0) for block in run])
        if vibration_ratio(variance, detector.limits).min() <= 1:
            return
        mean_raw = np.mean([block.mean[:, :3].mean(axis=0) for block in run], axis=0)
        vibration = np.sqrt(variance.mean(axis=0)) / detector.limits.vibration
        typical = largest_activity(vibration, np.zeros(6), detector.limits, detector.scale)
        self.found.append(RefusedHold(float(run[0].start_s[0]), mean_raw, typical.refusal(NOT_STILL)))

    def _is_as_before(self, block: Cells, detector: StillnessDetector, rest_raw: FloatArray) -> bool:
        """Whether the unit keeps the direction that it had, and does not turn about the vertical."""
        mean, first = (each.mean.mean(axis=0) for each in (block, self._run[0]))
        turned = np.linalg.norm(mean[3:] - rest_raw) * _BLOCK_S
        # Not where the gyroscope or its scale is not known.
        turns = bool(turned > np.radians(_KEPT_DEG) * (detector.scale.gyroscope or np.inf))
        return not turns and angle_deg(detector.scale.up(mean[:3]), detector.scale.up(first[:3])) <= _KEPT_DEG
