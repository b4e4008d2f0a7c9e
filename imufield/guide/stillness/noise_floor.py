"""The noise floor: what the instrument shows when nothing moves. Every stillness limit is measured against it.

Which stretch is quiet is not known beforehand, and the unit of an instrument may be unknown too. A window of N
consecutive cells is taken as quiet when it agrees with itself: no cell is much noisier than the typical one, and no cell
mean strays from the window's mean by more than the noise of single samples (hands do far more) or a small absolute
amount, for instruments limited by quantisation whose variance can be 0. The first such window sets the floor, so a live
session starts after N cells; a clearly quieter stretch found later lowers it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imufield.dataclass import dataclass
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import CELL_S, FloatArray, median

# Length of the quiet stretch that sets the noise floor: no hand keeps still for so long, and 30 cells tell a variance.
FLOOR_S = 3.0
# Largest variance of a cell over the window's median; 30 cells of 10 samples of white noise stay below 2.3.
_NOISIEST_CELL = 3.0
_NOISIEST_CELL_FEW = 12.0  # The same for cells of few samples, whose variances scatter much more.
FEW_SAMPLES = 8  # In a cell: with fewer its mean is nearly as noisy as a sample, and its variance is known badly.
_TOO_FEW_FOR_VARIANCE = 4  # In a cell: with fewer the scatter comes from the differences between cells.
_STRAY_SIGMAS = 1.5  # Of the noise of single samples: with 10 samples in a cell this is 4.7 sigma of a cell mean.
_STRAY_SIGMAS_OF_MEAN = 4.7  # The same stated for the mean of a cell, whatever its number of samples.
# Variance of the cell means over half their squared successive difference: 1 for noise (30 cells of three axes stay below 1.5),
# 5 for a sway of 1 Hz in cells of 0.1 s.
_WHITE = 2.0
# A later stretch replaces the floor when the variances of one triad are below this share of it, and the other's not above it
# by more than chance.
_QUIETER = 0.5
_NOT_LOUDER = 1.2
# RMS of single samples above which a stretch is no noise floor: three times what consumer MEMS show, 0.12 m/s^2 and 0.01 rad/s
# (mikoff's MPU-9150, 2000 Hz unfiltered parts). The gyroscope's tells a hand, whose tremor of 0.05 degree rms at 10 Hz makes
# 0.05 rad/s; of the force it makes 0.2 m/s^2 at 6 cm from the pivot, which may be noise.
MAX_FLOOR_M_S2 = 0.35
MAX_FLOOR_RAD_S = 0.035
# Absolute straying of a cell mean that is always allowed: below what a hand can do in 3 s.
_STRAY_M_S2 = 0.02
_STRAY_RAD_S = 0.01
_TRIADS = (slice(0, 3), slice(3, 6))


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFloor:
    """Noise of a quiet stretch; arrays hold accelerometer x, y, z, gyroscope x, y, z in raw rates, NaN where absent.

    Attributes
    ----------
    sigma : ndarray, shape (6,)
        Of single samples.
    cell_sigma : ndarray, shape (6,)
        Of cell means.
    step : ndarray, shape (6,)
        Smallest change of the output: an upper bound of its resolution; inf where it never changed.
    mean : ndarray, shape (6,)
    samples_per_cell : float
    start_s, duration_s : float
    """

    sigma: FloatArray
    cell_sigma: FloatArray
    step: FloatArray
    mean: FloatArray
    samples_per_cell: float
    start_s: float
    duration_s: float

    @property
    def has_gyroscope(self) -> bool:
        """Whether the gyroscope delivered values."""
        return bool(np.isfinite(self.sigma[3:]).all())

    @property
    def triads(self) -> tuple[slice, ...]:
        """Columns of the triads that delivered values."""
        return _TRIADS if self.has_gyroscope else _TRIADS[:1]

    @property
    def known_step(self) -> FloatArray:
        """``step``, 0 where the output never changed."""
        return np.where(np.isfinite(self.step), self.step, 0.0)

    def white_noise(self, scale: RoughScale) -> float:
        """Return the accelerometer's noise, mean of its axes, m/s^2 per sqrt(Hz); infinite where the scale is not known."""
        if not scale.accelerometer:
            return math.inf
        return math.sqrt(float(np.mean(self.cell_sigma[:3] ** 2)) * CELL_S) / scale.accelerometer


def measure_floor(cells: Cells) -> NoiseFloor:
    """Return the floor of cells that count as quiet; at least two."""
    variance = np.asarray(median(cells.variance))
    # The median of chi-squared lies below its mean; the mean is right, but one bump would spoil it.
    variance = np.maximum(variance, np.minimum(cells.variance.mean(axis=0), 1.5 * variance))
    per_cell = float(median(cells.usable))
    if per_cell < FEW_SAMPLES:
        # A small number counts with its fraction: 25 Hz make 2 and 3 in turn.
        per_cell = max(float(cells.usable.sum()) / float(cells.slot[-1] - cells.slot[0] + 1), 1.0)
    means = cells.mean
    # Half the squared successive difference: the same as the variance for noise, and blind to a slow drift.
    successive = np.sqrt(np.mean(np.diff(means, axis=0) ** 2, axis=0) / 2)
    if per_cell < _TOO_FEW_FOR_VARIANCE:
        variance = np.maximum(variance, successive**2 * per_cell)
    cell_sigma = np.maximum(successive, np.sqrt(variance / per_cell))
    absent = np.isnan(means).any(axis=0)
    return NoiseFloor(
        sigma=np.where(absent, np.nan, np.sqrt(variance)),
        cell_sigma=np.where(absent, np.nan, cell_sigma),
        step=cells.step.min(axis=0),
        mean=means.mean(axis=0),
        samples_per_cell=per_cell,
        start_s=float(cells.start_s[0]),
        duration_s=float(cells.end_s[-1] - cells.start_s[0]),
    )


