"""Overlapped Allan deviation of long recordings, as a stream: the adapter of allantools.

The estimator is allantools'. It wants all samples of an axis at once and several copies of them; a day at 200 Hz is 17
million. So the samples go through levels, each of which averages 32 samples of the one before: short times are taken
from chunks of the full rate, longer ones from chunks of averages, the longest from all averages at once. At 8 or more samples
of a level per averaging time, stepping by whole samples loses less than 1 % of the overlapped estimator's freedom. The
variances of chunks are averaged, weighted by their number of terms; the terms that straddle two chunks are the only ones lost.

``noise_fit`` reads the random walk and the bias instability from it. An Allan deviation needs rows one interval apart: lost
samples are bridged by a straight line where no more than a second is missing, or two samples of a slow instrument, and counted;
longer losses and clocks that jump back begin a new run of rows. A sample with the time of the one before is left out: if it was
sent twice nothing is lost, and if its time came late the line fills its place.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass
from imufield.errors import load_package
from imufield.samples import FloatArray, IntArray, median

_BRIDGED_S = 1.0  # A longer hole ends the stretch.
_BRIDGED_INTERVALS = 3.5  # The same for slow instruments: two lost samples, however unsteady the clock.
_USUAL = 0.9  # Share of the steps that are off by no more than the slack.
_WHOLE = 0.1  # Of an interval: steps that are off by less are steady.
COARSE = 1.02
"""Interval over the middle step: of more, times are coarse or unsteady."""
_ONE_INTERVAL = 1.7  # Of the middle step: longer ones may hold a lost sample.
_TURNS = 4  # With a fifth of the samples lost the interval settles in two.


@dataclass(frozen=True, slots=True)
class EvenRows:
    """Rows one sample interval apart."""

    start_s: float
    rows: FloatArray
    bridged: NDArray[np.bool_]
    """Which of them are on a straight line between samples."""
    broken: bool
    """They do not follow the rows before."""


def interval_and_slack(step_s: FloatArray, known_s: float | None = None) -> tuple[float, float]:
    """Return the interval of samples with these steps, shape (n,), and by what part of it single steps are off.

    An interval that is known is returned as it is.

    Times of whole milliseconds at 400 Hz have steps of 2 and 3 ms, whose median is no interval. Where all steps are whole
    multiples of the median, the longer ones are losses.
    """
    usual_s = step_s[(step_s > 0) & (step_s <= _BRIDGED_INTERVALS * median(step_s))]
    middle_s = float(median(usual_s))
    # The middle one itself is 17 ms where whole milliseconds at 60 Hz are 16 and 17.
    wholes = np.maximum(np.rint(usual_s / middle_s), 1)
    if np.quantile(np.abs(usual_s / middle_s - wholes), _USUAL) < _WHOLE:
        return known_s or float(usual_s.sum() / wholes.sum()), 0.0
    interval_s, slack = known_s or float(usual_s[usual_s <= _ONE_INTERVAL * middle_s].mean()), 0.0
    # Which steps are longer by a lost sample, and the interval, tell each other.
    for _ in range(_TURNS):
        steps = usual_s / interval_s
        slack = min(float(np.quantile(np.abs(steps - np.maximum(np.rint(steps), 1)), _USUAL)), 0.5) / 2
        interval_s = known_s or float(usual_s.sum() / _intervals_in(steps, slack).sum())
    return interval_s, slack


def _intervals_in(steps: FloatArray, slack: float) -> IntArray:
    """Return the whole number of intervals, at least 1, that steps in units of it stand for."""
    return np.maximum(np.floor(steps + 0.5 - slack), 1).astype(np.int64)


class EvenGrid:
    """Puts samples onto an even grid, block by block.

    Parameters
    ----------
    interval_s : float
    slack : float
        By how much of it single steps are off, as ``interval_and_slack`` finds it.

    Attributes
    ----------
    bridged_s : float
        The longest step from sample to sample that is bridged.
    rows, lasted_s : int, float
        Of all steps that are not longer: how many rows they were taken for, and the time that they took.
    """

    def __init__(self, interval_s: float, slack: float = 0.0) -> None:
        self.interval_s = interval_s
        self._slack = slack
        self.bridged_s = max(_BRIDGED_S, _BRIDGED_INTERVALS * interval_s)
        self.rows, self.lasted_s = 0, 0.0
        self._last: tuple[float, FloatArray] | None = None

    def feed(self, time_s: FloatArray, values: FloatArray) -> list[EvenRows]:
        """Return the even rows of n samples, shape (n,) and (n, c), in runs."""
        continues = self._last is not None
        if self._last is not None:
            time_s = np.concatenate([[self._last[0]], time_s])
            values = np.concatenate([self._last[1][None], values])
        goes_on = np.append(True, np.diff(time_s) != 0)
        time_s, values = time_s[goes_on], values[goes_on]
        self._last = (float(time_s[-1]), values[-1])
        between = np.diff(time_s)
        steps = _intervals_in(between / self.interval_s, self._slack)
        is_break = (between > self.bridged_s) | (between < 0)
        self.rows += int(steps[~is_break].sum())
        self.lasted_s += float(between[~is_break].sum())
        breaks = np.flatnonzero(is_break) + 1
        runs = []
        for number, rows in enumerate(np.split(np.arange(len(time_s)), breaks)):
            even, bridged = bridge(values[rows], steps[rows[:-1]])
            # The first row of a continued run was handed out with the block before.
            skip = 1 if continues and number == 0 else 0
            if len(even) > skip:
                start_s = float(time_s[rows[0]]) + skip * self.interval_s
                runs.append(EvenRows(start_s, even[skip:], bridged[skip:], number > 0))
        return runs


def bridge(values: FloatArray, steps: IntArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return m rows with straight lines over what is missing, and which of them are on these, shape (m,).

    Parameters
    ----------
    values : ndarray, shape (n, c)
    steps : ndarray of int, shape (n - 1,)
        Sample intervals from each row to the next, at least 1.
    """
    place = np.concatenate([[0], np.cumsum(steps)])
    bridged = np.ones(place[-1] + 1, dtype=np.bool_)
    bridged[place] = False
    if not bridged.any():
        return values, bridged
    grid = np.arange(len(bridged))
    return np.stack([np.interp(grid, place, column) for column in values.T], axis=1), bridged


