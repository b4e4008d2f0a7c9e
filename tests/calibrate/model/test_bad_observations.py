"""Observations that cannot be calibrated from, or only in part: each is said for what it is."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.observations import Observations
from imufield.earth import Gravity
from imufield.errors import CalibrationError, Reason
from imufield.guide.positions import scheme
from imufield.samples import FloatArray, SampleUnits
from imufield.sentences import Sentences
from tests.refused import refused
from tests.told import told

GRAVITY = 9.81
sentence = Sentences("imufield.calibrate.accelerometer")
EXACT = Gravity(gravity_m_s2=GRAVITY, sigma_m_s2=1e-9, source="typed")


def sent(directions: FloatArray) -> FloatArray:
    """Return what a good instrument gives with these sides up, a little noise included."""
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    return (
        GRAVITY * unit * [1.001, 0.999, 1.0005]
        + [0.02, -0.03, 0.01]
        + 3e-4 * np.random.default_rng(2).standard_normal(unit.shape)
    )


def means(raw: FloatArray) -> Observations:
    m = len(raw)
    unknown = np.full((m, 3, 3), np.nan)
    names = tuple(f"p{k + 1:02d}" for k in range(m))
    nothing = np.full(m, np.nan)
    return Observations(
        name=names,
        mean_raw=raw,
        covariance_raw=unknown,
        gyroscope_mean_raw=np.full((m, 3), np.nan),
        gyroscope_covariance_raw=unknown,
        gyroscope_rounding_raw=np.zeros((m, 3)),
        gyroscope_noise_raw=np.full((m, 3), np.nan),
        direction=np.full((m, 3), np.nan),
        start_s=nothing,
        duration_s=nothing,
        middle_s=np.full(m, np.nan),
        middle_rad=np.zeros((m, 3)),
        temperature_degc=nothing,
        units=SampleUnits(),
    )


EIGHTH = np.arange(8) * np.pi / 4
PLANE = np.column_stack([np.cos(EIGHTH), np.sin(EIGHTH), np.zeros(8)])


@pytest.mark.parametrize("jitter", [0.0, 0.01, 0.04])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_positions_in_a_plane_are_said_to_be(axis: int, jitter: float) -> None:
    turned = np.roll(PLANE, axis + 1, axis=1) + jitter * np.random.default_rng(axis).uniform(-1, 1, PLANE.shape)
    with refused(CalibrationError, Reason.UNOBSERVABLE, f"axis {'xyz'[axis]}", key="observability.one_plane") as caught:
        calibrate_accelerometer(means(sent(turned)), EXACT)
    assert caught.value.values["thickness"] < 0.1
    assert caught.value.reason is Reason.UNOBSERVABLE


@pytest.mark.parametrize(
    ("factor", "reason", "fact"), [(1e300, Reason.BOUNDS, "1e+12"), (1e-300, Reason.UNOBSERVABLE, "24 positions")]
)
@pytest.mark.filterwarnings("error")
def test_outputs_of_no_instrument(factor: float, reason: Reason, fact: str) -> None:
    raw = sent(scheme("paper24").directions())
    with refused(CalibrationError, reason, fact):
        calibrate_accelerometer(means(raw * factor), EXACT)
    raw[5] *= max(factor, 1e20)
    with refused(CalibrationError, Reason.BOUNDS, "p06") as caught:
        calibrate_accelerometer(means(raw), EXACT)
    assert caught.value.values["position"] == "p06"


def test_means_that_stop_at_a_limit_are_saturated() -> None:
    raw = sent(scheme("paper24").directions())
    raw[:, 1] = np.minimum(raw[:, 1], 8.0)
    with refused(CalibrationError, Reason.SATURATED, "axis y", "2 positions", key="quality.saturated") as caught:
        calibrate_accelerometer(means(raw), EXACT)
    assert caught.value.values["axis"] == "y"
    assert caught.value.values["limit"] == 8
    assert caught.value.reason is Reason.SATURATED


def test_means_that_agree_by_chance_are_not_taken_for_a_limit() -> None:
    raw = sent(scheme("paper24").directions())
    highest, next_highest = np.argsort(raw[:, 2])[[-1, -2]]
    raw[next_highest, 2] = raw[highest, 2] * (1 - 1e-10)
    raw[5, 1] += 0.5
    calibration = calibrate_accelerometer(means(raw), EXACT)
    assert np.abs(calibration.positions.residual_m_s2).max() > 0.1
    assert calibration.quality.verdict == "poor"


def test_coarse_steps_are_not_taken_for_a_limit() -> None:
    raw = np.round(sent(scheme("paper24").directions()) / 0.6) * 0.6
    calibration = calibrate_accelerometer(means(raw), EXACT)
    assert np.abs(calibration.positions.residual_m_s2).max() > 0.05
    assert calibration.quality.verdict == "poor"


def test_what_cannot_be_seen_has_its_cost() -> None:
    reasons = calibrate_accelerometer(means(sent(scheme("paper24").directions()[:11])), EXACT).quality.reasons
    (hidden,) = told(reasons, "quality.hidden_as_zero")
    assert "misalignment zy" in hidden.values["names"]
    assert sentence("quality.misalignment_cost") in hidden
    assert told(reasons, "quality.assumed_signs")


def test_one_position_is_one() -> None:
    with refused(CalibrationError, Reason.TOO_FEW, key="accelerometer.too_few") as caught:
        calibrate_accelerometer(means(sent(PLANE[:1])), EXACT)
    assert caught.value.values["positions"] == 1
    assert caught.value.values["needed"] == 6
