"""A session whose bias drifted, with a position left out by hand: what is written, read back and checked is one session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.observations import Observations, leave_out
from imufield.calibrate.model.result import ModelChoice, without_drift
from imufield.deliver.history import Entry
from imufield.deliver.judged_history import in_one_model
from imufield.deliver.parameters.file import Context, Parameters, load, write_document
from imufield.deliver.parameters.gauge_free import gauge_free
from imufield.deliver.report.data import observations_of
from imufield.deliver.verification.left_out import cross_validate
from imufield.earth import MICRO_G_M_S2, MILLI_G_M_S2, Gravity
from imufield.errors import Reason, UsageError
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.simulate.truth.effects import NO_EFFECTS, Effects
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.study.answers.means import MeanSession
from tests.refused import refused

pytestmark = pytest.mark.numerical

GRAVITY = Gravity(gravity_m_s2=9.81, sigma_m_s2=1e-5, source="measured")
NAME = "+x-y-z"


WARMING = Effects(warm_up_m_s2=(0.8 * MILLI_G_M_S2, -0.8 * MILLI_G_M_S2, 0.8 * MILLI_G_M_S2))


def drifting(effects: Effects = WARMING) -> Observations:
    """Return a session of corners24 whose bias warms up by 0.8 mg."""
    instrument = replace(perfect_instrument(TACTICAL), effects=effects)
    session = MeanSession(instrument=instrument, gravity_m_s2=GRAVITY.gravity_m_s2, order="corners24")
    return session.observe(np.random.default_rng(4)).observations


@pytest.fixture(scope="module")
def parameters() -> Parameters:
    return solved(drifting())


def solved(session: Observations) -> Parameters:
    """Return the parameters of a session without one position."""
    observations, left_out = leave_out(session, (NAME,))
    measured = SolveInput(observations=observations, left_out=left_out, gravity=GRAVITY, context=Context())
    return calibrate(measured, SolveSettings(grade="tactical"))


def test_the_file_agrees_with_itself(parameters: Parameters, tmp_path: Path) -> None:
    write_document(tmp_path / "parameters.toml", parameters.document)
    positions = load(tmp_path / "parameters.toml").calibration.positions
    assert np.any(positions.bias_drift_m_s2[positions.used])
    np.testing.assert_array_equal(positions.bias_drift_m_s2, parameters.calibration.positions.bias_drift_m_s2)


def test_what_was_left_out_is_judged_with_the_drift_of_its_time(parameters: Parameters) -> None:
    positions = parameters.calibration.positions
    (off_m_s2,) = positions.leave_one_out_m_s2[~positions.used]
    # Noise and flicker of one hold are 40 ug; the drift goes over 700.
    assert abs(off_m_s2) < 200 * MICRO_G_M_S2
    assert np.any(positions.bias_drift_m_s2[~positions.used])


def test_observations_of_a_file_lose_their_drift(parameters: Parameters) -> None:
    steady = without_drift(observations_of(parameters), parameters.calibration)
    # What is left fits without any drift.
    again = calibrate_accelerometer(steady, GRAVITY, model="linear")
    assert again.quality.residual_rms_m_s2 < 1.5 * parameters.calibration.quality.residual_rms_m_s2


def test_a_drift_that_was_fitted_is_no_misfit() -> None:
    observations = drifting()
    calibration = calibrate_accelerometer(observations, GRAVITY)
    assert np.any(calibration.positions.bias_drift_m_s2)
    found = cross_validate(calibration, observations, 4)
    assert found.misfit < found.misfit_limit
    # It is not fitted to a group: that many may be left out, and no more.
    count = len(observations)
    with refused(UsageError, Reason.USAGE, key="left_out.hold_out") as caught:
        cross_validate(calibration, observations, count)
    assert caught.value.values["most"] == count - 10


def test_with_a_drift_in_one_of_two_sessions_both_are_compared_in_the_linear_model(parameters: Parameters) -> None:
    steady = solved(drifting(NO_EFFECTS))
    assert not np.any(steady.calibration.positions.bias_drift_m_s2)
    old, new = Entry.of("old", steady), Entry.of("new", parameters)
    assert not new.shared_with(old).setup
    of_old, of_new = in_one_model((old, new))
    assert of_old.numbers == old.numbers
    assert of_new.shared_with(of_old).setup
    assert in_one_model((new, new)) == (new, new)
    assert Entry.from_text(new.text) == new


@pytest.mark.parametrize("warming", [WARMING, NO_EFFECTS])
def test_the_linear_model_beside_another_is_that_of_a_fit_of_its_own(warming: Effects) -> None:
    """A drift that was admitted, or a quadratic term that was asked for, left out; and another fit that never had them."""
    observations = drifting(warming)
    raw = observations.mean_raw, np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
    model: ModelChoice = "auto" if warming is WARMING else "quadratic"
    found = gauge_free(calibrate_accelerometer(observations, GRAVITY, model=model), *raw).in_linear_model()
    expected = gauge_free(calibrate_accelerometer(observations, GRAVITY, model="linear"), *raw)
    assert expected.in_linear_model() is expected
    sigma, own = (np.sqrt(np.diag(each.scatter)) for each in (found, expected))
    np.testing.assert_allclose(found.scatter / np.outer(sigma, sigma), expected.scatter / np.outer(own, own), atol=2e-3)
    # Of a linear model that the residuals contradict sigma has the misfit as what it is, and no scatter is larger than sigma.
    np.testing.assert_array_less(own, sigma * 1.001)
    if warming is NO_EFFECTS:
        np.testing.assert_allclose(own, sigma, rtol=1e-3)
    for one, other, size in zip(found.numbers, expected.numbers, sigma, strict=True):
        assert (one.name, one.scatter_freedom) == (other.name, other.scatter_freedom)
        assert one.value == pytest.approx(other.value, abs=5e-3 * size)


def test_ideal_outputs_are_no_division_by_zero() -> None:
    session = drifting()
    force = GRAVITY.gravity_m_s2 * session.direction
    found = calibrate_accelerometer(replace(session, mean_raw=force), GRAVITY)
    np.testing.assert_allclose(found.accelerometer.scale, 1.0, rtol=1e-9)
