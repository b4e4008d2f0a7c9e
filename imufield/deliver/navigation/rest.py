"""What an instrument at rest does second by second: means, whether it was moved, its noise.

Bias instability. The lowest point of the Allan deviation has white noise in it: of a navigation-grade gyroscope in five hours
it is 1.5 times the instability, and a forecast made with it held 100 of 100 instruments where it says 95. So both are fitted
to the overlapped Allan variance q at octaves of t, ``q(t) = N^2 / t + (2 ln 2 / pi) B^2`` [1]_, each point weighted by its
degrees of freedom [2]_. What is returned is the root of the mean of B^2 given the fit and that it is not negative: near
the fitted value where the recording shows it, and as large as could have been overlooked where it does not.

References
----------
.. [1] IEEE Std 952-2020, annex C.
.. [2] W. J. Riley, "Handbook of Frequency Stability Analysis", NIST Special Publication 1065, 2008: table 5, white FM.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.noise.noise_fit import FLICKER
from imufield.dataclass import dataclass
from imufield.deliver.navigation.alignment import NoiseDensity
from imufield.samples import FloatArray, IntArray, median

SECOND_S = 1.0
MOVED_RATE_RAD_S = np.radians(0.3)  # 70 times the Earth's rate, and far below what a hand does.
MOVED_FORCE_M_S2 = 0.05
"""Changes above these, and above eight times the noise, are no drift of an instrument at rest."""
# Noise of one-second means that no instrument at rest exceeds and every hand does.
_MOST_FORCE_NOISE_M_S2 = 0.02  # 2 mg: the poorest MEMS have 0.5 mg.
_MOST_RATE_NOISE_RAD_S = np.radians(0.1)  # The poorest MEMS have 0.03 deg/s.
_MOVED_SIGMAS = 8.0  # Of 18,000 seconds with six axes not one passes it by chance.
_FORCE_LAG = 10  # Seconds over which the specific force is compared with itself: temperature is slower, a hand is faster.
_SHORTEST_FOR_FLICKER = 600  # Seconds: below, there is nothing but white noise to be seen.
_SHARED = 1.8  # Octaves share data: B^2 of 82 simulated recordings scattered so much more than it would if they did not.
_PASSES = 6  # Of the weights, which depend on the fit.


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
        # Sum and number of samples by interval, those without any left out.
        self._intervals: dict[int, tuple[FloatArray, float]] = {}

    def feed(self, time_s: FloatArray, values: FloatArray) -> None:
        """Take samples of rising time, shape (n,) and (n, columns)."""
        slot = np.floor((time_s - self.start_s) / self.interval_s).astype(np.int64)
        first = np.flatnonzero(np.diff(slot, prepend=slot[:1] - 1))
        sums = np.add.reduceat(values, first, axis=0)
        counts = np.diff(first, append=len(slot)).astype(np.float64)
        for number, total, count in zip(slot[first].tolist(), sums, counts.tolist(), strict=True):
            before, so_far = self._intervals.get(number, (np.zeros(self._columns), 0.0))
            self._intervals[number] = (before + total, so_far + count)

    def finish(self) -> FloatArray:
        """Return the means of all complete intervals, shape (m, columns); NaN where one had no sample."""
        numbers, filled = self.filled()
        means = np.full((max(self._intervals, default=0), self._columns), np.nan)
        means[numbers] = filled
        return means

    def filled(self) -> tuple[IntArray, FloatArray]:
        """Return the numbers of the complete intervals that had samples, shape (k,), and their means, shape (k, columns)."""
        # The last interval may still get samples; time rises, so it is the last one here, too.
        numbers = list(self._intervals)[:-1]
        means = [total / count for total, count in list(self._intervals.values())[:-1]]
        return np.array(numbers, dtype=np.int64), np.array(means).reshape(-1, self._columns)


@dataclass(frozen=True, slots=True)
class RestNoise:
    """Noise of each axis, shape (6,): three m/s^2, three rad/s."""

    density: FloatArray
    """White noise, per sqrt(Hz)."""
    instability: FloatArray
    """Bias instability; NaN where the recording is too short to say anything."""

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
    limit_rate = np.maximum(MOVED_RATE_RAD_S, _MOVED_SIGMAS * np.minimum(noise[3:], _MOST_RATE_NOISE_RAD_S))
    limit_force = np.maximum(MOVED_FORCE_M_S2, _MOVED_SIGMAS * np.minimum(noise[:3], _MOST_FORCE_NOISE_M_S2))
    turning = np.abs(filled[:, 3:] - median(filled[:, 3:])) > limit_rate
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
    deviation: FloatArray = median(apart) / 0.6744897501960817 / np.sqrt(2)
    return np.asarray(deviation * np.sqrt(SECOND_S))


def measure_noise(means: FloatArray) -> RestNoise:
    """Return the noise of an undisturbed stretch, shape (n, 6)."""
    filled = fill_gaps(means)
    density = measure_density(filled)
    if len(filled) < _SHORTEST_FOR_FLICKER:
        return RestNoise(density, np.full(6, np.nan))
    tau_s, variance = allan_variance(filled)
    return RestNoise(density, np.array([_instability(tau_s, column, len(filled)) for column in variance.T]))


def allan_variance(means: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return averaging times, shape (m,), and the overlapped Allan variance there, shape (m, columns)."""
    # Starting from zero keeps the running sum small against its rounding.
    sums = np.vstack([np.zeros((1, means.shape[1])), np.cumsum(means - means[0], axis=0)])
    factors = 2 ** np.arange(int(np.log2(len(means) // 3)) + 1)
    second = (sums[2 * m :] - 2 * sums[m:-m] + sums[: -2 * m] for m in factors)
    variance = [np.mean((change / m) ** 2, axis=0) / 2 for m, change in zip(factors, second, strict=True)]
    return np.asarray(factors * SECOND_S, dtype=np.float64), np.array(variance)


def _instability(tau_s: FloatArray, variance: FloatArray, seconds: int) -> float:
    """Return the root of the expected B^2."""
    if not variance.any():
        return 0.0
    m = tau_s / SECOND_S
    freedom = np.maximum((3 * (seconds - 1) / (2 * m) - 2 * (seconds - 2) / seconds) * 4 * m**2 / (4 * m**2 + 5), 1.0)
    X = np.column_stack([1 / tau_s, np.full_like(tau_s, FLICKER)])
    squares, A, expected = np.zeros(2), X, variance
    for _ in range(_PASSES):
        # A variance with f degrees of freedom is known to sqrt(2 / f) of what it is, not of how it came out.
        weight = np.sqrt(freedom / 2) / np.maximum(expected, 1e-6 * variance.max())
        A = X * weight[:, None]
        squares = np.linalg.lstsq(A, variance * weight, rcond=None)[0]
        expected = X @ np.maximum(squares, 0.0)
    sigma = _SHARED * math.sqrt(np.linalg.inv(A.T @ A)[1, 1])
    # The mean of what is left of a normal distribution above zero; beyond z = -30 that is too little for a float.
    z = max(float(squares[1]) / sigma, -30.0)
    above = math.erfc(-z / math.sqrt(2)) / 2
    return math.sqrt(sigma * (z + math.exp(-(z**2) / 2) / math.sqrt(2 * math.pi) / above))
