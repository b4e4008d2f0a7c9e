"""Time by the instrument's own time stamps.

``StampClock`` unwraps time stamps and keeps them from running backwards. ``sample_clock`` chooses between time stamps, counter
and host, ``can_sent_time`` gives them to the samples of a bus; ``host_lag`` compares with the host.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.clock.missing_samples import TOLERANCE
from imufield.acquire.decode.assembly import NO_TICKS, Ticks
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, every

_Number = TypeVar("_Number", bound=np.number)
_LARGEST_TIME_S = 1e11  # 3000 years; in an unchecked stream anything further from zero, infinity and NaN are garbage.
# A time stamp further ahead than this is a clock being set, e.g. by GNSS, not an hour without samples.
LONGEST_PAUSE_S = 3600.0
# Share of the first samples with another stamp than the one before: of eight with the same, the host dates each better.
_LEAST_MOVING = 1 / 8
_LARGEST_PART = 1 / 8  # Of a wrap: a clock set by any step then fits a whole number of wraps in a quarter of all cases at most.
_LONGEST_OVER_A_WRAP_S = 60.0  # A longer step over the end of the range is a clock that began anew, if no host tells more.
_PAUSE = 2.5  # Times a tick: stamps of whole milliseconds make two of one.
_ROUNDING = 1e-9  # Relative, of the sum of a day of time stamps: even ones have the mean of each step.


@dataclass(slots=True)  # One for each read: a frozen one takes five times as long to make.
class Stamped:
    """Time of n samples."""

    time_s: FloatArray
    step_s: FloatArray
    """Time since the sample before; the step assumed where the clock was set anew. Shape (n,)."""
    reset: NDArray[np.bool_]
    """Where the time stamp ran backwards or leapt ahead. Shape (n,)."""
    range_s: tuple[float, float] | None = None
    """The shortest and the longest step; None where the stamp did not only go forward."""


class StampClock:
    """Makes one continuous time from time stamps.

    The time is the stamp itself plus whole wraps, plus an offset that changes only where the instrument's clock was set
    anew; so it is exact, and does not depend on how the stream is cut.

    Parameters
    ----------
    rule : ClockRule
    """

    def __init__(self, rule: ClockRule) -> None:
        self.modulus = rule.time_modulus
        self._ticks_per_s = rule.time_ticks_per_s
        self._longest_pause_s = math.inf if rule.gaps_told else LONGEST_PAUSE_S
        self._last: float = 0
        self._added = 0  # Ticks of all wraps.
        self._offset_s = 0.0
        self._raw_s = 0.0
        self._time_s = 0.0

    @property
    def wrap_s(self) -> float:
        """After how long the stamps begin anew; infinite where they do not."""
        return self.modulus / self._ticks_per_s if self.modulus else math.inf

    def widen(self, modulus: int, last: int) -> None:
        """Let the stamps begin anew later than stated, after ``modulus`` ticks; ``last`` is the one before as it was sent."""
        self.modulus = modulus
        self._added += int(self._last) - last % modulus
        self._last = last % modulus

    def tells_time(self, first: Ticks, *, has_host: bool) -> bool:
        """Whether most of the first stamps are times; and whether they move, where a host dates the samples as well."""
        if 2 * np.count_nonzero(self._good(first)) <= len(first):
            return False
        # Of stamps that most samples share with the one before, the clock of the host tells more.
        return not has_host or len(first) < 2 or int(np.count_nonzero(np.diff(first))) > _LEAST_MOVING * (len(first) - 1)

    def start(self, stamps: Ticks) -> FloatArray:
        """Begin with the first of the first n time stamps; return the n - 1 steps between them, s."""
        stamps = self._without_garbage(stamps)
        # Without any stamp before it a first one that is missing is still ``NO_TICKS``, too far back to compute with.
        self._last, self._added = max(stamps[0].item(), -_LARGEST_TIME_S * self._ticks_per_s), 0
        self._time_s = self._raw_s = self._last / self._ticks_per_s
        return np.diff(stamps) / self._ticks_per_s

    def go_round(self, stamp: float, silence_s: float, within_s: float) -> bool:
        """Add the wraps that a silence before the next stamp has room for; return whether the stamp does not show them.

        A silence that no number of wraps makes to ``within_s`` was none: the clock that measured it was set.
        """
        step = stamp - self._last
        wraps = round((silence_s * self._ticks_per_s - step) / self.modulus)
        off_s = silence_s - (step + wraps * self.modulus) / self._ticks_per_s
        if wraps <= int(self._goes_round(step)) or abs(off_s) > within_s or not self.silence_tells(within_s):
            return False
        self._added, self._last = self._added + wraps * self.modulus, stamp
        return True

    def silence_tells(self, within_s: float) -> bool:
        """Whether a silence known to ``within_s`` tells wraps: nearly any is a whole number of short ones."""
        return within_s <= _LARGEST_PART * self.wrap_s

    def add_wraps(self, wraps: int, time_s: FloatArray) -> FloatArray:
        """Add wraps that were found missing before these newest times, which may be none; return them moved on. Shape (n,)."""
        self._added += wraps * self.modulus
        raw_s = np.append(time_s - self._offset_s, self._raw_s)
        # From whole ticks again: a sum of times would depend in its last bit on how reads were joined into blocks.
        raw_s = (np.rint(raw_s * self._ticks_per_s) + wraps * self.modulus) / self._ticks_per_s
        self._raw_s = raw_s.item(-1)
        self._time_s += wraps * self.wrap_s
        return np.asarray(raw_s[:-1] + self._offset_s)

    def time(self, stamps: Ticks, step_over: Callable[[int], float]) -> Stamped:
        """Return the time of the next n samples.

        Parameters
        ----------
        stamps : ndarray of int64 or float64, shape (n,)
            As sent.
        step_over : callable
            Returns the step to assume, s, to the row where the instrument's clock was set anew.
        """
        return self._time_forward(stamps) or self._time_with_jumps(stamps, step_over)

    def _time_forward(self, stamps: Ticks) -> Stamped | None:
        """Return the time of stamps that only go forward, nearly always; None where they do not."""
        # Of whole numbers the first is enough: what stands for none is the least of all and would make a step back.
        if stamps[0] == NO_TICKS if stamps.dtype.kind == "i" else not every(self._good(stamps)):
            return None
        wrapped = stamps + np.array([self._added]) if self._added else stamps
        raw_s: FloatArray = np.divide(wrapped, self._ticks_per_s, dtype=np.float64)
        step_s = steps_between(raw_s, self._raw_s)
        time_s = raw_s + self._offset_s if self._offset_s else raw_s
        lowest_s, highest_s = step_s.item(step_s.argmin()), step_s.item(step_s.argmax())
        # A wrap and a clock set anew make a step that is negative or very long.
        if not 0 <= lowest_s <= highest_s <= self._longest_pause_s or time_s[0] < self._time_s:
            return None
        self._last, self._raw_s, self._time_s = stamps[-1].item(), raw_s.item(-1), time_s.item(-1)
        return Stamped(time_s, step_s, np.zeros(len(stamps), dtype=np.bool_), (lowest_s, highest_s))

    def _time_with_jumps(self, stamps: Ticks, step_over: Callable[[int], float]) -> Stamped:
        stamps = self._unwrap(self._without_garbage(stamps))
        raw_s: FloatArray = np.divide(stamps, self._ticks_per_s, dtype=np.float64)
        step_s = steps_between(raw_s, self._raw_s)
        reset = (step_s < 0) | (step_s > self._longest_pause_s)
        offset_s = np.full(len(stamps), self._offset_s)
        for place in reset.nonzero()[0].tolist():
            before_s = raw_s[place - 1] + offset_s[place - 1] if place else self._raw_s + self._offset_s
            step_s[place] = step_over(place)
            offset_s[place:] = before_s + step_s[place] - raw_s[place]
        # Between times far apart the offset is coarser than a step, which must not turn time back.
        time_s = np.maximum.accumulate(np.maximum(raw_s + offset_s, self._time_s))
        self._raw_s, self._offset_s, self._time_s = float(raw_s[-1]), float(offset_s[-1]), float(time_s[-1])
        return Stamped(time_s, step_s, reset)

    def _without_garbage(self, stamps: Ticks) -> Ticks:
        """Replace what is no time by the stamp before: such a sample has no time of its own."""
        good = self._good(stamps)
        if not every(good):
            stamps = np.concatenate([np.array([self._last], dtype=stamps.dtype), stamps])
            place = np.maximum.accumulate(np.where(np.append(True, good), np.arange(len(stamps)), 0))
            stamps = stamps[place][1:]
        return stamps

    def _good(self, stamps: Ticks) -> NDArray[np.bool_]:
        """Return which are times, shape (n,)."""
        is_whole = stamps.dtype.kind == "i"
        return np.asarray(stamps != NO_TICKS if is_whole else np.abs(stamps) < _LARGEST_TIME_S * self._ticks_per_s)

    def _unwrap(self, stamps: Ticks) -> Ticks:
        """Add a wrap wherever a stamp follows the one before over the end of the range."""
        before, self._last = self._last, stamps[-1].item()
        if not self.modulus:
            return stamps
        rounds = np.asarray(self._goes_round(steps_between(stamps, before)))
        added = self._added + rounds.cumsum() * self.modulus if np.count_nonzero(rounds) else np.array([self._added])
        self._added = int(added[-1])
        unwrapped: Ticks = np.add(stamps, added)
        return unwrapped

    def _goes_round(self, step: Ticks | float) -> NDArray[np.bool_] | bool:
        """Return whether a step leads over the end of the range and 60 s further at most."""
        ahead = step + self.modulus
        return (step < -(self.modulus // 2)) & (ahead >= 0) & (ahead <= _LONGEST_OVER_A_WRAP_S * self._ticks_per_s)


class MeanStep:
    """Mean time from sample to sample by all time stamps: single steps are off by jitter and resolution of the stamps."""

    def __init__(self) -> None:
        self._regular_s = 0.0
        self._sum_s = 0.0
        self._count = 0.0
        self._end_s = 0.0
        self._has_begun = False

    def by_stamps(self, stamped: Stamped, regular_s: float) -> float:
        """Take note of the next samples; return the mean of the regular steps so far, ``regular_s`` where there is none.

        A step beside one that is not regular does not count either: samples of an event stand between those of the schedule.
        """
        begin_s, self._end_s = self._end_s, stamped.time_s.item(-1)
        if regular_s <= 0:
            return 0.0
        if regular_s != self._regular_s:
            self._regular_s, self._sum_s, self._count = regular_s, 0.0, 0.0
        lowest_s, highest_s = regular_s * (1 - 2 * TOLERANCE), regular_s * (1 + 2 * TOLERANCE)
        if stamped.range_s is not None and lowest_s <= stamped.range_s[0] <= stamped.range_s[1] <= highest_s:
            self._sum_s += self._end_s - begin_s
            self._count += len(stamped.time_s)
        else:
            near = np.pad((stamped.step_s >= lowest_s) & (stamped.step_s <= highest_s), 1, constant_values=True)
            kept = stamped.step_s[near[:-2] & near[1:-1] & near[2:]]
            self._sum_s += float(kept.sum())
            self._count += len(kept)
        return self._mean(regular_s)

    def by_counter(self, stamped: Stamped, ticks: FloatArray, step: float, tick_s: float) -> float:
        """Take note of the next samples, which a counter knows to be ``ticks`` apart; return the mean time of ``step`` ticks.

        ``tick_s`` is the time of a tick by the first stamps: what takes more than twice as long is a pause.
        """
        good = ~stamped.reset & (stamped.step_s <= _PAUSE * ticks * tick_s)
        # The first sample of all is behind none.
        good[0] &= self._has_begun
        self._has_begun = True
        self._sum_s += float(stamped.step_s[good].sum())
        self._count += float(ticks[good].sum())
        return step * self._mean(tick_s)

    def _mean(self, regular_s: float) -> float:
        mean_s = self._sum_s / self._count if self._count else regular_s
        return regular_s if math.isclose(mean_s, regular_s, rel_tol=_ROUNDING) else mean_s


def steps_between(values: NDArray[_Number], before: float) -> NDArray[_Number]:
    """Return how far each value is from the one before it; as ``np.diff(values, prepend=before)``, many times faster."""
    all_values = np.empty(len(values) + 1, dtype=values.dtype)
    all_values[0], all_values[1:] = before, values
    steps: NDArray[_Number] = np.subtract(all_values[1:], all_values[:-1])
    return steps
