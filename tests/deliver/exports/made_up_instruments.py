"""Instruments made up at random, as loaded parameter files."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from imufield.calibrate.model.gauge import change_gauge
from imufield.calibrate.model.models import from_vector, predict, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    AccelerometerParameters,
    Calibration,
    Gauge,
    GyroscopeCalibration,
    GyroscopeParameters,
    Intrinsic,
    PositionResult,
    QuadraticAxes,
    Quality,
    SolverSummary,
)
from imufield.deliver.parameters.context import Context, InstrumentFacts, Noise, SessionFacts
from imufield.deliver.parameters.document import to_document
from imufield.deliver.parameters.file import Parameters, from_document
from imufield.earth import Gravity
from imufield.samples import SampleUnits

GRAVITY = 9.8071
POSITIONS = 24


def off_diagonal(rng: np.random.Generator, size: float) -> np.ndarray:
    return rng.normal(scale=size, size=(3, 3)) * (1 - np.eye(3))


def made_up(
    seed: int,
    *,
    gauge: Gauge = "lower",
    angle_rad: float = 5e-3,
    quadratic: float = 0.0,
    axes: QuadraticAxes = "sensing",
    g_sensitivity: float = 0.0,
    gyroscope: bool = True,
    units: tuple[str, str] = ("m/s^2", "rad/s"),
    scale: tuple[float, float] = (1.0, 1.0),
    sign: tuple[float, float, float] = (1.0, 1.0, 1.0),
    raw_zero: float = 0.0,
    context: Context | None = None,
) -> Parameters:
    """Return the parameters of an instrument; ``scale`` is raw unit per SI."""
    rng = np.random.default_rng(seed)
    K = np.array(sign) * scale[0] * (1 + rng.normal(scale=1e-2, size=3))
    accelerometer = AccelerometerParameters(
        scale=K,
        bias_m_s2=rng.normal(scale=0.05, size=3),
        misalignment_rad=off_diagonal(rng, angle_rad),
        quadratic=quadratic * scale[0] * rng.normal(size=3),
        raw_zero=np.full(3, raw_zero),
        quadratic_axes=axes,
    )
    preset = to_vector(AccelerometerParameters(scale=K, bias_m_s2=np.zeros(3), misalignment_rad=off_diagonal(rng, angle_rad)))
    if axes == "sensing":
        vector = change_gauge(to_vector(accelerometer), gauge, preset).vector
        accelerometer = from_vector(vector, accelerometer.raw_zero, axes)
    rates = GyroscopeParameters(
        np.array(sign) * scale[1] * (1 + rng.normal(scale=1e-2, size=3)),
        off_diagonal(rng, angle_rad),
        scale[1] * rng.normal(scale=1e-3, size=3),
        scale[1] * g_sensitivity * rng.normal(size=(3, 3)),
        np.full(3, raw_zero),
    )
    return loaded(accelerometer, rates if gyroscope else None, gauge, units, context)


def loaded(
    accelerometer: AccelerometerParameters,
    gyroscope: GyroscopeParameters | None,
    gauge: Gauge,
    units: tuple[str, str],
    context: Context | None = None,
) -> Parameters:
    up = np.random.default_rng(5).normal(size=(POSITIONS, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    nothing, unknown = np.zeros(3), np.full((POSITIONS, 3), np.nan)
    observations = Observations(
        name=tuple(map(str, range(POSITIONS))),
        mean_raw=predict(accelerometer, GRAVITY * up),
        covariance_raw=np.zeros((POSITIONS, 3, 3)),
        gyroscope_mean_raw=unknown,
        gyroscope_covariance_raw=np.full((POSITIONS, 3, 3), np.nan),
        gyroscope_rounding_raw=np.zeros((POSITIONS, 3)),
        gyroscope_noise_raw=np.full((POSITIONS, 3), np.nan),
        direction=up,
        start_s=np.arange(POSITIONS, dtype=np.float64),
        duration_s=np.ones(POSITIONS),
        middle_s=np.full(POSITIONS, np.nan),
        middle_rad=np.zeros((POSITIONS, 3)),
        temperature_degc=np.full(POSITIONS, 30.0),
        units=SampleUnits(accelerometer=units[0], gyroscope=units[1]),
    )
    zeros = np.zeros(POSITIONS)
    calibration = Calibration(
        accelerometer=accelerometer,
        accelerometer_sigma=accelerometer,
        accelerometer_raw_unit=units[0],
        equation="N - raw_zero = K (T a + b) + K2 (T a)^2",
        gauge=gauge,
        intrinsic=Intrinsic(**{field.name: nothing for field in fields(Intrinsic)}),
        covariance_names=("gravity_m_s2",),
        covariance=np.array([[1e-6]]),
        gravity=Gravity(gravity_m_s2=GRAVITY, sigma_m_s2=5e-4, source="normal", latitude_deg=48.1, height_m=520.0),
        positions=PositionResult(
            residual_m_s2=zeros,
            leave_one_out_m_s2=zeros,
            leverage=zeros,
            used=np.ones(POSITIONS, dtype=np.bool_),
            bias_drift_m_s2=np.zeros((POSITIONS, 3)),
        ),
        solver=SolverSummary(method="least squares", status=1, message="converged", cost=1.0, evaluations=9),
        quality=Quality(
            residual_rms_m_s2=0.0,
            residual_max_m_s2=0.0,
            leave_one_out_rms_m_s2=0.0,
            between_position_sigma_m_s2=0.0,
            degrees_of_freedom=12,
            student_factor_95=2.18,
            rank=12,
            parameters_fitted=12,
            condition=40.0,
            verdict="good",
            reasons=(),
        ),
        quadratic_fitted=bool(np.any(accelerometer.quadratic)),
        gyroscope=None
        if gyroscope is None
        else GyroscopeCalibration(parameters=gyroscope, sigma=gyroscope, path="made up", raw_unit=units[1]),
    )
    known = Context(
        instrument=InstrumentFacts(driver="stim300", model="STIM300", serial_number="N25581", firmware="3.1"),
        session=SessionFacts(
            name="2025-03-01-stim300", sha256=64 * "a", sample_rate_hz=1999.987, temperature_degc=(30.9, 33.4)
        ),
        noise=Noise(
            source="still at the start",
            accelerometer_density_m_s2_per_sqrt_hz=np.full(3, 7e-4),
            gyroscope_density_rad_s_per_sqrt_hz=np.full(3, 4e-5),
        ),
        created="2025-03-01T10:55:00Z",
        software="imufield 0.1.0",
    )
    return from_document(to_document(calibration, observations, context or known))
