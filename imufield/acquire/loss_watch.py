"""Losses that only the host clock shows: whole wraps of a counter, or any where there is no counter.

Such a loss makes the sample clock fall behind arrival, and stay behind. So does a host that hands over old data late (it
catches up within a few reads) and an instrument, or its emulator, that runs slow (it falls behind little by little).
Blocks that come late are therefore held back until one of these is clear:

* the lag has gone: late data, nothing is missing;
* it has lasted, and the stream itself shows a place where samples are missing and the bytes do not account for them:
  loss there;
* it has lasted longer, and began with a silence as long as the loss: loss there (the samples left no trace);
* it has lasted, and none of that: the clocks drift, nothing is missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.assembly import RawBlock
from imufield.acquire.host_baseline import HostBaseline
from imufield.samples import FloatArray, Status

_DECIDE_WITH_FAULT_S, _DECIDE_WITHOUT_S = 0.25, 0.5
"""How long a lag must last. A loaded host catches up within a few reads of 10 to 50 ms."""
_SILENCE = 0.75
"""Part of the loss that must have been silence; the rest allows for a read that was under way."""


@dataclass(frozen=True, slots=True)
class TimedBlock:
    """A block with its time. The arrays are changed in place when a loss before them is found."""

    block: RawBlock
    time_s: FloatArray
    flags: NDArray[np.uint32]
    fault: NDArray[np.bool_]
    """Where samples are missing that the bytes passed over do not account for. Shape (n,)."""
    arrival_s: float

    def part(self, begin: int, end: int, arrival_s: float) -> TimedBlock:
        """Return some of the samples, which arrived by ``arrival_s``; the arrays are views."""
        rows = slice(begin, end)
        return TimedBlock(self.block[rows], self.time_s[rows], self.flags[rows], self.fault[rows], arrival_s)


class LossWatch:
    """Holds back late blocks and finds how many samples are missing before them.

    Parameters
    ----------
    unit_s : float
        Losses are multiples of this, s: one wrap of the counter, or one sample.
    smallest_s : float
        The smallest lag that counts as loss, s.
    """

    def __init__(self, unit_s: float, smallest_s: float) -> None:
        self.baseline = HostBaseline()
        self.lost_units = 0
        """Units found missing so far; the sample clock behind them must move on by so much."""
        self.gaps = 0
        """Gaps found that were not flagged before."""
        self._unit_s = unit_s
        self._smallest_s = smallest_s
        self._held: list[tuple[TimedBlock, float]] = []
        self._last_arrival_s = math.nan
        self._silence_s = 0.0

    def passes(self, arrival_s: float, last_s: float) -> bool:
        """Take note of a block up to ``last_s`` if it is in time and nothing is held back; return whether it was.

        The same as ``push`` for nearly all blocks, without making them.
        """
        if self._held or not math.isfinite(arrival_s):
            return not self._held
        if self.baseline.lag_s(arrival_s, last_s) > self._smallest_s:
            return False
        self._last_arrival_s = arrival_s
        self.baseline.add(arrival_s, last_s)
        return True

    def push(self, timed: TimedBlock) -> list[TimedBlock]:
        """Return the blocks whose time is settled now, in order."""
        if not math.isfinite(timed.arrival_s):
            return [*self.finish(), timed]
        lag_s = self.baseline.lag_s(timed.arrival_s, float(timed.time_s[-1]))
        if not self._held:
            self._silence_s = timed.arrival_s - self._last_arrival_s
        self._last_arrival_s = timed.arrival_s
        if lag_s <= self._smallest_s:
            self.baseline.add(timed.arrival_s, float(timed.time_s[-1]))
            return [*self._release(), timed]
        self._held.append((timed, lag_s))
        waited_s = timed.arrival_s - self._held[0][0].arrival_s
        if waited_s < (_DECIDE_WITH_FAULT_S if self._fault() else _DECIDE_WITHOUT_S):
            return []
        return self._decide()

    def finish(self) -> list[TimedBlock]:
        """Return what is held back; nothing with an arrival time will follow."""
        if not self._held:
            return []
        waited_s = self._held[-1][0].arrival_s - self._held[0][0].arrival_s
        return self._decide() if self._fault() or waited_s >= _DECIDE_WITH_FAULT_S else self._release()

    def _release(self) -> list[TimedBlock]:
        held, self._held = self._held, []
        return [timed for timed, _ in held]

    def _decide(self) -> list[TimedBlock]:
        units = round(min(lag_s for _, lag_s in self._held) / self._unit_s)
        place = self._fault()
        if place is None and self._silence_s >= _SILENCE * units * self._unit_s:
            place = (0, 0)
        held = self._release()
        if place is None:
            # The clocks drift faster than expected: begin again from here.
            self.baseline = HostBaseline()
        else:
            self._insert(held, place, units)
        for timed in held:
            self.baseline.add(timed.arrival_s, float(timed.time_s[-1]))
        return held

    def _insert(self, held: list[TimedBlock], place: tuple[int, int], units: int) -> None:
        """Move all samples from ``place`` on by the loss."""
        number, row = place
        for timed in held[number:]:
            timed.time_s[row if timed is held[number] else 0 :] += units * self._unit_s
        flags = held[number].flags
        self.gaps += int(flags[row] & np.uint32(Status.AFTER_GAP | Status.GAP_ESTIMATED) == 0)
        flags[row] = flags[row] & ~np.uint32(Status.AFTER_GAP) | np.uint32(Status.GAP_ESTIMATED)
        self.lost_units += units

    def _fault(self) -> tuple[int, int] | None:
        """Return block and sample of the first fault in what is held; None where there is none."""
        for number, (timed, _) in enumerate(self._held):
            rows = np.flatnonzero(timed.fault)
            if len(rows):
                return number, int(rows[0])
        return None
