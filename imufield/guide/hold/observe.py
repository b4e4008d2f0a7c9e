"""Observations from still stretches: which cells count, their mean, and the covariance of that mean.

A stretch has passed limits wide enough for a unit held against an edge. Here it is judged by its own standard: the typical
(median) vibration and change of its cells. At both ends the cells that stand out are cut off together with the guard band
(a box that rocks to rest, a hand that comes near); cells inside that stand out (a knock on the table) are left out of the
mean, and where they are many the stretch is refused.

Neighbouring cell means are not independent (bandwidth of the instrument, flicker noise, tremor), so the covariance of the
mean of N cells is C0 / N times 1 + 2 (rho_1 + rho_2 + ...) for each axis, the sum cut off where a pair of successive
autocorrelations turns negative [1]_. It is never less than white noise would give.

Rounding of the output comes to that. A silent output is off by q / sqrt(12), 1 sigma, with its step q. Gaussian noise of s
spreads the reading over the steps, and leaves exp(-2 pi^2 (s / q)^2) of it [2]_, which no further sample averages out. What the
output scatters tells s only beyond the two codes about the mean: they alone show anything up to half a step, whatever s is.

The mean is that of the vector as measured: right for a unit that is placed. A unit in the hand wobbles, which shortens the
mean vector; ``hand_mean`` turns every sample of such a hold into one frame first.

References
----------
.. [1] C. J. Geyer, "Practical Markov chain Monte Carlo", Statistical Science 7(4), 1992: initial positive sequence.
.. [2] B. Widrow, I. Kollar, "Quantization Noise", Cambridge University Press, 2008: the mean of a dithered quantiser.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.observations import ROUNDING, Observations
from imufield.dataclass import dataclass
from imufield.guide.hold.hand_mean import HandMean
from imufield.guide.hold.output import HoldOutput
from imufield.guide.stillness.cells import Cells, cells_in
from imufield.guide.stillness.limits import Limits, scatter_of_variance
from imufield.samples import FloatArray, SampleUnits, median

_GUARD_S = 0.3  # Cut off at both ends of a stretch: the hand that leaves, the hand that comes.
_GUARD_WITHOUT_GYROSCOPE_S = 0.8  # The same where only the accelerometer tells: a slow turn begins below its noise.
_SETTLE_S = 1.0  # Within this time of both ends, everything outside the outermost cell that stands out is cut off.
# The median of the length of a 3-D Gaussian vector is 1.54 sigma; 5.4 sigma are exceeded once in a million cells.
_CHANGE_OVER_MEDIAN = 3.5
_VIBRATION_OVER_MEDIAN = 1.25  # Times the scatter of a variance: the median of a stretch is itself known from some cells only.
_LEAST_RATIO = 0.1  # Nothing below this share of the detector's limit stands out: a perfectly quiet output has a median of 0.
_KNOCK_RATIO = 2.0  # A cell inside that stands out this far holds a knock; less is the scatter of a long stretch.
UNKNOWN_RESOLUTION = 1e-6  # Of the reading: resolution assumed where the output never changed.
_NORMAL = NormalDist()
_FEWEST_BEYOND = 1e-15  # Share of the samples: none, as far as the rounding of numbers lets it be seen.
_MOST_BEYOND = 0.4999  # So many that rounding is nothing.
# Of the fields of one observation that the solvers take as arrays.
_SHAPES: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("mean_raw", "gyroscope_mean_raw", "gyroscope_rounding_raw", "direction"), (3,)),
    **dict.fromkeys(("covariance_raw", "gyroscope_covariance_raw"), (3, 3)),
    **dict.fromkeys(("start_s", "duration_s", "temperature_degc"), ()),
}
# Of a unit that is placed, what a ``HandMean`` has of one in the hand.
_PLACED = {"gyroscope_noise_raw": np.full(3, np.nan), "middle_s": np.array(np.nan), "middle_rad": np.zeros(3)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """The measurement of one hold; raw rates, see ``Observations``."""

    name: str
    direction: FloatArray
    mean_raw: FloatArray
    covariance_raw: FloatArray
    gyroscope_mean_raw: FloatArray
    gyroscope_covariance_raw: FloatArray
    gyroscope_rounding_raw: FloatArray
    start_s: float
    duration_s: float
    temperature_degc: float
    output: HoldOutput
    hand_mean: HandMean | None = None
    """For a hold in the hand."""


def stand_out(cells: Cells, limits: Limits) -> FloatArray:
    """Return by how much each cell stands out of its stretch, shape (m, 4): above 1 it is not like the others.

    Columns: vibration of the accelerometer, of the gyroscope, change of the accelerometer, of the gyroscope.
    """
    squares = np.array([cells.variance / limits.vibration**2, ((cells.mean - median(cells.mean)) / limits.change) ** 2])
    # A missing gyroscope has no limit (NaN) and does not stand out.
    squares[np.isnan(squares)] = 0.0
    vibration, change = squares.reshape(2, -1, 2, 3).sum(axis=3)
    ratios = np.sqrt(np.hstack([vibration / 3, change]))
    usual, middle = float(median(cells.usable)), median(ratios)
    several = cells.usable > 1
    if usual < 2 and several.any():
        # One sample shows no vibration: cells of two are compared with each other.
        usual, middle[:2] = 2.0, median(ratios[several, :2])
    scatter = _VIBRATION_OVER_MEDIAN * scatter_of_variance(3 * (usual - 1))
    allowed = middle * [scatter, scatter, _CHANGE_OVER_MEDIAN, _CHANGE_OVER_MEDIAN]
    result: FloatArray = ratios / np.maximum(allowed, _LEAST_RATIO)
    return result


def guard_cells(limits: Limits) -> int:
    """Return the length of the guard band."""
    with_gyroscope = bool(np.isfinite(limits.change[3:]).any())
    return cells_in(_GUARD_S if with_gyroscope else _GUARD_WITHOUT_GYROSCOPE_S)


def trim_stretch(cells: Cells, limits: Limits) -> slice:
    """Return the rows of a stretch that count: without what stands out at the ends, and without the guard bands."""
    outside = np.flatnonzero(np.any(stand_out(cells, limits) > 1, axis=1))
    settle, m = cells_in(_SETTLE_S), len(cells)
    early = outside[outside < min(settle, m // 2)]
    late = outside[outside >= max(m - settle, m // 2)]
    guard = guard_cells(limits)
    start = (int(early[-1]) + 1 if len(early) else 0) + guard
    stop = (int(late[0]) if len(late) else m) - guard
    return slice(start, max(stop, start))


def knocked(cells: Cells, limits: Limits) -> NDArray[np.bool_]:
    """Return which of the trimmed cells hold a knock: the accelerometer stands out twice over, or its neighbour's does."""
    outside: NDArray[np.bool_] = np.any(stand_out(cells, limits)[:, [0, 2]] > _KNOCK_RATIO, axis=1)
    wider = outside.copy()
    wider[1:] |= outside[:-1]
    wider[:-1] |= outside[1:]
    return wider


