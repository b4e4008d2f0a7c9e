"""Gyroscope from still positions: bias, with the Earth's rate accounted for.

A still gyroscope feels the Earth's rate (7.292e-5 rad/s) alone. Of it the vertical part, ``rate sin(latitude)`` along "up", is
known in the body frame where latitude and specific force are; it is taken off each position. The horizontal part has an
unknown heading: in a body axis with the component ``u`` along up it has the variance ``(rate cos(latitude))^2 (1 - u^2) / 2``.
Nobody says that headings differ from position to position, so it is not averaged down. Without a latitude the whole rate
counts as pointing anywhere: variance ``rate^2 / 3`` in each axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
)
from imufield.earth import EARTH_RATE_RAD_S
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray

GYROSCOPE_BIAS_NAMES = tuple(f"gyroscope.bias.{axis}" for axis in AXES)
"""Names of the static gyroscope parameters in the joint covariance, raw unit."""


@dataclass(frozen=True, slots=True)
class _EarthPart:
    """What the Earth's rate adds to the mean rate of each position."""

    known_rad_s: FloatArray  # Shape (m, 3).
    variance: FloatArray  # Of the rest, mean over positions, shape (3,), (rad/s)^2.
    words: str


def static_bias(
    observations: Observations,
    scale: FloatArray | float | None,
    *,
    misalignment_rad: FloatArray | None = None,
    up: FloatArray | None = None,
    latitude_deg: float | None = None,
) -> GyroscopeCalibration:
    """Return the bias from the position means; scale and misalignment are taken as they are.

    Parameters
    ----------
    observations : Observations
        Positions without a gyroscope mean (NaN) are left out.
    scale : float or ndarray, shape (3,), optional
        Raw unit per rad/s, from the preset or the driver. None: not known; the bias then has no allowance for the Earth's rate
        and no value in rad/s.
    misalignment_rad : ndarray, shape (3, 3), optional
        E - I of the preset; default zero.
    up : ndarray, shape (m, 3), optional
        Direction of the specific force in the body frame (need not be unit). Default: the planned directions.
    latitude_deg : float, optional

    Returns
    -------
    GyroscopeCalibration
        Sigma of the bias from the scatter between positions; scale and misalignment as given, their sigma NaN.

    Raises
    ------
    CalibrationError
        If fewer than two positions have a gyroscope mean.
    """
    there = np.isfinite(observations.gyroscope_mean_raw).all(axis=1)
    if there.sum() < 2:
        raise CalibrationError(
            f"{int(there.sum())} positions have a gyroscope mean and a static bias needs 2; record the gyroscope as well",
            Reason.TOO_FEW,
            positions=int(there.sum()),
        )
    K = np.full(3, np.nan if scale is None else scale, dtype=np.float64)
    misalignment = np.zeros((3, 3)) if misalignment_rad is None else misalignment_rad
    earth = _earth_part(observations.direction if up is None else up, latitude_deg)
    gain = np.nan_to_num(K)
    known = gain * (earth.known_rad_s @ (np.eye(3) + misalignment).T)
    bias, variance = _mean_with_scatter((observations.gyroscope_mean_raw - known)[there])
    sigma = np.sqrt(variance + gain**2 * earth.variance)
    not_estimated = np.full((3, 3), np.nan)
    words = earth.words if scale is not None else "Earth rate not accounted for, because the scale is not known"
    return GyroscopeCalibration(
        GyroscopeParameters(K, misalignment, bias, np.zeros((3, 3))),
        GyroscopeParameters(np.full(3, np.nan), not_estimated, sigma, not_estimated),
        f"static bias from {int(there.sum())} positions, {words}; scale and misalignment as given, not calibrated",
        observations.units.gyroscope_rate_unit,
    )


def _mean_with_scatter(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean over positions and its variance from their scatter (g-sensitivity and drift included)."""
    m = len(values)
    return values.mean(axis=0), values.var(axis=0, ddof=1) / m


def _earth_part(up: FloatArray, latitude_deg: float | None) -> _EarthPart:
    known = np.zeros_like(up)
    anywhere = np.full(3, EARTH_RATE_RAD_S**2 / 3)
    if latitude_deg is None:
        return _EarthPart(known, anywhere, "Earth rate in the sigma, because the latitude is not known")
    if not np.isfinite(up).all():
        return _EarthPart(known, anywhere, "Earth rate in the sigma, because the attitude is not known")
    unit = up / np.linalg.norm(up, axis=1)[:, None]
    latitude = math.radians(latitude_deg)
    known = EARTH_RATE_RAD_S * math.sin(latitude) * unit
    variance = (EARTH_RATE_RAD_S * math.cos(latitude)) ** 2 * np.mean((1 - unit**2) / 2, axis=0)
    return _EarthPart(known, variance, "vertical Earth rate taken off, horizontal part (heading unknown) in the sigma")


def with_gyroscope(calibration: Calibration, gyroscope: GyroscopeCalibration) -> Calibration:
    """Return the calibration with a gyroscope of static path joined, its bias in the joint covariance before gravity."""
    accelerometer = [k for k, name in enumerate(calibration.covariance_names) if name in ACCELEROMETER_NAMES]
    gravity = [k for k, name in enumerate(calibration.covariance_names) if name == GRAVITY_NAME]
    old = accelerometer + gravity
    names = (*(calibration.covariance_names[k] for k in accelerometer), *GYROSCOPE_BIAS_NAMES, GRAVITY_NAME)
    covariance = np.zeros((len(names), len(names)))
    places = [k for k, name in enumerate(names) if name not in GYROSCOPE_BIAS_NAMES]
    covariance[np.ix_(places, places)] = calibration.covariance[np.ix_(old, old)]
    own = [k for k, name in enumerate(names) if name in GYROSCOPE_BIAS_NAMES]
    covariance[own, own] = gyroscope.sigma.bias**2
    return replace(calibration, gyroscope=gyroscope, covariance_names=names, covariance=covariance)
