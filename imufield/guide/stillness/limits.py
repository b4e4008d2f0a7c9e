"""Limits of stillness, from the measured noise floor and absolute allowances, and how a cell compares with them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imufield.guide.stillness.cells import CELL_S, Cells
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class StillnessSettings:
    """Settings of the detector; the defaults need no tuning for any recording known to us."""

    cell_s: float = CELL_S
    floor_s: float = 3.0
    """Length of the quiet stretch that sets the noise floor."""
    dwell_s: float = 0.5
    """The activity stays at or below 1 for this long before a stretch counts as still; it counts from its first cell."""
    guard_s: float = 0.3
    """Cut off at both ends of a stretch: the hand that leaves, the hand that comes."""
    guard_without_gyroscope_s: float = 0.8
    """The same where only the accelerometer tells: a slow turn begins below its noise."""
    leave_factor: float = 2.0
    vibration_sigmas: float = 2.0
    change_sigmas: float = 5.0
    vibration_m_s2: float = 0.05
    change_m_s2: float = 0.03
    vibration_rad_s: float = math.radians(1.5)
    change_rad_s: float = math.radians(1.0)
    """The four absolute allowances, rms per axis for vibration, largest for change."""
    usable_fraction: float = 0.5
    """A cell with fewer usable samples than this share of the usual number counts as lost."""
    hand: bool = False
    """Bear a unit held in the hand as well, where the gyroscope's scale is known: see ``hand_settings``."""
    longest_s: float = 60.0
    """No more than this of a stretch is kept: beyond the minimum of the Allan deviation a hold gains nothing."""
    reach_back_s: float = 0.0
    """Once a stretch counts as still, cells so long before it join it as far as they would not have ended it."""

    def cells(self, duration_s: float) -> int:
        """Return a duration as a whole number of cells."""
        return round(duration_s / self.cell_s)


def hand_settings(settings: StillnessSettings) -> StillnessSettings:
    """Return the settings for a unit in the hand.

    Tremor of 0.1 deg rms at 12 Hz is 7.5 deg/s, in a cell by chance up to 10, and 1 m/s^2 where the pivot is 10 cm away; sway
    of 1 deg below 2 Hz makes 4 deg/s and changes the force by 0.4 m/s^2. A slow turn is no faster than that, so the hand must
    keep it up for longer. A hand that sways that much passes the limits now and then before it has kept still for so long, and
    is held still all the same: hence the reach back. What it takes of the turn, ``hand_edges`` cuts off again.
    """
    return replace(
        settings,
        dwell_s=1.5,
        reach_back_s=15.0,
        vibration_m_s2=1.2,
        change_m_s2=0.5,
        vibration_rad_s=math.radians(12.0),
        change_rad_s=math.radians(10.0),
    )


@dataclass(frozen=True, slots=True)
class Limits:
    """Where the activity is 1, in raw rates; arrays of shape (6,), accelerometer first."""

    vibration: FloatArray
    change: FloatArray
    gyroscope_offset: float
    """Largest change ratio of the gyroscope against its last known bias; g-sensitivity and temperature are in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Activity:
    """The largest of the ratios of a cell, with what it was measured on."""

    ratio: float
    kind: str
    """"vibration" or "change"."""
    triad: str
    """"accelerometer" or "gyroscope"."""
    axis: str
    """The axis that contributes most."""
    measured: float
    """Ratio times limit, in ``unit``: the rms over the axes (vibration) or the size of the vector (change)."""
    limit: float
    unit: str


def noise_limits(floor: NoiseFloor, scale: RoughScale, settings: StillnessSettings) -> Limits:
    """Return the limits for a noise floor."""
    allowances = (
        (settings.vibration_m_s2, settings.vibration_rad_s),
        (settings.change_m_s2, settings.change_rad_s),
    )
    vibration, change = (
        np.repeat([accelerometer * (scale.accelerometer or 0.0), gyroscope * (scale.gyroscope or 0.0)], 3)
        for accelerometer, gyroscope in allowances
    )
    step = np.where(np.isfinite(floor.step), floor.step, 0.0)
    sigmas = max(settings.vibration_sigmas, scatter_of_variance(3 * (floor.samples_per_cell - 1)))
    vibration = np.maximum(vibration, sigmas * np.maximum(floor.sigma, step / 2))
    change = np.maximum(change, settings.change_sigmas * np.maximum(floor.cell_sigma, step / 2))
    return Limits(
        # An axis that shows no noise and has no known scale (a dead one) sets no limit.
        np.where(vibration > 0, vibration, np.inf),
        np.where(change > 0, change, np.inf),
        1.5 if scale.gyroscope else 6.0,
    )


def scatter_of_variance(freedom: float) -> float:
    """Return the factor on sigma that a sample variance exceeds once in a million cells.

    Laurent and Massart, Ann. Statist. 28(5), 2000, lemma 1: P(chi2_k >= k + 2 sqrt(k x) + 2 x) <= exp(-x).
    """
    if freedom <= 0:
        return 0.0
    x = 14.0
    return math.sqrt(1 + 2 * math.sqrt(x / freedom) + 2 * x / freedom)


def vibration_ratio(cells: Cells, limits: Limits) -> FloatArray:
    """Return the larger vibration ratio of the two triads for each cell, shape (m,)."""
    share = cells.variance / limits.vibration**2
    # A missing gyroscope has no limit (NaN) and no share.
    share = np.where(np.isnan(share), 0.0, share)
    ratio: FloatArray = np.sqrt(np.maximum(share[:, :3].mean(axis=1), share[:, 3:].mean(axis=1)))
    return ratio


def largest_activity(vibration: FloatArray, change: FloatArray, limits: Limits, scale: RoughScale) -> Activity:
    """Return the largest of the four ratios and what it was measured on.

    Parameters
    ----------
    vibration, change : ndarray, shape (6,)
        Ratios of each axis.
    limits : Limits
    scale : RoughScale
    """
    found: list[Activity] = []
    for first, triad, factor, unit in (
        (0, "accelerometer", scale.accelerometer, "m/s^2"),
        (3, "gyroscope", scale.gyroscope, "rad/s"),
    ):
        axes = slice(first, first + 3)
        for kind, ratios, limit in (("vibration", vibration, limits.vibration), ("change", change, limits.change)):
            parts = np.nan_to_num(ratios[axes])
            ratio = float(np.sqrt((parts**2).mean() if kind == "vibration" else (parts**2).sum()))
            finite = limit[axes][np.isfinite(limit[axes])]
            in_unit = float(np.sqrt((finite**2).mean())) / (factor or 1.0) if len(finite) else math.inf
            axis = AXES[int(np.argmax(parts))]
            found.append(
                Activity(
                    ratio=ratio,
                    kind=kind,
                    triad=triad,
                    axis=axis,
                    measured=ratio * in_unit,
                    limit=in_unit,
                    unit=unit if factor else "raw unit",
                )
            )
    return max(found, key=lambda activity: activity.ratio)
