"""Lag of the sample clock behind the host, and the losses that it alone shows: wraps of a counter or a stamp, or any without.

Such a loss makes the sample clock fall behind arrival by the loss, and stay behind by just that. Much else makes it fall
behind, too, with nothing missing: a host that stood still and hands over old data late, a cable or network that is slower
than it was, an instrument (or its emulator) that runs slow. What tells them apart is the *lag*, arrival minus sample clock
above the line of earliest arrivals. Its least value over a while is free of the delays of single reads, and it

* goes away again where data are late only: bytes that still wait in some buffer come faster than they are made;
* rises on and on where the instrument runs slow;
* stands where samples are missing, and where a cable has become slower for good.

So blocks that come late are kept back, and a loss is believed when the least lag has stood still for a while and

* the stream itself shows a place where samples are missing that the bytes there do not account for, and the lag is a whole
  number of units or began with a silence as long as itself (an instrument that was restarted); or
* the stream shows nothing (one loss in 256 leaves no trace in a counter of 8 bits), but it was silent for as long as the
  loss, and the lag is a whole number of units to within a few ms. Where arrival jitters more than that, or where the unit
  is a single sample and less than a second is missing, nobody can tell it from a slower cable, and nothing is counted.

Otherwise the lag is no loss and the line begins anew. An arrival that is earlier than a loss allows disproves it: the count
is taken back. The time of samples is not, as it cannot run backwards; it has a flagged gap at that place.

``HostBaseline`` is how far arrival at the host lags behind the sample clock, compared with how far it must.

Arrival is never early, but often late: the operating system hands over old data in bursts. The lowest of
(arrival - sample clock) in each quarter second is therefore the true relation of the two clocks, and the slope of those
minima is the error of the nominal rate. A lag above that line that goes away was a burst; one that stays means that the
sample clock is behind, so samples are missing.

That slope is the one of the line below all minima that lies nearest to them all [1]_: the edge of their lower convex hull that
spans the middle of the time. Late data lie above it wherever they are, those that had waited before the first read included.

References
----------
.. [1] S. B. Moon, P. Skelly and D. Towsley, "Estimation and removal of clock skew from network delay measurements", IEEE
   INFOCOM 1999, section IV.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.assembly import RawBlock
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, Status

_BUCKET_S = 0.25
_WINDOW_BUCKETS = 16  # 4 s: crystals of 100 ppm drift 0.4 ms in it even before the slope is known.
_LEAST_BUCKETS = 5  # 1 s: minima that are known before their jitter is.
# A 4 % slow unit is 40 ms behind by then, below what counts as a lag; before, minima are too close together.
_SLOPE_AFTER_S = 1.0
_RESTART_S = 1.0  # Arrival that runs back by more than this is another host clock, not the order of threads.
_LARGEST_SLOPE = 0.05  # The worst unit on record ran 3.8 % slow; more is not a clock error.


class HostBaseline:
    """Lower line through (arrival - sample clock) over arrival, both in s.

    Attributes
    ----------
    slope : float or None
        How much slower than nominal the instrument's clock runs, e.g. 0.038 for 3.8 %; None while not known.
    slope_sigma : float
        1 sigma of ``slope`` by how far the minima lie apart; infinite while not known.
    spread_s : float
        How far the minima lie apart, s: by so much the least of many arrivals still jitters; infinite while not known.
    """

    def __init__(self) -> None:
        self._hull: list[tuple[float, float]] = []  # Of all full buckets, lower side, from left to right.
        self._buckets: deque[tuple[float, float]] = deque(maxlen=_WINDOW_BUCKETS)
        self.slope: float | None = None
        self.slope_sigma = math.inf
        self.spread_s = math.inf
        # The line of earliest arrivals: how steep it may rise, and where the full buckets put it at time 0.
        self._rise = 0.0
        self._full_s = math.inf

    def add(self, arrival_s: float, sample_s: float) -> None:
        """Take note of a block that arrived at ``arrival_s`` and whose last sample is of ``sample_s``."""
        offset = arrival_s - sample_s
        if self._buckets and arrival_s < self._buckets[-1][0] - _RESTART_S:
            self._buckets.clear()
            self._hull.clear()
        if not self._buckets or arrival_s >= self._buckets[-1][0] + _BUCKET_S:
            if self._buckets:
                self._add_to_hull(self._buckets[-1])
            self._buckets.append((arrival_s, offset))
            self._renew()
        elif offset < self._buckets[-1][1]:
            self._buckets[-1] = (self._buckets[-1][0], offset)

    def _add_to_hull(self, point: tuple[float, float]) -> None:
        # A. M. Andrew, Information Processing Letters 9 (1979): what lies above the line past it is no corner.
        hull = self._hull
        while len(hull) > 1 and _slope(hull[-2], hull[-1]) >= _slope(hull[-2], point):
            hull.pop()
        hull.append(point)

    def _renew(self) -> None:
        """Work out what the full buckets tell: the newest is still filling, its minimum may be late."""
        hull = self._hull
        self.slope = None
        if len(hull) > 1 and self._buckets[-1][0] - hull[0][0] >= _SLOPE_AFTER_S:
            right = bisect_left(hull, ((hull[0][0] + hull[-1][0]) / 2,))
            self.slope = max(-_LARGEST_SLOPE, min(_LARGEST_SLOPE, _slope(hull[right - 1], hull[right])))
        level = [offset - (self.slope or 0.0) * arrival_s for arrival_s, offset in list(self._buckets)[:-1]]
        self.spread_s = max(level) - min(level) if len(self._buckets) >= _LEAST_BUCKETS else math.inf
        self.slope_sigma = self.spread_s / (hull[-1][0] - hull[0][0]) if len(hull) > 1 else math.inf
        # A fast unit needs no slope, its minima fall by themselves; and a late start looks like one.
        self._rise = max(0.0, self.slope or 0.0)
        self._full_s = min((offset - self._rise * at for at, offset in list(self._buckets)[:-1]), default=math.inf)

    def offset_at(self, arrival_s: float) -> float | None:
        """Return the lowest offset to expect at ``arrival_s``; None before anything arrived."""
        if not self._buckets:
            return None
        at, offset = self._buckets[-1]
        return self._rise * arrival_s + min(self._full_s, offset - self._rise * at)

    def lag_s(self, arrival_s: float, sample_s: float) -> float:
        """Return by how much ``sample_s`` is later at the host than it must be; 0 before anything arrived."""
        expected = self.offset_at(arrival_s)
        return 0.0 if expected is None else arrival_s - sample_s - expected


def _slope(first: tuple[float, float], second: tuple[float, float]) -> float:
    return (second[1] - first[1]) / (second[0] - first[0])


# How long the lag must stand still, at the least. A buffer that is emptied 1 % faster than it is filled moves it by 15 ms from
# one half of the longer time to the other.
_PROOF_WITH_FAULT_S = 1.0
_PROOF_S = 3.0
_PROOF_SPREADS = 20.0  # With a fault, wait for so many times the usual jitter, but no longer than without.
# A lag that stands that long without being a loss is none; nothing is longer kept back, but for late data coming in.
_GIVE_UP_S = 4.0
_AT_END_S = 0.25  # How long, where nothing will follow.
_SILENCE = 0.75  # Part of the loss that must have been silence; the rest allows for a read that was under way.
# The lag stands still within the larger of 3 ms (a busy host) and twice the jitter of the line of earliest arrivals.
_FINEST_S = 0.003
_SPREADS = 2.0
_COARSEST = 1 / 8  # Part of a unit by which the lag may be off, where there is nothing else to go by.
_COARSEST_WITH_FAULT = 1 / 4
# Least loss without a trace where single samples are the unit: radio links and networks slow down by less.
_LEAST_SILENT_S = 1.0


@dataclass(slots=True, kw_only=True)
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
        return TimedBlock(
            block=self.block if end - begin == len(self.block) else self.block[rows],
            time_s=self.time_s[rows],
            flags=self.flags[rows],
            fault=self.fault[rows],
            arrival_s=arrival_s,
        )


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
        self.lost_units = 0  # Units found missing so far; the sample clock behind them must move on by so much.
        self.units_taken_back = 0  # Units that were not missing after all; the sample clock stays as it is.
        self.last_arrival_s = math.nan
        self.gaps = 0  # Gaps found that were not flagged before.
        self._unit_s = unit_s
        self._smallest_s = smallest_s
        self._pending: list[tuple[TimedBlock, float]] = []
        self._fault: tuple[int, int] | None = None  # Block and sample of the first fault in what is kept back.
        self._silence_s = 0.0
        self._believed = 0  # Units found missing that an early arrival would disprove.

    def passes(self, arrival_s: float, last_s: float) -> bool:
        """Take note of a block up to ``last_s`` if it is in time and nothing is kept back; return whether it was.

        The same as ``push`` for nearly all blocks, without making them.
        """
        if self._pending or not math.isfinite(arrival_s):
            return not self._pending
        if abs(self.baseline.lag_s(arrival_s, last_s)) > self._smallest_s:
            return False
        self.last_arrival_s = arrival_s
        self.baseline.add(arrival_s, last_s)
        return True

    def push(self, timed: TimedBlock) -> list[TimedBlock]:
        """Return the blocks whose time is settled now, in order."""
        if not math.isfinite(timed.arrival_s):
            released = self.finish()
            # It lies behind the loss, if one was found.
            timed.time_s += self.lost_units * self._unit_s
            return [*released, timed]
        last_s = float(timed.time_s[-1])
        lag_s = self.baseline.lag_s(timed.arrival_s, last_s)
        if not self._pending:
            self._silence_s = timed.arrival_s - self.last_arrival_s
        self.last_arrival_s = timed.arrival_s
        if lag_s <= self._smallest_s:
            if self._believed and lag_s < -self._smallest_s:
                # Bytes arrive earlier than the losses found would allow, so these cannot have been: take them back.
                units_back = min(round(-lag_s / self._unit_s), self._believed)
                self._believed -= units_back
                self.units_taken_back += units_back
            self.baseline.add(timed.arrival_s, last_s)
            return [*self._release(), timed]
        if self._fault is None and np.count_nonzero(timed.fault):
            self._fault = len(self._pending), int(timed.fault.argmax())
        self._pending.append((timed, lag_s))
        units = self._units_lost()
        return [] if units is None else self._settle(units)

    def finish(self) -> list[TimedBlock]:
        """Return what is kept back; nothing with an arrival time will follow."""
        if not self._pending:
            return []
        units = self._units_lost(at_end=True)
        return self._settle(units) if units else self._release()

    def _release(self) -> list[TimedBlock]:
        pending, self._pending, self._fault = self._pending, [], None
        return [timed for timed, _ in pending]

    def _units_lost(self, *, at_end: bool = False) -> int | None:
        """Return how many units are missing in what is kept back; None while it cannot be told."""
        place = self._fault
        since = self._pending[0 if place is None else place[0] :]
        now_s = since[-1][0].arrival_s
        waited_s = now_s - since[0][0].arrival_s
        proof_s = _PROOF_S
        if place is not None:
            proof_s = min(max(_PROOF_SPREADS * self.baseline.spread_s, _PROOF_WITH_FAULT_S), _PROOF_S)
        if at_end:
            proof_s = max(min(proof_s, waited_s), _AT_END_S if place is not None else _PROOF_S)
        if waited_s < proof_s:
            return None
        before_s = _least(since, now_s - proof_s, now_s - proof_s / 2)
        lag_s = _least(since, now_s - proof_s / 2, math.inf)
        jitter_s = max(_FINEST_S, _SPREADS * self.baseline.spread_s)
        tolerance_s = jitter_s if place is None else max(jitter_s, _COARSEST_WITH_FAULT * self._unit_s)
        if abs(lag_s - before_s) <= tolerance_s and self._is_loss(lag_s, tolerance_s, has_fault=place is not None):
            return round(lag_s / self._unit_s)
        is_coming_in = lag_s < before_s - jitter_s
        return 0 if waited_s >= _GIVE_UP_S and not is_coming_in else None

    def _is_loss(self, lag_s: float, tolerance_s: float, *, has_fault: bool) -> bool:
        """Whether a lag that stands still is a loss."""
        units = round(lag_s / self._unit_s)
        is_whole = abs(lag_s - units * self._unit_s) <= tolerance_s
        was_silent = self._silence_s >= _SILENCE * lag_s
        if has_fault:
            return units > 0 and (is_whole or was_silent)
        counts_wraps = self._smallest_s < self._unit_s
        can_tell = tolerance_s <= _COARSEST * self._unit_s if counts_wraps else lag_s >= _LEAST_SILENT_S
        return units > 0 and is_whole and was_silent and can_tell

    def _settle(self, units: int) -> list[TimedBlock]:
        """Let go what is kept back: with a loss in it, or with a clock that has changed."""
        number, row = self._fault or (0, 0)
        pending = self._release()
        if units:
            # All samples from the place of the loss on come later by it.
            for timed in pending[number:]:
                timed.time_s[row if timed is pending[number] else 0 :] += units * self._unit_s
            flags = pending[number].flags
            self.gaps += int(flags[row] & np.uint32(Status.AFTER_GAP | Status.GAP_ESTIMATED) == 0)
            flags[row] = flags[row] & ~np.uint32(Status.AFTER_GAP) | np.uint32(Status.GAP_ESTIMATED)
            self.lost_units += units
            self._believed += units
        else:
            self.baseline = HostBaseline()
            self._believed = 0
        for timed in pending:
            self.baseline.add(timed.arrival_s, float(timed.time_s[-1]))
        return pending


def _least(pending: list[tuple[TimedBlock, float]], begin_s: float, end_s: float) -> float:
    """Return the least lag of what arrived in a stretch of time, infinity where nothing did."""
    return min((lag_s for timed, lag_s in pending if begin_s <= timed.arrival_s < end_s), default=math.inf)
