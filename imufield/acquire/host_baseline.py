"""How far arrival at the host lags behind the sample clock, compared with how far it must.

Arrival is never early, but often late: the operating system hands over old data in bursts. The lowest of
(arrival - sample clock) in each quarter second is therefore the true relation of the two clocks, and the slope of those
minima is the error of the nominal rate. A lag above that line that goes away was a burst; one that stays means that the
sample clock is behind, so samples are missing.
"""

from __future__ import annotations

import math
from collections import deque

_BUCKET_S = 0.25
_WINDOW_BUCKETS = 16
"""4 s: crystals of 100 ppm drift 0.4 ms in it even before the slope is known."""
_LEAST_BUCKETS = 5
"""1 s: minima that are known before their jitter is."""
_SLOPE_AFTER_S = 1.0
"""A 4 % slow unit is 40 ms behind by then, below what counts as a lag; before, minima are too close together."""
_RESTART_S = 1.0
"""Arrival that runs back by more than this is another host clock, not the order of threads."""
_LARGEST_SLOPE = 0.05
"""The worst unit on record ran 3.8 % slow; more is not a clock error."""


class HostBaseline:
    """Lower line through (arrival - sample clock) over arrival, both in s."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None
        self._buckets: deque[tuple[float, float]] = deque(maxlen=_WINDOW_BUCKETS)

    def add(self, arrival_s: float, sample_s: float) -> None:
        """Take note of a block that arrived at ``arrival_s`` and whose last sample is of ``sample_s``."""
        offset = arrival_s - sample_s
        if self._buckets and arrival_s < self._buckets[-1][0] - _RESTART_S:
            self._buckets.clear()
            self._first = None
        if not self._buckets or arrival_s >= self._buckets[-1][0] + _BUCKET_S:
            if len(self._buckets) == 1 and self._first is None:
                self._first = self._buckets[0]
            self._buckets.append((arrival_s, offset))
        elif offset < self._buckets[-1][1]:
            self._buckets[-1] = (self._buckets[-1][0], offset)

    @property
    def slope(self) -> float | None:
        """How much slower than nominal the instrument's clock runs, e.g. 0.038 for 3.8 %; None while not known."""
        if self._first is None or self._buckets[-1][0] - self._first[0] < _SLOPE_AFTER_S:
            return None
        # The newest bucket is still filling, its minimum may be late.
        arrival_s, offset = self._buckets[-2]
        if arrival_s <= self._first[0]:
            return None
        return max(-_LARGEST_SLOPE, min(_LARGEST_SLOPE, (offset - self._first[1]) / (arrival_s - self._first[0])))

    @property
    def spread_s(self) -> float:
        """How far the minima lie apart, s: by so much the least of many arrivals still jitters; infinite while not known."""
        if len(self._buckets) < _LEAST_BUCKETS:
            return math.inf
        slope = self.slope or 0.0
        level = [offset - slope * arrival_s for arrival_s, offset in list(self._buckets)[:-1]]
        return max(level) - min(level)

    def offset_at(self, arrival_s: float) -> float | None:
        """Return the lowest offset to expect at ``arrival_s``; None before anything arrived."""
        if not self._buckets:
            return None
        # A fast unit needs no slope, its minima fall by themselves; and a late start looks like one.
        slope = max(0.0, self.slope or 0.0)
        return min(offset + slope * (arrival_s - at) for at, offset in self._buckets)

    def lag_s(self, arrival_s: float, sample_s: float) -> float:
        """Return by how much ``sample_s`` is later at the host than it must be; 0 before anything arrived."""
        expected = self.offset_at(arrival_s)
        return 0.0 if expected is None else arrival_s - sample_s - expected
