"""A still stretch as it grows: its cells under one set of limits, with hysteresis and dwell time."""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from operator import mul, sub
from typing import NamedTuple

import numpy as np

from imufield.guide.stillness.cells import CellRun, Cells, cells_in
from imufield.guide.stillness.limits import OTHER_SIDE, Allowances, Limits
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale

# The activity that ends a stretch. One begins at 1: without this hysteresis a unit at the limit would flicker.
LEAVE_FACTOR = 2.0
_MEAN_CELLS = 50  # Length of the running mean: it follows a drift of the bias, and a slow creep all the less.


class Phase(Enum):
    """State of the unit by the latest cell."""

    MOVING = "moving"
    SETTLING = "settling"
    STILL = "still"


class Stretch:
    """The cells of a still stretch, oldest first, at most ``longest`` of them."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._kept = CellRun()
        self.mean: list[float] = []
        self.judged = 0  # Cells that belong to the stretch, kept or not.

    def add(self, cells: Cells, row: int, mean: list[float]) -> None:
        """Append one cell and update the running mean: of all cells at first, of the last 50 or so later."""
        if self.judged < self._longest:
            self._kept.add(cells, row)
        self.judged += 1
        if not self.mean:
            self.mean = list(mean)
            return
        share = 1 / min(self.judged, _MEAN_CELLS)
        moved = [old + share * (new - old) for old, new in zip(self.mean, mean, strict=True)]
        # What an axis that is missing in this cell had before, it keeps.
        if math.isnan(sum(moved)):
            moved = [old if math.isnan(now) else now for old, now in zip(self.mean, moved, strict=True)]
        self.mean = moved

    def cells(self) -> Cells:
        """Return the kept cells; at least one was added."""
        return self._kept.cells()

    def cut(self, rows: slice) -> None:
        """Keep only some of the kept cells, at least one, and compute the mean of these."""
        whole, cells = self.judged == len(self), self.cells()[rows]
        self._kept = CellRun()
        self._kept.add(cells, 0, len(cells))
        self.judged = len(cells) if whole else self.judged - rows.start
        self.mean = np.nanmean(cells.mean, axis=0).tolist() if whole else self.mean

    def __len__(self) -> int:
        return min(self.judged, self._longest)


class Judgement(NamedTuple):
    """What one cell meant."""

    phase: Phase
    cells: Cells
    row: int
    reference: list[float]
    """Running mean of the stretch before this cell, raw rates (6); empty outside a stretch."""
    ended: Stretch | None = None
    """The stretch that this cell ended."""
    limits: Limits | None = None
    """Those that the cell was measured against; None: those of a placed unit."""


class Standard(NamedTuple):
    """What a cell is compared with, the limits also in the form that the loop over cells needs."""

    limits: Limits
    change_weight: list[float]
    """1 / change, 0 where there is no gyroscope."""
    usual_samples: float
    raw_zero: list[float]
    """Raw output of the accelerometer at zero input (3): a side is told by what is above it."""

    @classmethod
    def of(cls, floor: NoiseFloor, limits: Limits, scale: RoughScale) -> Standard:
        """Return the standard of limits that were made for a noise floor."""
        weight = np.where(np.isnan(limits.change), 0.0, 1 / limits.change)
        return cls(limits, weight.tolist(), floor.samples_per_cell, scale.raw_zero.tolist())


_NO_STANDARD = Standard(Limits(np.full(6, np.inf), np.full(6, np.inf), 1.0, 1.0), [0.0] * 6, 0.0, [0.0] * 3)


JudgedCell = tuple[Cells, int, float, list[float]]
"""One cell: its block and row there, its vibration ratio, its mean. No class: one is made for each cell."""


class Tracker:
    """Follows a stream of cells under one set of limits: moving, settling or still, and the stretch in progress."""

    def __init__(self, allowances: Allowances, longest_s: float) -> None:
        self.allowances = allowances
        self.standard = _NO_STANDARD
        self.phase = Phase.MOVING
        self._longest = cells_in(longest_s)
        self._dwell = cells_in(allowances.dwell_s)
        self.stretch = Stretch(self._longest)
        # Cells since the last stretch ended, kept for the reach back.
        self._passed: deque[JudgedCell] = deque(maxlen=cells_in(allowances.reach_back_s))

    def restart(self) -> None:
        """Forget the stretch and what came before it."""
        self._drop()
        self._passed.clear()

    def _drop(self) -> None:
        self.stretch = Stretch(self._longest)
        self.phase = Phase.MOVING

    def follow(self, cell: JudgedCell, *, unbroken: bool, rest: list[float]) -> Judgement:
        """Judge one cell.

        Parameters
        ----------
        cell : JudgedCell
        unbroken : bool
            Whether it follows the one before.
        rest : list of float
            Raw rates (6) of the last stretch that shows the bias of the gyroscope; empty without a gyroscope.
        """
        cells, row, vibration, mean = cell
        stretch, was_still = self.stretch, self.phase is Phase.STILL
        reference, limit = stretch.mean, LEAVE_FACTOR if was_still else 1.0
        goes_on = unbroken and bool(reference) and vibration <= limit and max(self._changes(mean, reference)) <= limit
        ended = stretch if was_still and not goes_on else None
        if ended is not None or not unbroken:
            self._passed.clear()
        if not was_still:
            self._passed.append(cell)
        if not goes_on:
            # What it showed of the rest is learned with the next cell: a turn on its side is none of another side.
            self._begin(cell, stretch.mean if rest and was_still else rest)
        else:
            stretch.add(cells, row, mean)
            if not was_still and stretch.judged >= self._dwell:
                self.phase = Phase.STILL
                self._reach_back()
        return Judgement(self.phase, cells, row, reference, ended=ended, limits=self.standard.limits)

    def _reach_back(self) -> None:
        """Add the cells before the stretch to it, the nearest first, up to one that would have ended it."""
        passed = list(self._passed)
        first = begin = max(len(passed) - self.stretch.judged, 0)
        for _, _, vibration, mean in reversed(passed[:first]):
            if max(vibration, *self._changes(mean, self.stretch.mean)) > LEAVE_FACTOR:
                break
            begin -= 1
        self._passed.clear()
        if begin < first:
            self.stretch = Stretch(self._longest)
            for cells, row, _, mean in passed[begin:]:
                self.stretch.add(cells, row, mean)

    def _begin(self, cell: JudgedCell, rest: list[float]) -> None:
        """Begin a candidate with this cell if it could be the first of a stretch."""
        if self.stretch.judged:
            self._drop()
        cells, row, vibration, mean = cell
        if vibration > 1:
            return
        limit, offset = self.standard.limits.gyroscope_offset, 0.0
        if rest:
            _, offset = self._changes(mean, rest)
            if math.dist(mean[:3], rest[:3]) > OTHER_SIDE * math.dist(rest[:3], self.standard.raw_zero):
                limit = self.standard.limits.offset_on_other_side
        # A cell without a value of the gyroscope, NaN, is judged by the accelerometer alone.
        if not offset > limit:
            self.stretch.add(cells, row, mean)
            self.phase = Phase.SETTLING

    def _changes(self, mean: list[float], before: list[float]) -> tuple[float, float]:
        """Return the change ratios of the two triads from one mean to another."""
        x, y, z, p, q, r = map(mul, map(sub, mean, before), self.standard.change_weight)
        return math.hypot(x, y, z), math.hypot(p, q, r)