DECIMATION = 32
"""Samples that are averaged into one of the next level: five octaves."""
CHUNK = 1 << 18
"""Rows that are measured at once: 2 MiB a column."""
_CHUNKED_LEVELS = 2  # Levels that are measured in chunks; the one above keeps all its rows, one in 1024.
_OCTAVES_LOWEST = 8  # Octaves taken at the full rate, 1 to 128 samples; every level above adds five.
_OCTAVES_A_LEVEL = 5  # Of ``DECIMATION``.
_SMALLEST = 3  # At least this many averaging times in the recording: fewer say nothing.


@dataclass(frozen=True, slots=True)
class AllanDeviation:
    """Overlapped Allan deviation of c columns at n octaves.

    Attributes
    ----------
    tau_s : ndarray, shape (n,)
    deviation : ndarray, shape (n, c)
    samples : int
        At the full rate.
    factor : ndarray of int, shape (n,)
        Averaging time in samples of the full rate.
    """

    tau_s: FloatArray
    deviation: FloatArray
    samples: int
    factor: np.ndarray[Any, np.dtype[np.int64]]


class _Level:
    """Samples of one rate, and what their chunks showed."""

    def __init__(self, columns: int) -> None:
        self.parts: list[FloatArray] = []
        self.rows = 0
        self.square: dict[int, FloatArray] = {}
        self.terms: dict[int, float] = {}
        self.flushed = False
        self.left = np.empty((0, columns))

    def take(self) -> FloatArray:
        """Return all rows and forget them."""
        rows = np.concatenate(self.parts) if self.parts else np.empty((0, self.left.shape[1]))
        self.parts, self.rows = [], 0
        return rows


