"""What an instrument at rest does second by second: means, whether it was moved, its noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imufield.deliver.navigation.alignment import NoiseDensity
from imufield.samples import FloatArray

SECOND_S = 1.0
MOVED_RATE_RAD_S = np.radians(0.3)
MOVED_FORCE_M_S2 = 0.05
"""Changes above these, and above eight times the noise, are no drift of an instrument at rest."""
_MOVED_SIGMAS = 8.0
_FORCE_LAG = 10
"""Seconds over which the specific force is compared with itself: temperature is slower, a hand is faster."""
_SHORTEST_FOR_FLOOR = 600
"""Seconds: below, the lowest point of the Allan deviation is still on the slope of white noise."""
_FLOOR = np.sqrt(2 * np.log(2) / np.pi)
"""Allan deviation at its lowest over the bias instability (IEEE Std 952)."""


class IntervalMeans:
    """Means over equal intervals of a stream of values.

    Parameters
    ----------
    start_s : float
        Beginning of the first interval.
    columns : int
    interval_s : float
    """

    def __init__(self, start_s: float, columns: int = 6, interval_s: float = SECOND_S) -> None:
        self.start_s = start_s
        self.interval_s = interval_s
        self._columns = columns
        self._sums: list[FloatArray] = []
        self._counts: list[FloatArray] = []
        self._open = (np.zeros(self._columns), 0.0)
        self._slot = 0

    def feed(self, time_s: FloatArray, values: FloatArray) -> None:
        """Take samples of rising time, shape (n,) and (n, columns)."""
        slot = np.floor((time_s - self.start_s) / self.interval_s).astype(np.int64)
        first = np.flatnonzero(np.diff(slot, prepend=slot[:1] - 1))
        sums = np.add.reduceat(values, first, axis=0)
        counts = np.diff(first, append=len(slot)).astype(np.float64)
        for number, total, count in zip(slot[first], sums, counts, strict=True):
            while self._slot < number:
                self._close()
            self._open = (self._open[0] + total, self._open[1] + count)

    def finish(self) -> FloatArray:
        """Return the means of all complete intervals, shape (m, columns); NaN where one had no sample."""
        counts = np.array(self._counts)[:, None]
        if not len(counts):
            return np.empty((0, self._columns))
        with np.errstate(invalid="ignore"):
            return np.array(self._sums) / counts

    def _close(self) -> None:
        self._sums.append(self._open[0])
        self._counts.append(np.asarray(self._open[1]))
        self._open = (np.zeros(self._columns), 0.0)
        self._slot += 1


@dataclass(frozen=True, slots=True)
class RestNoise:
    """Noise of each axis, shape (6,): three m/s^2, three rad/s."""

    density: FloatArray
    """White noise, per sqrt(Hz)."""
    instability: FloatArray
    """Bias instability: an upper limit, since white noise is still in it; NaN where the recording is too short."""

    def triads(self) -> NoiseDensity:
        """Return one density a triad."""
        force, rate = np.sqrt(np.mean(self.density.reshape(2, 3) ** 2, axis=1))
        return NoiseDensity(float(force), float(rate))


def fill_gaps(means: FloatArray) -> FloatArray:
    """Return the means with lost seconds interpolated, shape (n, 6)."""
    there = np.isfinite(means).all(axis=1)
    if there.all() or not there.any():
        return means
    index = np.arange(len(means))
    return np.column_stack([np.interp(index, index[there], column[there]) for column in means.T])


def moving_seconds(means: FloatArray) -> NDArray[np.bool_]:
    """Return which seconds are no rest, shape (n,)."""
    filled = fill_gaps(means)
    noise = measure_density(filled)
    limit_rate = np.maximum(MOVED_RATE_RAD_S, _MOVED_SIGMAS * noise[3:])
    limit_force = np.maximum(MOVED_FORCE_M_S2, _MOVED_SIGMAS * noise[:3])
    turning = np.abs(filled[:, 3:] - np.median(filled[:, 3:], axis=0)) > limit_rate
    tilting = np.zeros_like(turning)
    tilting[_FORCE_LAG:] = np.abs(filled[_FORCE_LAG:, :3] - filled[:-_FORCE_LAG, :3]) > limit_force
    moving: NDArray[np.bool_] = np.any(turning | tilting, axis=1)
    return moving


def measure_density(means: FloatArray) -> FloatArray:
    """Return the white noise of each axis from neighbouring means, per sqrt(Hz), shape (6,); a few jumps do not count."""
    if len(means) < 2:
        return np.zeros(6)
    apart = np.abs(np.diff(means, axis=0))
    # The median of a normal variable's size is 0.6745 sigma; a difference has twice the variance.
    deviation: FloatArray = np.median(apart, axis=0) / 0.6744897501960817 / np.sqrt(2)
    return np.asarray(deviation * np.sqrt(SECOND_S))


def measure_noise(means: FloatArray) -> RestNoise:
    """Return the noise of an undisturbed stretch, shape (n, 6)."""
    filled = fill_gaps(means)
    density = measure_density(filled)
    if len(filled) < _SHORTEST_FOR_FLOOR:
        return RestNoise(density, np.full(6, np.nan))
    lowest = np.full(6, np.inf)
    factor = 16
    while len(filled) // factor >= 5:
        rows = filled[: len(filled) // factor * factor].reshape(-1, factor, 6).mean(axis=1)
        lowest = np.minimum(lowest, np.sqrt(np.mean(np.diff(rows, axis=0) ** 2, axis=0) / 2))
        factor *= 2
    return RestNoise(density, lowest / _FLOOR)
