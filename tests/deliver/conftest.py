"""A calibration made by hand: every kind of value a parameter file can hold, none of them round."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.accelerometer.accelerometer import EQUATIONS
from imufield.calibrate.model.gauge import intrinsic, make_intrinsic
from imufield.calibrate.model.models import predict, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    AccelerometerParameters,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
    PositionResult,
    Quality,
    SolverSummary,
)
from imufield.deliver.parameters.context import Context, InstrumentFacts, Noise, SessionFacts
from imufield.deliver.parameters.file import write_parameters
from imufield.earth import Gravity
from imufield.samples import SampleUnits

LOWER = np.array([[0, 0, 0], [1.31e-3, 0, 0], [-7.7e-4, 2.22e-3, 0]])
POSITIONS = 24


@pytest.fixture
def parameters() -> AccelerometerParameters:
    return AccelerometerParameters(
        scale=np.array([1.000123456789, 0.99987654321, 1.00031]),
        bias_m_s2=np.array([0.0312, -0.0147, 1 / 300]),
        misalignment_rad=LOWER,
        quadratic=np.array([1.1e-6, -2.3e-6, 4e-7]),
    )


@pytest.fixture
def gyroscope() -> GyroscopeCalibration:
    not_estimated = GyroscopeParameters(
        np.full(3, np.nan), np.full((3, 3), np.nan), np.array([2.1e-6, 2.2e-6, 2.3e-6]), np.full((3, 3), np.nan)
    )
    values = GyroscopeParameters(np.ones(3), np.zeros((3, 3)), np.array([1e-4, -2e-5, 3.3e-5]), np.zeros((3, 3)))
    return GyroscopeCalibration(parameters=values, sigma=not_estimated, path="static bias, Earth rate accounted for")


@pytest.fixture
def residual() -> np.ndarray:
    found = np.random.default_rng(6).normal(scale=2e-4, size=POSITIONS)
    found[17] = -9.1e-4
    return found


@pytest.fixture
def observations(parameters: AccelerometerParameters, residual: np.ndarray) -> Observations:
    rng = np.random.default_rng(5)
    up = rng.normal(size=(POSITIONS, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    unknown = np.full((POSITIONS, 3), np.nan)
    return Observations(
        name=tuple(f"{i // 8 + 1}-{i % 8 + 1}" for i in range(POSITIONS)),
        mean_raw=predict(parameters, (9.8071 + residual)[:, None] * up),
        covariance_raw=np.broadcast_to(np.diag([1e-8, 2e-8, 3e-8]), (POSITIONS, 3, 3)),
        gyroscope_mean_raw=unknown,
        gyroscope_covariance_raw=np.full((POSITIONS, 3, 3), np.nan),
        gyroscope_rounding_raw=np.zeros((POSITIONS, 3)),
        gyroscope_noise_raw=np.full((POSITIONS, 3), np.nan),
        direction=up,
        start_s=60 + 14 * np.arange(POSITIONS, dtype=np.float64),
        duration_s=np.full(POSITIONS, 9.7),
        middle_s=np.full(POSITIONS, np.nan),
        middle_rad=np.zeros((POSITIONS, 3)),
        temperature_degc=np.linspace(31, 33.3, POSITIONS),
        units=SampleUnits(),
    )


@pytest.fixture
def calibration(parameters: AccelerometerParameters, gyroscope: GyroscopeCalibration, residual: np.ndarray) -> Calibration:
    leave_one_out = 1.4 * residual
    leave_one_out[3] = np.nan
    names = (*ACCELEROMETER_NAMES, *(f"gyroscope.bias.{axis}" for axis in "xyz"), GRAVITY_NAME)
    sigma = AccelerometerParameters(
        scale=np.array([5.2e-5, 5.3e-5, 5.4e-5]),
        bias_m_s2=np.array([1.1e-4, 1.2e-4, 1.3e-4]),
        misalignment_rad=np.abs(LOWER) * 0.02,
        quadratic=np.full(3, 3e-7),
    )
    root = np.random.default_rng(6).normal(size=(len(names), len(names)))
    root *= (np.concatenate([to_vector(sigma), gyroscope.sigma.bias, [5e-4]]) / np.linalg.norm(root, axis=1))[:, None]
    return Calibration(
        accelerometer=parameters,
        accelerometer_sigma=sigma,
        accelerometer_raw_unit="m/s^2",
        equation=EQUATIONS["sensing"],
        gauge="lower",
        intrinsic=make_intrinsic(intrinsic(to_vector(parameters))[0], np.repeat([5.2e-5, 1.1e-4, 2e-5, 3e-7], 3)),
        covariance_names=names,
        covariance=root @ root.T,
        gravity=Gravity(gravity_m_s2=9.8071, sigma_m_s2=5e-4, source="normal", latitude_deg=48.1, height_m=520.0),
        positions=PositionResult(
            residual_m_s2=residual,
            leave_one_out_m_s2=leave_one_out,
            leverage=np.full(POSITIONS, 0.5),
            used=np.ones(POSITIONS, dtype=np.bool_),
            bias_drift_m_s2=np.zeros((POSITIONS, 3)),
        ),
        solver=SolverSummary(
            method="least-squares", status=1, message="converged: the step is below 1e-12", cost=11.3, evaluations=9
        ),
        quality=Quality(
            residual_rms_m_s2=float(np.sqrt(np.mean(residual**2))),
            residual_max_m_s2=9.1e-4,
            leave_one_out_rms_m_s2=3.7e-4,
            between_position_sigma_m_s2=1.9e-4,
            degrees_of_freedom=12,
            student_factor_95=2.178812829663418,
            rank=12,
            parameters_fitted=12,
            condition=41.7,
            verdict="good",
            reasons=("24 positions determine 12 parameters", "position 3-2 has the largest residual, 4.1 times the RMS"),
        ),
        quadratic_fitted=True,
        gyroscope=gyroscope,
    )


@pytest.fixture
def six_faces(calibration: Calibration) -> Calibration:
    """Return the same with nothing but scale and bias estimated."""
    unknown = replace(calibration.accelerometer_sigma, misalignment_rad=np.full((3, 3), np.nan), quadratic=np.full(3, np.nan))
    names = tuple(name for name in ACCELEROMETER_NAMES if "misalignment" in name)
    kept = [k for k, name in enumerate(calibration.covariance_names) if not name.startswith("gyroscope")]
    return replace(
        calibration,
        accelerometer_sigma=unknown,
        unobservable=names,
        gyroscope=None,
        quadratic_fitted=False,
        covariance_names=tuple(calibration.covariance_names[k] for k in kept),
        covariance=calibration.covariance[np.ix_(kept, kept)],
    )


@pytest.fixture
def context() -> Context:
    return Context(
        instrument=InstrumentFacts(driver="stim300", model="STIM300", serial_number="N25581234567890", firmware="3.1"),
        session=SessionFacts(
            name="2025-03-01T101500Z-stim300", sha256=64 * "a", sample_rate_hz=1999.987, temperature_degc=(30.9, 33.4)
        ),
        noise=Noise(
            source="still at the start",
            accelerometer_density_m_s2_per_sqrt_hz=np.full(3, 7e-4),
            gyroscope_density_rad_s_per_sqrt_hz=np.full(3, 4e-5),
        ),
        created="2025-03-01T10:55:00Z",
        software="imufield 0.1.0",
    )


@pytest.fixture
def write(tmp_path: Path, calibration: Calibration, observations: Observations, context: Context):  # type: ignore[no-untyped-def]
    """Return a writer of calibrations: date, bias y moved by a number of sigma, and facts of the instrument."""

    def writer(
        name: str, created: str, moved: float = 0.0, session: str = "", recorded: str = "", called: str = "", **who: str
    ) -> Path:
        found = calibration.intrinsic
        raw = found.bias_raw + moved * found.bias_raw_sigma * np.array([0.0, 1.0, 0.0])
        K = calibration.accelerometer.scale
        moved_to = replace(calibration.accelerometer, bias_m_s2=raw / K)
        changed = replace(calibration, accelerometer=moved_to, intrinsic=replace(found, bias_raw=raw))
        seen = replace(observations, mean_raw=observations.mean_raw + raw - found.bias_raw)
        digest = session or hashlib.sha256(name.encode()).hexdigest()
        facts = replace(context.session, name=called or context.session.name, sha256=digest, recorded=recorded)
        moment = created if "T" in created else f"{created}T10:00:00Z"
        instrument = replace(context.instrument, **{"serial_number": "N1", **who})
        where = replace(context, created=moment, instrument=instrument, session=facts)
        path = tmp_path / name / "parameters.toml"
        path.parent.mkdir(exist_ok=True)
        write_parameters(path, changed, seen, where)
        return path

    return writer
