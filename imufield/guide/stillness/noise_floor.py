"""The noise floor: what the instrument shows when nothing moves. Every stillness limit is measured against it.

Which stretch is quiet is not known beforehand, and the unit of an instrument may be unknown too. A window of N
consecutive cells is taken as quiet when it agrees with itself: no cell is much noisier than the typical one, and no cell
mean strays from the window's mean by more than the noise of single samples (hands do far more) or a small absolute
amount, for instruments limited by quantisation whose variance can be 0. The first such window sets the floor, so a live
session starts after N cells; a clearly quieter stretch found later lowers it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray

# Largest variance of a cell over the window's median; 30 cells of 10 samples of white noise stay below 2.3.
_NOISIEST_CELL = 3.0
_NOISIEST_CELL_FEW = 12.0  # The same for cells of few samples, whose variances scatter much more.
FEW_SAMPLES = 8
"""In a cell: with fewer its mean is nearly as noisy as a sample, and its variance is known badly."""
_TOO_FEW_FOR_VARIANCE = 4  # In a cell: with fewer the scatter comes from the differences between cells.
_STRAY_SIGMAS = 1.5  # Of the noise of single samples: with 10 samples a cell that is 4.7 sigma of a cell mean.
_STRAY_SIGMAS_OF_MEAN = 4.7
# Variance of the cell means over half their squared successive difference: 1 for noise (30 cells of three axes stay below 1.5),
# 5 for a sway of 1 Hz in cells of 0.1 s.
_WHITE = 2.0
_QUIETER = 0.5  # A later stretch replaces the floor when its variances are below this share of it.

MAX_FLOOR_M_S2 = 0.35
MAX_FLOOR_RAD_S = 0.035
"""Rms of single samples above which a stretch is no noise floor: consumer MEMS show 0.12 m/s^2 and 0.01 rad/s (mikoff's
MPU-9150, 2000 Hz unfiltered parts), a unit in the hand 0.2 m/s^2 and 0.05 rad/s (tremor of 0.05 degree at 10 Hz)."""
STRAY_M_S2 = 0.02
STRAY_RAD_S = 0.01
"""Absolute straying of a cell mean always allowed: below what a hand can do in 3 s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFloor:
    """What a quiet stretch showed; arrays hold accelerometer x, y, z, gyroscope x, y, z in raw rates, NaN where absent.

    Attributes
    ----------
    sigma : ndarray, shape (6,)
        Of single samples.
    cell_sigma : ndarray, shape (6,)
        Of cell means.
    step : ndarray, shape (6,)
        Smallest change of the output seen: one step at most; inf where it never changed.
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


def measure_floor(cells: Cells) -> NoiseFloor:
    """Return the floor shown by cells that are taken as quiet; at least two."""
    variance = np.asarray(np.median(cells.variance, axis=0))
    # The median of chi-squared lies below its mean; the mean is right, but one bump would spoil it.
    variance = np.maximum(variance, np.minimum(cells.variance.mean(axis=0), 1.5 * variance))
    per_cell = _samples_per_cell(cells)
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


def _samples_per_cell(cells: Cells) -> float:
    """Return the usual number; where it is small, with its fraction: 25 Hz make 2 and 3 in turn."""
    usual = float(np.median(cells.usable))
    if usual >= FEW_SAMPLES:
        return usual
    return max(float(cells.usable.sum()) / float(cells.slot[-1] - cells.slot[0] + 1), 1.0)


def is_quiet(cells: Cells, scale: RoughScale) -> bool:
    """Whether a window of cells agrees with itself and can be a noise floor."""
    # At 10 Hz a sample near the edge of a slot leaves one empty.
    longest = 2 if np.median(cells.usable) < 2 else 1
    unbroken = bool((np.diff(cells.slot) <= longest).all()) and bool((2 * cells.usable >= np.median(cells.count)).all())
    if not unbroken or np.isnan(cells.mean[:, :3]).any() or not cells.usable.all():
        return False
    columns = 6 if np.isfinite(cells.mean[:, 3:]).all() else 3
    floor = measure_floor(cells)
    return (
        _is_plausible(floor, scale.learn(floor.mean[:3]), columns)
        and _is_steady(cells, floor, columns)
        and _does_not_stray(cells, floor, scale.learn(floor.mean[:3]), columns)
    )


def _is_plausible(floor: NoiseFloor, scale: RoughScale, columns: int) -> bool:
    limits = _per_axis(scale, MAX_FLOOR_M_S2, MAX_FLOOR_RAD_S, missing=np.inf)
    return bool((floor.sigma[:columns] <= limits[:columns]).all())


def _is_steady(cells: Cells, floor: NoiseFloor, columns: int) -> bool:
    """Whether no cell is much noisier than the typical one; one step of the output is always allowed."""
    factor = _NOISIEST_CELL if floor.samples_per_cell >= FEW_SAMPLES else _NOISIEST_CELL_FEW
    step = np.where(np.isfinite(floor.step), floor.step, 0.0)
    allowed = np.maximum(floor.sigma**2, step**2)[:columns]
    ratio = cells.variance[:, :columns] / np.where(allowed > 0, allowed, np.inf)
    # The sum over the axes of a triad scatters less than each, and a motion shows in it all the same.
    return all(float(ratio[:, triad].mean(axis=1).max()) <= factor for triad in _triads(columns))


def _does_not_stray(cells: Cells, floor: NoiseFloor, scale: RoughScale, columns: int) -> bool:
    stray, allowed = _straying(cells, floor, scale)
    return bool((stray[:columns] <= allowed[:columns]).all())


def _straying(cells: Cells, floor: NoiseFloor, scale: RoughScale) -> tuple[FloatArray, FloatArray]:
    """Return how far the cell means stray from the window's, each axis, and how far they may; shape (6,)."""
    step = np.where(np.isfinite(floor.step), floor.step, 0.0)
    sigmas = _stray_sigmas(cells, floor)
    allowed = np.maximum(sigmas * np.maximum(floor.sigma, step), _per_axis(scale, STRAY_M_S2, STRAY_RAD_S, missing=0.0))
    stray: FloatArray = np.abs(cells.mean - floor.mean).max(axis=0)
    return stray, allowed


