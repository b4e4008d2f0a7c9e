"""The linear model, chosen or asked for: one uncertainty, and a verdict that says where the residuals contradict it."""

from __future__ import annotations

import numpy as np
import pytest
from drifting_sessions import GRAVITY_M_S2, Session, proposed

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.earth import MILLI_G_M_S2, Gravity
from tests.told import told

EXACT = Gravity(gravity_m_s2=GRAVITY_M_S2, sigma_m_s2=1e-9, source="measured")
PAPER24 = proposed("paper24")


@pytest.mark.parametrize(("quadratic_ug", "warm_up_ug"), [(1000.0, 0.0), (3000.0, 0.0), (0.0, 1500.0)])
def test_a_linear_model_that_residuals_contradict_is_not_good_and_its_limits_hold(
    quadratic_ug: float, warm_up_ug: float
) -> None:
    session, inside = Session(directions=PAPER24, quadratic_ug=quadratic_ug, warm_up_ug=warm_up_ug), []
    for seed in range(8):
        observations, truth = session.take(np.random.default_rng(seed))
        found = calibrate_accelerometer(observations, EXACT, model="linear", grade="industrial")
        assert found.model == "linear"
        assert not found.positions.bias_drift_m_s2.any()
        assert found.quality.verdict == "usable"
        assert told(found.quality.warnings, "model_choice.linear_contradicted")
        own = found.intrinsic
        values, sigmas = (np.concatenate(each) for each in ((own.scale, own.bias_raw), (own.scale_sigma, own.bias_raw_sigma)))
        off = np.abs(values - intrinsic(to_vector(truth), "sensing")[0][:6])
        inside.append(off < found.quality.student_factor_95 * sigmas)
    assert np.mean(inside) > 0.92


def test_hardly_any_clean_session_loses_its_verdict_to_the_test() -> None:
    session, verdicts = Session(directions=PAPER24), []
    for seed in range(200):
        observations, _ = session.take(np.random.default_rng(seed))
        verdicts.append(calibrate_accelerometer(observations, EXACT, model="linear", grade="industrial").quality.verdict)
    # One of 200 is expected, and one for other terms; of p below 5 % there are ten.
    assert verdicts.count("usable") <= 6
    assert verdicts.count("good") >= 194


def test_what_contradicts_is_told_as_the_quadratic_model_finds_it() -> None:
    observations, _ = Session(directions=PAPER24, quadratic_ug=1000.0).take(np.random.default_rng(1))
    # Nothing says when: a drift cannot be asked for.
    observations.start_s[:] = np.nan
    linear, quadratic = (
        calibrate_accelerometer(observations, EXACT, model=model, grade="industrial") for model in ("linear", "auto")
    )
    assert quadratic.model == "quadratic"
    (contradicted,) = told(linear.quality.warnings, "model_choice.linear_contradicted")
    shift_mg = np.abs(quadratic.accelerometer.bias_m_s2 - linear.accelerometer.bias_m_s2).max() / MILLI_G_M_S2
    assert contradicted.values["shift_mg"] == pytest.approx(shift_mg, rel=0.01)
    (kept,) = told(quadratic.quality.reasons, "model_choice.quadratic_kept")
    assert np.log10(float(str(contradicted.values["p"]))) == pytest.approx(np.log10(float(str(kept.values["p"]))), rel=0.05)


@pytest.mark.parametrize("has_times", [True, False])
def test_the_linear_model_is_as_uncertain_asked_for_as_chosen(has_times: bool) -> None:
    observations, _ = Session(directions=PAPER24).take(np.random.default_rng(3))
    if not has_times:
        observations.start_s[:] = np.nan
    asked, chosen = (
        calibrate_accelerometer(observations, EXACT, model=model, grade="industrial") for model in ("linear", "auto")
    )
    assert chosen.model == "linear"
    assert (asked.quality.verdict, asked.quality.warnings) == ("good", ())
    np.testing.assert_array_equal(asked.accelerometer.bias_m_s2, chosen.accelerometer.bias_m_s2)
    for quantity in ("scale", "bias_m_s2", "misalignment_rad"):
        own, other = (getattr(each.accelerometer_sigma, quantity) for each in (asked, chosen))
        np.testing.assert_allclose(own, other, rtol=5e-3)
    assert told(asked.quality.reasons, "model_choice.linear_not_contradicted")


def test_without_a_grade_who_asks_for_the_linear_model_is_believed_as_far_as_the_test_goes() -> None:
    clean, bent = (
        Session(directions=PAPER24, quadratic_ug=quadratic_ug).take(np.random.default_rng(3))[0]
        for quadratic_ug in (0.0, 1000.0)
    )
    sigma, larger = (
        calibrate_accelerometer(observations, EXACT, model="linear").accelerometer_sigma.bias_m_s2
        for observations in (clean, bent)
    )
    assert np.all(calibrate_accelerometer(clean, EXACT).accelerometer_sigma.bias_m_s2 > 2 * sigma)
    assert np.all(larger > 5 * sigma)


def test_faces_alone_do_not_miss_a_term_that_was_not_asked_for() -> None:
    observations, _ = Session(directions=np.tile(np.vstack([np.eye(3), -np.eye(3)]), (2, 1))).take(np.random.default_rng(3))
    asked, chosen = (
        calibrate_accelerometer(observations, EXACT, model=model, grade="industrial") for model in ("linear", "auto")
    )
    assert any("quadratic" in name for name in chosen.unobservable)
    assert not any("quadratic" in name for name in asked.unobservable)
    assert told(asked.quality.reasons, "model_choice.linear_as_asked")
    # It may be there all the same.
    np.testing.assert_allclose(asked.accelerometer_sigma.bias_m_s2, chosen.accelerometer_sigma.bias_m_s2, rtol=1e-6)