class CellMeans(NamedTuple):
    """The mean over cells, accelerometer and gyroscope."""

    mean: FloatArray
    """Weighted by their samples, shape (6,)."""
    covariance: FloatArray
    """Of that mean, shape (6, 6)."""
    rounding: FloatArray
    """1 sigma of what rounding of the output leaves in the mean, in the covariance too, shape (6,)."""


def cell_means(cells: Cells) -> CellMeans:
    """Return the mean over cells and what is known of its errors."""
    weight = np.repeat(np.stack([cells.usable, cells.gyroscope_usable], axis=1), 3, axis=1).astype(np.float64)
    known, spare = weight > 0, (weight - 1).clip(0)
    values = np.where(known, cells.mean, 0.0)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(total > 0, (weight * values).sum(axis=0) / total, np.nan)
        pooled = (spare * cells.variance).sum(axis=0) / np.maximum(spare.sum(axis=0), 1)
        white = pooled / total
    deviation = np.where(known, values - mean, 0.0)
    m, covariance = len(deviation), np.zeros((6, 6))
    if m > 1:
        factor = np.sqrt([correlation_factor(column) for column in deviation.T])
        covariance = deviation.T @ deviation / ((m - 1) * m) * np.outer(factor, factor)
    scatter = (spare * cells.variance + weight * deviation**2).sum(axis=0) / np.maximum(total, 1)
    rounding = _rounding(cells, mean, scatter)
    covariance += np.diag(np.maximum(white - np.diag(covariance), 0.0) + rounding**2)
    absent = np.isnan(mean)
    covariance[absent, :] = np.nan
    covariance[:, absent] = np.nan
    return CellMeans(mean, covariance, rounding)


