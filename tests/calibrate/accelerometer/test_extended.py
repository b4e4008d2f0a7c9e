"""``--model extended``: cubic and cross terms that the simulator adds are found, and stated intervals hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.accelerometer.methods import restart
from imufield.calibrate.model.models import norm_derivatives, recover
from imufield.calibrate.model.result import Calibration, ModelChoice
from imufield.earth import STANDARD_GRAVITY_M_S2, Gravity
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import GRADES, draw_truth
from imufield.study.answers.means import MeanSession, Observed, answer_of
from tests.refused import refused
from tests.told import told

pytestmark = pytest.mark.numerical

G = STANDARD_GRAVITY_M_S2
KNOWN = Gravity(gravity_m_s2=G, sigma_m_s2=1e-6, source="measured")
GRADE = "industrial"


def drawn(
    rng: np.random.Generator, cubic_mg: float = 0.0, cross_mg: float = 0.0, order: str = "all26"
) -> tuple[Observed, Effects]:
    """Return a session of an instrument whose terms have these sizes, 1 sigma."""
    cubic, *cross = (
        (float(x), float(y), float(z))
        for x, y, z in 1e-3 * np.repeat([cubic_mg, *[cross_mg] * 3], 3).reshape(4, 3) * rng.standard_normal((4, 3))
    )
    effects = Effects(cubic=cubic, cross=tuple(cross))
    instrument = replace(draw_truth(GRADES[GRADE], rng), effects=effects)
    return MeanSession(instrument=instrument, gravity_m_s2=G, order=order).observe(rng), effects


def solved(session: Observed, model: ModelChoice = "extended", grade: str | None = GRADE) -> Calibration:
    return calibrate_accelerometer(session.observations, KNOWN, model=model, grade=grade)


def terms(calibration: Calibration) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return cubic and cross terms and their sigmas, g per power of g."""
    found, sigma = calibration.accelerometer.higher, calibration.accelerometer_sigma.higher
    assert found is not None
    assert sigma is not None
    return found.cubic * G**2, found.cross * G, sigma.cubic * G**2, sigma.cross * G


@pytest.mark.statistical
def test_stated_intervals_hold_large_terms() -> None:
    """50 sessions with cubic terms of 2 mg/g^3 and cross terms of 1 mg/g^2: of both, and of all numbers, 95 % are inside."""
    rng = np.random.default_rng(31)
    numbers, cubic_inside, cross_inside, cubic_sigma = [], [], [], np.zeros(3)
    for _ in range(50):
        session, effects = drawn(rng, 2.0, 1.0)
        found = solved(session)
        cubic, cross, cubic_sigma, cross_sigma = terms(found)
        factor = found.quality.student_factor_95
        numbers.append(answer_of(found, session.truth).inside)
        cubic_inside.append(np.abs(cubic - effects.cubic) < factor * cubic_sigma)
        cross_inside.append(np.abs(cross - effects.cross) < factor * cross_sigma)
    # 150 cubic terms know their share to 1.8 %, 450 cross terms and as many numbers to 1 %, or little worse.
    assert np.mean(cubic_inside) > 0.89
    assert np.mean(cross_inside) > 0.89
    assert np.mean(numbers) > 0.91
    # What is shown of them is found: a cubic term to 0.05 mg/g^3.
    assert np.max(cubic_sigma) < 1e-4


def test_what_is_fitted_costs_nothing_in_the_bias() -> None:
    session, _ = drawn(np.random.default_rng(3))
    extended, quadratic = solved(session, grade=None), solved(session, "quadratic", None)
    ratio = extended.accelerometer_sigma.bias_m_s2 / quadratic.accelerometer_sigma.bias_m_s2
    assert np.all(ratio < 1.6)
    assert extended.quality.verdict == quadratic.quality.verdict == "good"


@pytest.mark.parametrize(
    ("order", "counts"), [("all26", (3, 4)), ("paper24", (3, 0)), ("corners24", (1, 0))], ids=["all26", "paper24", "corners24"]
)
def test_what_each_scheme_shows(order: str, counts: tuple[int, int]) -> None:
    session, _ = drawn(np.random.default_rng(4), 1.0, order=order)
    found = solved(session)
    (said,) = told(found.quality.reasons, "model_choice.extended")
    assert (said.values["cubic"], said.values["cross"]) == counts
    assert found.quality.parameters_fitted == 12 + sum(counts)
    cubic, cross, _, cross_sigma = terms(found)
    assert np.all(cubic)
    assert np.all(cross == 0) == (counts[1] == 0)
    assert np.isnan(cross_sigma).all() == (counts[1] == 0)


def test_faces_alone_are_refused() -> None:
    session, _ = drawn(np.random.default_rng(4), order="faces6")
    with refused(CalibrationError, Reason.UNOBSERVABLE, key="model_choice.no_quadratic"):
        solved(session)


def test_every_gauge_and_form_describes_one_instrument() -> None:
    session, effects = drawn(np.random.default_rng(8), 2.0, 1.0)
    raw = session.observations.mean_raw
    lower = solved(session)
    norm = np.linalg.norm(recover(lower.accelerometer, raw), axis=1)
    np.testing.assert_allclose(norm - G, lower.positions.residual_m_s2, atol=1e-9)
    for gauge in ("upper", "symmetric"):
        other = calibrate_accelerometer(session.observations, KNOWN, model="extended", gauge=gauge, grade=GRADE)
        np.testing.assert_allclose(np.linalg.norm(recover(other.accelerometer, raw), axis=1), norm, atol=1e-9)
    body = calibrate_accelerometer(
        session.observations, KNOWN, model="extended", gauge="symmetric", quadratic_axes="body", grade=GRADE
    )
    np.testing.assert_allclose(np.linalg.norm(recover(body.accelerometer, raw), axis=1), norm, atol=1e-5)
    assert np.abs(terms(body)[0] - effects.cubic).max() < 3e-4


def test_other_methods_get_outputs_without_the_terms() -> None:
    session, _ = drawn(np.random.default_rng(9), 2.0, 1.0)
    found = solved(session)
    again = restart(session.observations, found)
    norm = norm_derivatives(again.vector, again.problem.raw).norm
    np.testing.assert_allclose(norm - G, found.positions.residual_m_s2, atol=1e-9)


@pytest.mark.parametrize("order", ["paper24", "all26"])
@pytest.mark.parametrize("model", ["auto", "quadratic"])
def test_a_model_without_them_says_that_they_show(order: str, model: ModelChoice) -> None:
    rng = np.random.default_rng(12)
    for cubic_mg, cross_mg in ((2.0, 0.0), (0.0, 1.0)):
        session, _ = drawn(rng, cubic_mg, cross_mg, order)
        found = solved(session, model)
        assert found.quality.verdict != "good"
        assert told(found.quality.reasons, "quality.left_out_terms")
    session, _ = drawn(rng, order=order)
    assert not told(solved(session, model).quality.reasons, "quality.left_out_terms")


def test_what_the_extended_model_leaves_out_is_said_too() -> None:
    """paper24 with cubic terms fitted has no position to check cross terms with; they show all the same."""
    session, _ = drawn(np.random.default_rng(14), 2.0, 1.0, "paper24")
    found = solved(session)
    assert found.quality.verdict != "good"
