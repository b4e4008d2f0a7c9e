"""Time stamps of the instrument, unwrapped and kept from running backwards."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol_schema import ClockRule
from imufield.samples import FloatArray

NO_TICKS = np.iinfo(np.int64).min
"""Time stamp of a sample that has none, where others have whole numbers; NaN where others have fractions."""

_LARGEST_TIME_S = 1e11
"""3000 years; in an unchecked stream anything further from zero, infinity and NaN are garbage."""
_LONGEST_PAUSE_S = 3600.0
"""A time stamp further ahead than this is a clock being set, e.g. by GNSS, not an hour without samples."""


@dataclass(frozen=True, slots=True)
class Stamped:
    """Time of n samples."""

    time_s: FloatArray
    step_s: FloatArray
    """Time since the sample before; the regular step where the clock was set anew. Shape (n,)."""
    reset: NDArray[np.bool_]
    """Where the time stamp ran backwards or leapt ahead. Shape (n,)."""


class StampClock:
    """Makes one continuous time from time stamps.

    The time is the stamp itself plus whole wraps, plus an offset that changes only where the instrument's clock was set
    anew; so it is exact, and does not depend on how the stream is cut.

    Parameters
    ----------
    rule : ClockRule
    """

    def __init__(self, rule: ClockRule) -> None:
        self._modulus = rule.time_modulus
        self._ticks_per_s = rule.time_ticks_per_s
        self._longest_pause_s = math.inf if rule.gaps_told else _LONGEST_PAUSE_S
        self._last: float = 0
        self._wraps = 0
        self._offset_s = 0.0
        self._raw_s = 0.0
        self._time_s = 0.0

    def start(self, stamps: NDArray[Any]) -> FloatArray:
        """Begin with the first of the first n time stamps; return the n - 1 steps between them, s."""
        stamps = self._without_garbage(stamps)
        self._last = max(stamps[0].item(), -_LARGEST_TIME_S * self._ticks_per_s)
        self._time_s = self._raw_s = self._last / self._ticks_per_s
        return np.diff(stamps) / self._ticks_per_s

    def time(self, stamps: NDArray[Any], regular_s: float) -> Stamped:
        """Return the time of the next n samples.

        Parameters
        ----------
        stamps : ndarray of int64 or float64, shape (n,)
            As sent.
        regular_s : float
            Step to assume where the instrument's clock was set anew, s.
        """
        stamps = self._unwrap(self._without_garbage(stamps))
        raw_s: FloatArray = stamps / self._ticks_per_s
        step_s = _steps(raw_s, self._raw_s)
        reset = (step_s < 0) | (step_s > self._longest_pause_s)
        offset_s = np.full(len(stamps), self._offset_s)
        for place in np.flatnonzero(reset).tolist():
            before_s = raw_s[place - 1] + offset_s[place - 1] if place else self._raw_s + self._offset_s
            offset_s[place:] = before_s + regular_s - raw_s[place]
        # Between times far apart the offset is coarser than a step, which must not turn time back.
        time_s = np.maximum.accumulate(np.maximum(raw_s + offset_s, self._time_s))
        step_s[reset] = regular_s
        self._raw_s, self._offset_s, self._time_s = float(raw_s[-1]), float(offset_s[-1]), float(time_s[-1])
        return Stamped(time_s, step_s, reset)

    def _without_garbage(self, stamps: NDArray[Any]) -> NDArray[Any]:
        """Replace what is no time by the stamp before: such a sample has no time of its own."""
        is_whole = stamps.dtype.kind == "i"
        good = stamps != NO_TICKS if is_whole else np.abs(stamps) < _LARGEST_TIME_S * self._ticks_per_s
        if not good.all():
            stamps = np.concatenate([np.array([self._last], dtype=stamps.dtype), stamps])
            place = np.maximum.accumulate(np.where(np.append(True, good), np.arange(len(stamps)), 0))
            stamps = stamps[place][1:]
        return stamps

    def _unwrap(self, stamps: NDArray[Any]) -> NDArray[Any]:
        """Add a wrap wherever a stamp is more than half a wrap behind the one before."""
        before, self._last = self._last, stamps[-1].item()
        if not self._modulus:
            return stamps
        wraps = self._wraps + np.cumsum(_steps(stamps, before) < -(self._modulus // 2))
        self._wraps = int(wraps[-1])
        unwrapped: NDArray[Any] = stamps + wraps * self._modulus
        return unwrapped


def _steps(values: NDArray[Any], before: float) -> NDArray[Any]:
    """Return how far each value is from the one before it; as ``np.diff(values, prepend=before)``, many times faster."""
    steps = np.empty_like(values)
    steps[0] = values[0] - before
    np.subtract(values[1:], values[:-1], out=steps[1:])
    return steps