def is_quiet(cells: Cells, scale: RoughScale) -> bool:
    """Whether a window of cells agrees with itself and can be a noise floor."""
    # At 10 Hz a sample near the edge of a slot leaves one empty.
    longest = 2 if median(cells.usable) < 2 else 1
    unbroken = bool((np.diff(cells.slot) <= longest).all()) and bool((2 * cells.usable >= median(cells.count)).all())
    if not unbroken or np.isnan(cells.mean[:, :3]).any() or not cells.usable.all() or is_frozen(cells):
        return False
    floor = measure_floor(cells)
    # A force of zero is that of no rest: it would tell neither a scale nor which side is up.
    if scale.is_zero(floor.mean[:3]):
        return False
    limits = scale.learn(floor.mean[:3]).per_axis(MAX_FLOOR_M_S2, MAX_FLOOR_RAD_S, missing=np.inf)
    plausible = all(bool((floor.sigma[triad] <= limits[triad]).all()) for triad in floor.triads)
    return plausible and is_even(cells, floor, scale)


def is_frozen(cells: Cells) -> bool:
    """Whether no output changes at all: repeated frames, which say nothing of noise."""
    return not (np.fmax.reduce(cells.high) > np.fmin.reduce(cells.low)).any()


def is_even(cells: Cells, floor: NoiseFloor, scale: RoughScale) -> bool:
    """Whether a window scatters as noise does, all alike and about one mean, however large its own floor is."""
    # One step of the output is always allowed.
    allowed = np.maximum(floor.sigma**2, floor.known_step**2)
    ratio = cells.variance / np.where(allowed > 0, allowed, np.inf)
    # The sum over the axes of a triad scatters less than each, and a motion shows in it all the same.
    if any(float(ratio[:, triad].mean(axis=1).max()) > _noisiest(floor) for triad in floor.triads):
        return False
    stray, allowed = _straying(cells, floor, scale.learn(floor.mean[:3]))
    return all(bool((stray[triad] <= allowed[triad]).all()) for triad in floor.triads)


def _noisiest(floor: NoiseFloor) -> float:
    """Return the largest variance of a cell, as a multiple of the typical one."""
    return _NOISIEST_CELL if floor.samples_per_cell >= FEW_SAMPLES else _NOISIEST_CELL_FEW


def _straying(cells: Cells, floor: NoiseFloor, scale: RoughScale) -> tuple[FloatArray, FloatArray]:
    """Return how far the cell means stray from the window's, each axis, and how far they may; shape (6,)."""
    sigmas = _STRAY_SIGMAS
    if floor.samples_per_cell < FEW_SAMPLES:
        # The means of few samples are noisy and stray farther, which is allowed to noise only.
        spread = np.var(cells.mean, axis=0, ddof=1)
        successive = np.mean(np.diff(cells.mean, axis=0) ** 2, axis=0) / 2
        if not any(float(spread[triad].sum()) > _WHITE * float(successive[triad].sum()) for triad in floor.triads):
            sigmas = max(_STRAY_SIGMAS, _STRAY_SIGMAS_OF_MEAN / math.sqrt(floor.samples_per_cell))
    always = scale.per_axis(_STRAY_M_S2, _STRAY_RAD_S, missing=0.0)
    allowed = np.maximum(sigmas * np.maximum(floor.sigma, floor.known_step), always)
    stray: FloatArray = np.abs(cells.mean - floor.mean).max(axis=0)
    return stray, allowed


class Unquiet(NamedTuple):
    """What keeps a window from being a noise floor; raw rates."""

    shakes: bool
    """The scatter is too large; otherwise the mean does not stay where it is."""
    column: int
    """Number of the axis: accelerometer x, y, z, gyroscope x, y, z."""
    measured: float
    limit: float


def why_not_quiet(cells: Cells, scale: RoughScale) -> Unquiet | None:
    """Return what departs most from a noise floor in a window of two cells or more; None where nothing does."""
    floor = measure_floor(cells)
    scale = scale.learn(floor.mean[:3])
    pairs = (
        (True, floor.sigma, scale.per_axis(MAX_FLOOR_M_S2, MAX_FLOOR_RAD_S, missing=np.inf)),
        (True, np.sqrt(cells.variance.max(axis=0)), math.sqrt(_noisiest(floor)) * np.fmax(floor.sigma, floor.known_step)),
        (False, *_straying(cells, floor, scale)),
    )
    found = [
        Unquiet(shakes, column, float(measured[column]), float(limit[column]))
        for shakes, measured, limit in pairs
        for column in range(6)
        if measured[column] > limit[column] > 0
    ]
    return max(found, key=lambda cause: cause.measured / cause.limit, default=None)


def is_quieter(floor: NoiseFloor, than: NoiseFloor) -> bool:
    """Whether a floor is clearly below another, in one triad at least, and above it in none."""
    shares = []
    for triad in _TRIADS:
        old, new = float((than.sigma[triad] ** 2).sum()), float((floor.sigma[triad] ** 2).sum())
        if np.isfinite(old) and np.isfinite(new) and old > 0:
            shares.append(new / old)
    return bool(shares) and min(shares) < _QUIETER and max(shares) < _NOT_LOUDER
