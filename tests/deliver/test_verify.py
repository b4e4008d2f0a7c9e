"""Held-out positions of simulated instruments: honest uncertainty passes, a wrong parameter does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.accelerometer import calibrate_accelerometer
from imufield.calibrate.models import predict
from imufield.calibrate.observations import Observations
from imufield.calibrate.result import AccelerometerParameters, Calibration
from imufield.deliver.verify import check_positions, cross_validate
from imufield.earth import Gravity
from imufield.errors import CalibrationError, UsageError
from imufield.guide.positions import scheme
from imufield.samples import FloatArray, SampleUnits

GRAVITY = Gravity(9.81, 5e-4, "normal", 48.0, 300.0)
TRUTH = AccelerometerParameters(
    np.array([1.001, 0.9985, 1.0007]),
    np.array([0.02, -0.03, 0.01]),
    np.array([[0, 0, 0], [1e-3, 0, 0], [-2e-3, 5e-4, 0]]),
)
SIGMA = 1e-3


def observe(seed: int, positions: str = "paper24", truth: AccelerometerParameters = TRUTH, g: float = 9.81) -> Observations:
    up = scheme(positions).directions()
    m = len(up)
    rng = np.random.default_rng(seed)
    up = up + 0.03 * rng.normal(size=up.shape)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    unknown: FloatArray = np.full((m, 3), np.nan)
    return Observations(
        tuple(f"p{k}" for k in range(m)),
        predict(truth, g * up) + SIGMA * rng.normal(size=up.shape),
        np.broadcast_to(np.eye(3) * SIGMA**2, (m, 3, 3)),
        unknown,
        np.full((m, 3, 3), np.nan),
        up,
        np.arange(m, dtype=np.float64),
        np.ones(m),
        np.full(m, 25.0),
        SampleUnits(),
    )


def calibrated(seed: int = 0) -> Calibration:
    return calibrate_accelerometer(observe(seed), GRAVITY, model="linear")


def test_residuals_of_fresh_positions_are_as_forecast_in_most_seeds() -> None:
    found = [check_positions(calibrated(seed), observe(100 + seed, "paper36"), GRAVITY) for seed in range(20)]
    assert sum(one.as_forecast for one in found) >= 17
    normalised = np.concatenate([one.residual_m_s2 / one.sigma_m_s2 for one in found])
    assert np.sqrt(np.mean(normalised**2)) == pytest.approx(1.0, abs=0.15)


def test_the_error_of_gravity_cancels_at_one_place() -> None:
    # True gravity differs by 2e-3 from what both sessions were told: nothing is seen, as it must be.
    calibration = calibrate_accelerometer(observe(1, g=9.812), GRAVITY, model="linear")
    found = check_positions(calibration, observe(2, g=9.812), GRAVITY)
    assert found.rms_m_s2 < 3 * SIGMA
    elsewhere = check_positions(calibration, observe(2, g=9.822), replace(GRAVITY, gravity_m_s2=9.82))
    assert np.all(elsewhere.sigma_m_s2 > found.sigma_m_s2)


def test_a_bias_that_moved_is_found_and_the_preset_compared() -> None:
    moved = replace(TRUTH, bias_m_s2=TRUTH.bias_m_s2 + np.array([0.01, 0, 0]))
    found = check_positions(calibrated(), observe(5, truth=moved), GRAVITY, before=moved)
    assert not found.as_forecast
    assert found.before_rms_m_s2 < found.rms_m_s2 / 3


def test_cross_validation_predicts_every_position_once() -> None:
    observations = observe(0)
    found = cross_validate(calibrated(0), observations, 4)
    assert found.name == observations.name
    assert np.isfinite(found.residual_m_s2).all()
    assert found.rms_m_s2 > calibrated(0).quality.residual_rms_m_s2
    assert found.as_forecast
    assert np.isnan(found.before_rms_m_s2)


def test_one_at_a_time_is_leave_one_out() -> None:
    calibration = calibrated(3)
    found = cross_validate(calibration, observe(3), 1)
    np.testing.assert_allclose(found.residual_m_s2, calibration.positions.leave_one_out_m_s2, rtol=0.2, atol=2e-4)


@pytest.mark.parametrize("hold_out", [0, 19, 24])
def test_too_many_held_out_are_refused(hold_out: int) -> None:
    with pytest.raises(UsageError, match=f"--hold-out {hold_out} of 24"):
        cross_validate(calibrated(), observe(0), hold_out)


def test_positions_that_are_no_numbers_are_refused() -> None:
    observations = observe(0)
    observations.mean_raw[7, 1] = np.nan
    with pytest.raises(CalibrationError, match="position p7"):
        check_positions(calibrated(), observations, GRAVITY)


def test_without_covariance_there_is_no_forecast_but_a_residual() -> None:
    calibration = calibrated()
    unknown = replace(calibration, covariance=np.full_like(calibration.covariance, np.nan))
    found = check_positions(unknown, observe(9), GRAVITY)
    assert np.isnan(found.misfit)
    assert found.rms_m_s2 < 3 * SIGMA
