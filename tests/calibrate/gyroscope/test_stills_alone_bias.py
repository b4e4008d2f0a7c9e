"""Static gyroscope bias with the Earth turning underneath."""

from __future__ import annotations

import math

import numpy as np
import pytest
from calibration_truth import GRAVITY, campaign, observe, paper24, random_parameters

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.gyroscope.result import static_bias_result
from imufield.calibrate.gyroscope.stills_alone import static_bias
from imufield.calibrate.model.budget import combined_sigma
from imufield.calibrate.moves.moves import cut_moves
from imufield.calibrate.moves.slots import no_slots
from imufield.earth import EARTH_RATE_RAD_S, Gravity
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from tests.refused import refused
from tests.told import key_of

pytestmark = pytest.mark.numerical

BIAS = np.array([12.0, -7.0, 3.0])
SCALE = 5000.0


def still_gyroscope(rng: np.random.Generator, latitude_deg: float, noise: float = 0.0) -> FloatArray:
    """Mean outputs in paper24 with a heading of its own for each position."""
    up = paper24()
    rows = []
    for direction in up:
        helper = np.cross(direction, [0.3, 0.5, 0.8])
        east = helper / np.linalg.norm(helper)
        heading = rng.uniform(0, 2 * np.pi)
        north = math.cos(heading) * east + math.sin(heading) * np.cross(direction, east)
        latitude = math.radians(latitude_deg)
        earth = EARTH_RATE_RAD_S * (math.sin(latitude) * direction + math.cos(latitude) * north)
        rows.append(SCALE * earth + BIAS)
    return np.array(rows) + rng.normal(0, noise, (24, 3)) if noise else np.array(rows)


def test_at_the_pole_the_earth_is_taken_off_exactly() -> None:
    # An unbalanced half of the positions: there the Earth's rate does not average out by itself.
    half = slice(0, 12)
    gyroscope = still_gyroscope(np.random.default_rng(0), 90.0)[half]
    observations = observe(paper24()[half], direction=paper24()[half], gyroscope=gyroscope)
    known = static_bias(observations, SCALE, latitude_deg=90.0)
    unknown = static_bias(observations, SCALE)
    assert known.parameters.bias == pytest.approx(BIAS, abs=1e-12)
    assert known.sigma.bias == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.abs(unknown.parameters.bias - BIAS).max() > 0.01
    assert (key_of(known.path), key_of(unknown.path)) == ("stills_alone.bias", "stills_alone.bias_no_latitude")
    assert np.isnan(known.sigma.scale).all()


def test_sigma_covers_the_error_and_holds_the_unknown_heading() -> None:
    ratios = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        observations = observe(paper24(), direction=paper24(), gyroscope=still_gyroscope(rng, 45.0, noise=1.0))
        result = static_bias(observations, SCALE, latitude_deg=45.0)
        ratios.append((result.parameters.bias - BIAS) / result.sigma.bias)
        assert np.all(result.sigma.bias > 0.5 * SCALE * EARTH_RATE_RAD_S * math.cos(math.radians(45)))
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.2


def test_without_scale_or_attitude_it_says_so() -> None:
    observations = observe(paper24(), gyroscope=still_gyroscope(np.random.default_rng(0), 45.0))
    assert key_of(static_bias(observations, None).path) == "stills_alone.bias_no_scale"
    assert key_of(static_bias(observations, SCALE, latitude_deg=45.0).path) == "stills_alone.bias_no_attitude"
    assert np.isnan(static_bias(observations, None).parameters.scale).all()


def test_without_a_gyroscope_it_is_refused() -> None:
    observations = observe(paper24())
    nothing = cut_moves(no_slots(), observations.start_s, observations.duration_s)
    calibration = calibrate_accelerometer(
        observe(400 * GRAVITY * paper24()), Gravity(gravity_m_s2=GRAVITY, sigma_m_s2=1e-4, source="typed")
    )
    with refused(CalibrationError, Reason.TOO_FEW, key="input.too_few_stills") as caught:
        calibrate_gyroscope(GyroscopeInput(observations=observations, moves=nothing, calibration=calibration))
    assert caught.value.values["positions"] == 0


def test_bias_joins_the_covariance_before_gravity() -> None:
    rng = np.random.default_rng(1)
    calibration = calibrate_accelerometer(
        campaign(random_parameters(rng), rng), Gravity(gravity_m_s2=GRAVITY, sigma_m_s2=1e-4, source="typed")
    )
    gyroscope = static_bias(observe(paper24(), gyroscope=still_gyroscope(rng, 45.0, noise=1.0)), SCALE)
    result = static_bias_result(gyroscope, (), stills=24, earth_rate=np.full(3, 0.1 * gyroscope.sigma.bias.min()))
    joined = result.join(calibration)
    assert joined.covariance_names[-4:] == ("gyroscope.bias.x", "gyroscope.bias.y", "gyroscope.bias.z", "gravity_m_s2")
    assert np.diag(joined.covariance)[-4:-1] == pytest.approx(gyroscope.sigma.bias**2)
    assert joined.covariance[0, -1] == calibration.covariance[0, -1]
    assert joined.gyroscope is gyroscope
    assert result.join(joined).covariance_names == joined.covariance_names
    assert combined_sigma(joined.budget) ** 2 == pytest.approx(np.diag(joined.covariance), rel=1e-9, abs=0)
