"""Limits of stillness, from the measured noise floor and absolute allowances, and how a cell compares with them."""

from __future__ import annotations

import math

import numpy as np

from imufield.dataclass import dataclass
from imufield.guide.refusals import Refusal, RefusalKind
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray

# Multiples of the noise floor. A variance scatters by chance, hence ``scatter_of_variance`` where cells hold few samples.
_VIBRATION_SIGMAS = 2.0
_CHANGE_SIGMAS = 5.0
# Change ratio allowed against the gyroscope's last known bias: g-sensitivity and temperature change it between two stills.
_OFFSET_RATIO = 1.5
# Without a known scale the limit is a multiple of the noise alone: a quiet MEMS gyroscope changes by that from side to side.
_OFFSET_RATIO_UNSCALED = 15.0
# And one with a g-sensitivity of some deg/s/g by that; what turns there as slowly has rested on that side before.
_OFFSET_RATIO_OTHER_SIDE = 100.0
OTHER_SIDE = 0.2
"""Change of the force, relative to it, from which on another side is up: 11 degrees."""
_UNLIKELY = 14.0  # exp(-14) is once in a million cells.


@dataclass(frozen=True, slots=True, kw_only=True)
class Allowances:
    """What a unit may do and still count as still, whatever its noise floor; no recording known to us needs other values.

    Attributes
    ----------
    dwell_s : float
        The activity stays at or below 1 for this time before a stretch counts as still. The stretch begins with its first cell.
    reach_back_s : float
        Once a stretch counts as still, the cells of this time before it join it as far as they would not have ended it.
    vibration_m_s2, vibration_rad_s : float
        RMS per axis.
    change_m_s2, change_rad_s : float
        Size of the vector.
    """

    dwell_s: float
    reach_back_s: float
    vibration_m_s2: float
    change_m_s2: float
    vibration_rad_s: float
    change_rad_s: float


# A table that trembles by 5 mg under a navigation-grade instrument is still a table; a unit held against an edge passes, too.
ON_TABLE = Allowances(
    dwell_s=0.5,
    reach_back_s=0.0,
    vibration_m_s2=0.05,
    change_m_s2=0.03,
    vibration_rad_s=math.radians(1.5),
    change_rad_s=math.radians(1.0),
)
# Tremor of 0.1 deg rms at 12 Hz is 7.5 deg/s, in a cell by chance up to 10, and 1 m/s^2 where the pivot is 10 cm away. Sway of
# 1 deg rms about each axis, from 0.1 to 2 Hz with amplitudes that fall as 1/f, makes 6 deg/s rms and changes the force by
# 0.24 m/s^2 rms, by 0.37 and more in 5 % of the time. A slow turn is no faster than that, so the hand must keep it up for
# longer. A hand that sways that much exceeds the limits now and then before it has kept still for so long, and is a still hand
# all the same: hence the reach back. What it adds of the turn, ``hand_edges`` cuts off again.
IN_HAND = Allowances(
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
    """Largest change ratio of the gyroscope against its last known bias."""
    offset_on_other_side: float
    """The same where another side is up than in the stretch that shows it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Activity:
    """The largest of the ratios of a cell, and what it was measured on.

    Attributes
    ----------
    kind : "vibration" or "change"
    triad : "accelerometer" or "gyroscope"
    axis : str
        The axis that contributes most.
    measured : float
        Ratio times limit, in ``unit``: the rms over the axes (vibration) or the size of the vector (change).
    """

    ratio: float
    kind: str
    triad: str
    axis: str
    measured: float
    limit: float
    unit: str

    def refusal(self, kind: RefusalKind, factor: float = 1.0, **values: float | str) -> Refusal:
        """Return the refusal of this motion, beyond a multiple of its limit."""
        values = {**values, "triad": self.triad, "motion": self.motion}
        return kind.refusal(self.measured, factor * self.limit, axis=self.axis, unit=self.unit, **values)

    @property
    def motion(self) -> str:
        """What it is in words."""
        if self.kind == "vibration":
            return "vibration"
        return "slow change" if self.triad == "accelerometer" else "rotation"


def noise_limits(floor: NoiseFloor, scale: RoughScale, allowances: Allowances = ON_TABLE) -> Limits:
    """Return the limits for a noise floor: a multiple of it, or the allowance where that is larger."""
    vibration = scale.per_axis(allowances.vibration_m_s2, allowances.vibration_rad_s, missing=0.0)
    change = scale.per_axis(allowances.change_m_s2, allowances.change_rad_s, missing=0.0)
    # Rounding to steps of the output makes up to half a step of scatter.
    least = floor.known_step / 2
    sigmas = max(_VIBRATION_SIGMAS, scatter_of_variance(3 * (floor.samples_per_cell - 1)))
    vibration = np.maximum(vibration, sigmas * np.maximum(floor.sigma, least))
    change = np.maximum(change, _CHANGE_SIGMAS * np.maximum(floor.cell_sigma, least))
    return Limits(
        # An axis that shows no noise and has no known scale (a dead one) sets no limit.
        np.where(vibration > 0, vibration, np.inf),
        np.where(change > 0, change, np.inf),
        _OFFSET_RATIO if scale.gyroscope else _OFFSET_RATIO_UNSCALED,
        _OFFSET_RATIO if scale.gyroscope else _OFFSET_RATIO_OTHER_SIDE,
    )


def scatter_of_variance(freedom: float) -> float:
    """Return the factor on sigma that a sample variance exceeds once in a million cells.

    Laurent and Massart, Ann. Statist. 28(5), 2000, lemma 1: P(chi2_k >= k + 2 sqrt(k x) + 2 x) <= exp(-x).
    """
    if freedom <= 0:
        return 0.0
    return math.sqrt(1 + 2 * math.sqrt(_UNLIKELY / freedom) + 2 * _UNLIKELY / freedom)


def vibration_ratio(variance: FloatArray, limits: Limits) -> FloatArray:
    """Return the larger vibration ratio of the two triads for the variances of each cell, shape (m, 6) to (m,)."""
    share = variance / limits.vibration**2
    # A missing gyroscope has no limit (NaN) and no share.
    share[np.isnan(share)] = 0.0
    ratio: FloatArray = np.sqrt(share.reshape(-1, 2, 3).mean(axis=2).max(axis=1))
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
    for (triad, unit, factor), axes in zip(scale.triads, (slice(0, 3), slice(3, 6)), strict=True):
        for kind, ratios, limit in (("vibration", vibration, limits.vibration), ("change", change, limits.change)):
            parts = np.nan_to_num(ratios[axes])
            ratio = float(np.sqrt((parts**2).mean() if kind == "vibration" else (parts**2).sum()))
            # A dead axis has no limit and no say in that of its triad.
            finite = limit[axes][np.isfinite(limit[axes])]
            in_unit = float(np.sqrt((finite**2).mean())) / factor if len(finite) else math.inf
            axis, measured = AXES[int(np.argmax(parts))], ratio * in_unit
            found.append(Activity(ratio=ratio, kind=kind, triad=triad, axis=axis, measured=measured, limit=in_unit, unit=unit))
    return max(found, key=lambda activity: activity.ratio)
