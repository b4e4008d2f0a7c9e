"""Instruments at rest for the tests of this folder: exact inputs, chosen errors, any attitude."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike

from imufield.calibrate.model.result import (
    AccelerometerParameters,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
    Intrinsic,
    PositionResult,
    Quality,
    SolverSummary,
)
from imufield.deliver.navigation.alignment import earth_rate
from imufield.deliver.parameters.file import Corrected
from imufield.earth import EARTH_RATE_RAD_S, Gravity, normal_gravity
from imufield.samples import FloatArray, Samples, SampleUnits, make_samples

LATITUDE_DEG = 45.0
GRAVITY_M_S2 = normal_gravity(LATITUDE_DEG)
MICRO_G = 9.80665e-6
DEG_PER_HOUR = np.radians(1.0) / 3600
FORCE_DENSITY = 5 * MICRO_G
RATE_DENSITY = 0.002 / 60 * np.radians(1.0)


def random_attitude(seed: int) -> FloatArray:
    """C_nb, drawn evenly."""
    Q, R = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def inputs(attitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """True specific force and rate in the body frame."""
    return attitude.T @ [0.0, 0.0, -GRAVITY_M_S2], attitude.T @ earth_rate(LATITUDE_DEG)


def phi_of(found: FloatArray, true: FloatArray) -> FloatArray:
    """phi of found = (I - [phi x]) true."""
    d = found @ true.T
    return np.array([d[1, 2] - d[2, 1], d[2, 0] - d[0, 2], d[0, 1] - d[1, 0]]) / 2


def recording(
    attitude: FloatArray,
    duration_s: float,
    rate_hz: float = 1.0,
    *,
    force: ArrayLike = (0, 0, 0),
    rate: ArrayLike = (0, 0, 0),
    noise: float = 0.0,
    seed: int = 0,
) -> Samples:
    """Samples in SI with constant errors in the body frame and white noise."""
    rng = np.random.default_rng(seed)
    n = round(duration_s * rate_hz) + 1
    f, w = inputs(attitude)
    sigma = noise * np.sqrt(rate_hz)
    return make_samples(
        np.arange(n) / rate_hz,
        f + np.asarray(force) + sigma * FORCE_DENSITY * rng.standard_normal((n, 3)),
        w + np.asarray(rate) + sigma * RATE_DENSITY * rng.standard_normal((n, 3)),
        units=SampleUnits(),
    )


def as_sent(samples: Samples) -> Corrected:
    """No correction."""
    return Corrected(samples.time_s, samples.accelerometer, samples.gyroscope)


def perfect(force_sigma: float = 0.0, rate_sigma: float = 0.0) -> Calibration:
    """A calibration of a perfect instrument with an uncertain bias of both triads."""
    zero, none = np.zeros(3), np.zeros((3, 3))
    accelerometer = AccelerometerParameters(scale=np.ones(3), bias_m_s2=zero, misalignment_rad=none)
    gyroscope = GyroscopeParameters(np.ones(3), none, zero, none)
    names = tuple(f"{name}.{axis}" for name in ("accelerometer.bias_m_s2", "gyroscope.bias") for axis in "xyz")
    return Calibration(
        accelerometer=accelerometer,
        accelerometer_sigma=AccelerometerParameters(scale=zero, bias_m_s2=np.full(3, force_sigma), misalignment_rad=none),
        accelerometer_raw_unit="m/s^2",
        equation="N = a",
        gauge="lower",
        intrinsic=Intrinsic(**{field.name: zero for field in fields(Intrinsic)}),
        covariance_names=names,
        covariance=np.diag(np.repeat([force_sigma, rate_sigma], 3) ** 2),
        gravity=Gravity(gravity_m_s2=GRAVITY_M_S2, sigma_m_s2=1e-5, source="typed", latitude_deg=LATITUDE_DEG, height_m=0.0),
        positions=PositionResult(
            residual_m_s2=zero[:0],
            leave_one_out_m_s2=zero[:0],
            leverage=zero[:0],
            used=np.empty(0, dtype=np.bool_),
            bias_drift_m_s2=np.empty((0, 3)),
        ),
        solver=SolverSummary(method="none", status=1, message="by hand", cost=0.0, evaluations=0),
        quality=Quality(
            residual_rms_m_s2=0,
            residual_max_m_s2=0,
            leave_one_out_rms_m_s2=0,
            between_position_sigma_m_s2=0,
            degrees_of_freedom=12,
            student_factor_95=2.18,
            rank=9,
            parameters_fitted=9,
            condition=1.0,
            verdict="good",
            reasons=(),
        ),
        quadratic_fitted=False,
        gyroscope=GyroscopeCalibration(parameters=gyroscope, sigma=gyroscope, path="by hand"),
    )


def north_rate() -> float:
    """Horizontal part of the Earth's rate."""
    return float(EARTH_RATE_RAD_S * np.cos(np.radians(LATITUDE_DEG)))