def _rounding(cells: Cells, mean: FloatArray, variance: FloatArray) -> FloatArray:
    """Return 1 sigma of what rounding leaves in means over cells whose samples scatter by that variance, shape (6,)."""
    # Between cells as well as within them: those of a slow instrument have one sample.
    change = np.abs(np.diff(cells.first, axis=0))
    step = np.fmin.reduce(np.vstack([cells.step, np.where(change > 0, change, np.inf)]))
    step = np.where(np.isfinite(step), step, UNKNOWN_RESOLUTION * np.abs(mean))
    with np.errstate(invalid="ignore", divide="ignore"):
        places = (mean - np.fmin.reduce(cells.low)) / step
        off = np.abs(places - np.rint(places))
        # Beyond the two codes about the mean, on the side of the farther one: at least (1/2 + off) steps away.
        beyond = (variance / step**2 - off * (1 - off)) / 2
    sigmas = [-_NORMAL.inv_cdf(p) for p in np.clip(np.nan_to_num(beyond), _FEWEST_BEYOND, _MOST_BEYOND).tolist()]
    noise_steps = (0.5 + np.nan_to_num(off)) / sigmas
    return np.asarray(ROUNDING * step * np.exp(-2 * (np.pi * noise_steps) ** 2))


def correlation_factor(deviation: FloatArray) -> float:
    """Return the factor by which autocorrelation raises the variance of the mean of a series (m,) with mean 0; at least 1.

    With a correlation time of a tenth of the series the sigma that follows is still about 1.5 times too small: what is
    slower than a hold shows between holds only.
    """
    m, pairs = len(deviation), max(len(deviation) // 8, 1)
    if m < 4 or not deviation.any():
        return 1.0
    by_lag = np.correlate(np.concatenate([deviation, np.zeros(2 * pairs - 1)]), deviation)
    pair = by_lag.reshape(pairs, 2).sum(axis=1) / by_lag[0]
    # Up to the first pair that is not positive.
    factor = max(2 * float(pair[np.logical_and.accumulate(pair > 0)].sum()) - 1, 1.0)
    # Deviations from the series' own mean miss the variance of that mean, the share factor / m.
    return factor / max(1 - factor / m, 0.5)


def knocks_of(cells: Cells, limits: Limits) -> FloatArray:
    """Return begin and end of the cells that hold a knock, shape (k, 2)."""
    rows = np.flatnonzero(knocked(cells, limits))
    return np.stack([cells.start_s[rows], cells.end_s[rows]], axis=1)


def observe(
    cells: Cells,
    limits: Limits,
    name: str,
    direction: FloatArray | None = None,
    *,
    hand_mean: HandMean | None = None,
    output: HoldOutput | None = None,
) -> Observation:
    """Return the observation of a trimmed stretch; cells with a knock are left out. ``output`` saves making it again."""
    out = knocked(cells, limits)
    kept = cells if not out.any() or out.all() else cells[np.flatnonzero(~out)]
    if hand_mean is None:
        mean, covariance, rounding = cell_means(kept)
    else:
        # The sway of a hand leads the output over many steps.
        rounding = np.zeros(6)
        mean = np.concatenate([hand_mean.force_raw, hand_mean.gyroscope_raw])
        covariance = np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = hand_mean.covariance_raw, hand_mean.gyroscope_covariance_raw
    warmth = kept.temperature_degc[np.isfinite(kept.temperature_degc)]
    return Observation(
        name=name,
        direction=np.full(3, np.nan) if direction is None else direction,
        mean_raw=mean[:3],
        covariance_raw=covariance[:3, :3],
        gyroscope_mean_raw=mean[3:],
        gyroscope_covariance_raw=covariance[3:, 3:],
        gyroscope_rounding_raw=rounding[3:],
        start_s=float(cells.start_s[0]),
        duration_s=float(cells.end_s[-1] - cells.start_s[0]),
        temperature_degc=float(warmth.mean()) if len(warmth) else float("nan"),
        output=output or HoldOutput.of(cells),
        hand_mean=hand_mean,
    )


def gather(observations: Sequence[Observation], units: SampleUnits) -> Observations:
    """Return observations as the arrays of the solvers."""
    count = len(observations)
    arrays: dict[str, FloatArray] = {
        # The shape is given because there may be no observation at all.
        name: np.array([getattr(observation, name) for observation in observations], dtype=np.float64).reshape(count, *shape)
        for name, shape in _SHAPES.items()
    }
    for name, placed in _PLACED.items():
        found = [getattr(observation.hand_mean, name, placed) for observation in observations]
        arrays[name] = np.array(found, dtype=np.float64).reshape(count, *placed.shape)
    return Observations(name=tuple(observation.name for observation in observations), units=units, left_out=(), **arrays)