class AllanStream:
    """Collects the Allan deviation of c columns; memory does not grow with the length but for one row in 1024.

    Parameters
    ----------
    interval_s : float
        Between samples, which must be even.
    columns : int

    Raises
    ------
    UsageError
        If allantools is not installed.
    """

    def __init__(self, interval_s: float, columns: int) -> None:
        self._allantools = load_package("allantools", "the Allan deviation", "noise")
        self.interval_s = interval_s
        self.columns = columns
        self.samples = 0
        self._levels = [_Level(columns) for _ in range(_CHUNKED_LEVELS + 1)]

    def feed(self, values: FloatArray) -> None:
        """Take the next samples, shape (n, c)."""
        self.samples += len(values)
        self._put(0, values)

    def finish(self) -> AllanDeviation:
        """Return the deviation at all octaves of which the recording holds three averaging times."""
        n = self.samples
        most = int(np.log2(max(n // _SMALLEST, 1))) if n >= _SMALLEST else -1
        rest = [level.take() for level in self._levels]
        octaves, deviation = [], []
        for number, level in enumerate(self._levels):
            rows = np.concatenate([rest[number], level.take()])
            # The lowest level that never filled a chunk has all that there is.
            is_highest = number == _CHUNKED_LEVELS or not level.flushed
            for octave in range(self._first(number), (most if is_highest else min(self._last(number), most)) + 1):
                if len(rows):
                    self._measure(level, number, rows, [octave])
                if octave in level.terms:
                    octaves.append(octave)
                    deviation.append(np.sqrt(level.square[octave] / level.terms[octave]))
            if is_highest:
                break
            self._average(number, rows)  # What is left below goes up.
        factor = np.array([1 << octave for octave in octaves], dtype=np.int64)
        tau_s: FloatArray = np.asarray(factor * self.interval_s, dtype=np.float64)
        return AllanDeviation(tau_s, np.array(deviation).reshape(-1, self.columns), n, factor)

    def _put(self, number: int, values: FloatArray) -> None:
        level = self._levels[number]
        level.parts.append(values)
        level.rows += len(values)
        if number < _CHUNKED_LEVELS:
            # At least a chunk stays, so the last one is never short.
            while level.rows >= 2 * CHUNK:
                rows = level.take()
                chunk, rest = rows[:CHUNK], rows[CHUNK:]
                level.parts, level.rows, level.flushed = [rest], len(rest), True
                self._measure(level, number, chunk, range(self._first(number), self._last(number) + 1))
                self._average(number, chunk)

    def _average(self, number: int, rows: FloatArray) -> None:
        level = self._levels[number]
        joined = np.concatenate([level.left, rows])
        whole = len(joined) // DECIMATION * DECIMATION
        level.left = joined[whole:]
        if whole:
            self._put(number + 1, joined[:whole].reshape(-1, DECIMATION, self.columns).mean(axis=1))

    @staticmethod
    def _last(number: int) -> int:
        return _OCTAVES_LOWEST - 1 + _OCTAVES_A_LEVEL * number

    @staticmethod
    def _first(number: int) -> int:
        return 0 if number == 0 else _OCTAVES_LOWEST + _OCTAVES_A_LEVEL * (number - 1)

    def _measure(self, level: _Level, number: int, rows: FloatArray, octaves: range | list[int]) -> None:
        interval_s = self.interval_s * DECIMATION**number
        inside = [octave for octave in octaves if (1 << (octave - _OCTAVES_A_LEVEL * number)) * 2 < len(rows)]
        if not inside:
            return
        taus = np.array([float(1 << (octave - _OCTAVES_A_LEVEL * number)) for octave in inside]) * interval_s
        variances, terms = [], np.empty(0)
        for column in rows.T:
            # Starting from zero keeps the phase, a running sum, small against its rounding.
            _, deviation, _, terms = self._allantools.oadev(
                column - column[0], rate=1 / interval_s, data_type="freq", taus=taus
            )
            variances.append(deviation**2)
        for k, octave in enumerate(inside[: len(terms)]):
            # Each chunk counts by its number of terms.
            square = float(terms[k]) * np.array([variance[k] for variance in variances])
            level.square[octave] = level.square.get(octave, 0.0) + square
            level.terms[octave] = level.terms.get(octave, 0.0) + float(terms[k])


def degrees_of_freedom(deviation: AllanDeviation, column: int) -> FloatArray:
    """Return the equivalent degrees of freedom of each point, shape (n,), from the slope of the deviation there."""
    ci = importlib.import_module("allantools.ci")
    sigma = deviation.deviation[:, column]
    n = len(sigma)
    if n < 2:
        return np.ones(n)
    slope = np.gradient(np.log(np.maximum(sigma, 1e-300)), np.log(deviation.tau_s))
    # Power law of the rate's spectrum: -1/2 white (0), 0 flicker (-1), +1/2 random walk (-2).
    power = np.clip(np.rint(-1 - 2 * slope), -2, 0).astype(int)  # the formula of [Greenhall, Riley] wants a whole power law
    freedom = [
        ci.edf_greenhall(int(alpha), 2, int(m), deviation.samples + 1, overlapping=True, modified=False)
        for alpha, m in zip(power, deviation.factor, strict=True)
    ]
    return np.maximum(np.array(freedom, dtype=np.float64), 1.0)
