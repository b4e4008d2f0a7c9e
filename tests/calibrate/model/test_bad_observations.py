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

GRAVITY = 9.81
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
        direction=np.full((m, 3), np.nan),
        start_s=nothing,
        duration_s=nothing,
        temperature_degc=nothing,
        units=SampleUnits(),
    )


EIGHTH = np.arange(8) * np.pi / 4
PLANE = np.column_stack([np.cos(EIGHTH), np.sin(EIGHTH), np.zeros(8)])


@pytest.mark.parametrize("jitter", [0.0, 0.01, 0.04])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_positions_in_a_plane_are_said_to_be(axis: int, jitter: float) -> None:
    turned = np.roll(PLANE, axis + 1, axis=1) + jitter * np.random.default_rng(axis).uniform(-1, 1, PLANE.shape)
    with pytest.raises(CalibrationError, match=f"lie in one plane .* axis {'xyz'[axis]} up and down") as caught:
        calibrate_accelerometer(means(sent(turned)), EXACT)
    assert caught.value.reason is Reason.UNOBSERVABLE


@pytest.mark.parametrize(("factor", "words"), [(1e300, "larger than 1e.12"), (1e-300, "nothing was turned")])
@pytest.mark.filterwarnings("error")
def test_outputs_of_no_instrument(factor: float, words: str) -> None:
    raw = sent(scheme("paper24").directions())
    with pytest.raises(CalibrationError, match=words):
        calibrate_accelerometer(means(raw * factor), EXACT)
    raw[5] *= max(factor, 1e20)
    with pytest.raises(CalibrationError, match="position p06"):
        calibrate_accelerometer(means(raw), EXACT)


def test_means_that_stop_at_a_limit_are_saturated() -> None:
    raw = sent(scheme("paper24").directions())
    raw[:, 1] = np.minimum(raw[:, 1], 8.0)
    with pytest.raises(CalibrationError, match="axis y stops at 8 in 2 positions") as caught:
        calibrate_accelerometer(means(raw), EXACT)
    assert caught.value.reason is Reason.SATURATED


def test_coarse_steps_are_not_taken_for_a_limit() -> None:
    raw = np.round(sent(scheme("paper24").directions()) / 0.6) * 0.6
    calibration = calibrate_accelerometer(means(raw), EXACT)
    assert np.abs(calibration.positions.residual_m_s2).max() > 0.05
    assert calibration.quality.verdict == "poor"


def test_what_cannot_be_seen_has_its_cost() -> None:
    reasons = " ".join(calibrate_accelerometer(means(sent(scheme("paper24").directions()[:11])), EXACT).quality.reasons)
    assert "cannot show misalignment zy" in reasons
    assert "each mrad of misalignment left is 1 mg of error" in reasons
    assert "are taken as zero" in reasons
    assert "assumed positive, their order x, y, z and right-handed" in reasons


def test_one_position_is_one() -> None:
    with pytest.raises(CalibrationError, match=r"^1 position is too few"):
        calibrate_accelerometer(means(sent(PLANE[:1])), EXACT)
