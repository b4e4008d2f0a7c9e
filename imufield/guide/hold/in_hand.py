"""A hold in the hand: its samples, which turns are cut off at both ends, and its mean."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from imufield.calibrate.model.observations import ROUNDING
from imufield.guide.hold.hand_mean import HandMean, mean_in_hand
from imufield.guide.hold.observe import knocks_of
from imufield.guide.stillness.cells import Cells, cells_in
from imufield.guide.stillness.detector import StillnessDetector
from imufield.samples import CELL_S, Samples, concatenate

MOST_SAMPLES = 1_200_000
"""Whatever the rate: 100 MB. At 2000 Hz it is the 600 s in which cells wait for the first rest."""
HAND_GUARD_S = 1.5
"""Cut off at both ends of a hold in the hand: an arm comes to rest slowly, and a slow turn begins below its sway."""


class SampleHistory:
    """Keeps blocks of samples for a while."""

    def __init__(self) -> None:
        self._blocks: deque[Samples] = deque()
        self._count = 0

    def add(self, samples: Samples) -> None:
        """Append a block, oldest first; an empty one is none."""
        if len(samples):
            self._blocks.append(samples)
            self._count += len(samples)

    def prune(self, keep_s: float) -> None:
        """Discard what is older than that behind the newest sample; call it when the newest block has been used."""
        while len(self._blocks) > 1:
            oldest, newest = self._blocks[0], self._blocks[-1]
            too_old = float(oldest.time_s[-1]) < float(newest.time_s[-1]) - keep_s
            if not too_old and self._count - len(oldest) <= MOST_SAMPLES:
                return
            self._count -= len(self._blocks.popleft())

    def clear(self) -> None:
        """Forget everything: another clock begins."""
        self._blocks.clear()
        self._count = 0

    def between(self, start_s: float, end_s: float) -> Samples | None:
        """Return the samples of a stretch, both ends included, None where there are none."""
        parts = []
        for block in self._blocks:
            first, last = block.time_s.searchsorted([start_s, end_s], side="left")
            last += int(last < len(block) and block.time_s[last] == end_s)
            if last > first:
                parts.append(block[int(first) : int(last)])
        return concatenate(parts) if parts else None


def trim_in_hand(cells: Cells, rows: slice, detector: StillnessDetector) -> Cells:
    """Return the cells of a hold in the hand: between the turns by its own standard, with wider guard bands.

    Parameters
    ----------
    cells : Cells
        Of the whole stretch.
    rows : slice
        Those that would count on a table.
    detector : StillnessDetector
    """
    guard, edges = cells_in(HAND_GUARD_S), detector.hold_edges(cells)
    start = max(rows.start, edges.start + guard)
    return cells[start : max(min(rows.stop, edges.stop - guard), start)]


def measure_in_hand(cells: Cells, history: SampleHistory, detector: StillnessDetector) -> HandMean | None:
    """Return the mean of a trimmed hold; None where it cannot be told, or the history does not reach back to its begin."""
    samples = history.between(float(cells.start_s[0]), float(cells.end_s[-1]))
    if samples is None or samples.time_s[0] >= cells.end_s[0] or detector.floor is None:
        return None
    density = detector.floor.cell_sigma * math.sqrt(CELL_S)
    # What is rounded to one code on a table is not in the hand.
    step = cells.step[:, 3:].min(axis=0)
    rounding = ROUNDING * np.where(np.isfinite(step), step, 0.0) * math.sqrt(CELL_S / detector.floor.samples_per_cell)
    density[3:] = np.maximum(density[3:], rounding)
    return mean_in_hand(samples, detector.scale, density, knocks_of(cells, detector.limits))