def _stray_sigmas(cells: Cells, floor: NoiseFloor) -> float:
    """Return how many sigma of single samples a cell mean may stray; more for noisy means of few samples, if it is noise."""
    if floor.samples_per_cell >= FEW_SAMPLES:
        return _STRAY_SIGMAS
    spread = np.var(cells.mean, axis=0, ddof=1)
    successive = np.mean(np.diff(cells.mean, axis=0) ** 2, axis=0) / 2
    columns = 6 if floor.has_gyroscope else 3
    if any(float(spread[triad].sum()) > _WHITE * float(successive[triad].sum()) for triad in _triads(columns)):
        return _STRAY_SIGMAS
    return max(_STRAY_SIGMAS, _STRAY_SIGMAS_OF_MEAN / math.sqrt(floor.samples_per_cell))


def is_even(cells: Cells, scale: RoughScale) -> bool:
    """Whether a window scatters as noise does, all alike and about one mean, however large it is."""
    floor = measure_floor(cells)
    columns = 6 if floor.has_gyroscope else 3
    return _is_steady(cells, floor, columns) and _does_not_stray(cells, floor, scale.learn(floor.mean[:3]), columns)


class Unquiet(NamedTuple):
    """What keeps a window from being a noise floor; raw rates."""

    shakes: bool
    """Too large a scatter; else it does not stay where it is."""
    column: int
    """Of the axis: accelerometer x, y, z, gyroscope x, y, z."""
    measured: float
    limit: float


def why_not_quiet(cells: Cells, scale: RoughScale) -> Unquiet | None:
    """Return what departs most from a noise floor in a window of two cells or more; None where nothing does."""
    floor = measure_floor(cells)
    scale = scale.learn(floor.mean[:3])
    factor = _NOISIEST_CELL if floor.samples_per_cell >= FEW_SAMPLES else _NOISIEST_CELL_FEW
    step = np.where(np.isfinite(floor.step), floor.step, 0.0)
    pairs = (
        (True, floor.sigma, _per_axis(scale, MAX_FLOOR_M_S2, MAX_FLOOR_RAD_S, missing=np.inf)),
        (True, np.sqrt(cells.variance.max(axis=0)), math.sqrt(factor) * np.fmax(floor.sigma, step)),
        (False, *_straying(cells, floor, scale)),
    )
    found = [
        Unquiet(shakes, column, float(measured[column]), float(limit[column]))
        for shakes, measured, limit in pairs
        for column in range(6)
        if measured[column] > limit[column] > 0
    ]
    return max(found, key=lambda one: one.measured / one.limit, default=None)


def _triads(columns: int) -> list[slice]:
    return [slice(0, 3), slice(3, 6)][: columns // 3]


def _per_axis(scale: RoughScale, accelerometer_m_s2: float, gyroscope_rad_s: float, *, missing: float) -> FloatArray:
    """Return SI amounts in raw units, shape (6,), ``missing`` where the scale is not known."""
    accelerometer = missing if scale.accelerometer is None else accelerometer_m_s2 * scale.accelerometer
    gyroscope = missing if scale.gyroscope is None else gyroscope_rad_s * scale.gyroscope
    return np.repeat([accelerometer, gyroscope], 3)


def is_quieter(floor: NoiseFloor, than: NoiseFloor) -> bool:
    """Whether one floor lies clearly below another, for one triad at least and above it for none."""
    shares = []
    for triad in (slice(0, 3), slice(3, 6)):
        old, new = float((than.sigma[triad] ** 2).sum()), float((floor.sigma[triad] ** 2).sum())
        if np.isfinite(old) and np.isfinite(new) and old > 0:
            shares.append(new / old)
    return bool(shares) and min(shares) < _QUIETER and max(shares) < 1.2
