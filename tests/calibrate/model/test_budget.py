"""The uncertainty budget: its shares add up to the covariance, and are what they are called."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import GRAVITY, observe, outputs, paper24, random_parameters, tilted
from drifting_sessions import Session, faces_first

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.budget import Share, combined_sigma, effective_freedom, welch_satterthwaite
from imufield.calibrate.model.coverage_factors import degrees_of_freedom, student_factor
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, Calibration, ModelChoice
from imufield.earth import Gravity
from imufield.samples import FloatArray

KNOWN = Gravity(gravity_m_s2=GRAVITY, sigma_m_s2=5e-4, source="normal")
WITHIN_M_S2 = 2e-4
SCATTER_M_S2 = 1e-3


def share(calibration: Calibration, name: str) -> Share:
    return next(share for share in calibration.budget if share.name == name)


@pytest.mark.parametrize("model", ["auto", "linear", "quadratic", "extended"])
@pytest.mark.parametrize("warm_up_ug", [0.0, 3000.0])
@pytest.mark.parametrize("has_noise_known", [True, False])
def test_the_squares_add_up_to_the_variances(model: ModelChoice, warm_up_ug: float, has_noise_known: bool) -> None:
    session = Session(directions=faces_first(), warm_up_ug=warm_up_ug, quadratic_ug=100, has_noise_known=has_noise_known)
    observations, _ = session.take(np.random.default_rng(1))
    for grade in (None, "tactical"):
        found = calibrate_accelerometer(observations, KNOWN, model=model, grade=grade)
        assert combined_sigma(found.budget) ** 2 == pytest.approx(np.diag(found.covariance), rel=1e-9, abs=0)
        names = {each.name for each in found.budget}
        assert ("nonlinearity" in names) == (grade is not None)
        assert ("higher_terms" in names) == (model == "extended")
        assert ("drift" in names) == bool(np.any(found.positions.bias_drift_m_s2))


def test_positions_that_show_little_leave_it_to_the_grade() -> None:
    rng = np.random.default_rng(3)
    up = tilted(np.vstack([np.eye(3), -np.eye(3), np.eye(3)]), rng, 0.05)
    truth = random_parameters(rng)
    raw = outputs(truth, GRAVITY * up) + truth.scale * SCATTER_M_S2 * rng.standard_normal(up.shape)
    found = calibrate_accelerometer(observe(raw), KNOWN, grade="mems")
    assert combined_sigma(found.budget) ** 2 == pytest.approx(np.diag(found.covariance), rel=1e-9, abs=0)
    assert {"misalignment_not_shown", "quadratic_not_shown"} <= {each.name for each in found.budget}


def test_gravity_s_share_is_what_another_gravity_changes() -> None:
    observations, _ = Session(directions=faces_first(), quadratic_ug=300).take(np.random.default_rng(2))
    found = calibrate_accelerometer(observations, KNOWN, model="quadratic", gauge="lower")
    other = replace(KNOWN, gravity_m_s2=KNOWN.gravity_m_s2 + KNOWN.sigma_m_s2)
    again = calibrate_accelerometer(observations, other, model="quadratic", gauge="lower")
    changed = np.abs(to_vector(again.accelerometer) - to_vector(found.accelerometer))
    names = [name.rpartition(".")[0] for name in found.covariance_names[:-1]]
    rows = [k for k, name in enumerate(names) if "misalignment" not in name]
    by_gravity = share(found, "gravity").sigma
    assert by_gravity[rows] == pytest.approx(changed[rows], rel=1e-3)
    assert by_gravity[-1] == KNOWN.sigma_m_s2


def test_the_scatter_s_share_is_what_scatter_does() -> None:
    rng = np.random.default_rng(4)
    truth = random_parameters(rng)
    up = tilted(paper24(), rng, 0.08)
    covariance = np.broadcast_to(np.diag((truth.scale * WITHIN_M_S2) ** 2), (24, 3, 3))

    def solve(noise_m_s2: FloatArray, scatter_m_s2: FloatArray) -> Calibration:
        raw = outputs(truth, GRAVITY * up) + truth.scale * (noise_m_s2 + scatter_m_s2)
        return calibrate_accelerometer(observe(raw, covariance), KNOWN, model="linear")

    moved, stated, noises, scatters = [], [], [], []
    for _ in range(40):
        noise, scatter = WITHIN_M_S2 * rng.standard_normal((24, 3)), SCATTER_M_S2 * rng.standard_normal((24, 3))
        found = solve(noise, scatter)
        moved.append(to_vector(found.accelerometer) - to_vector(solve(noise, 0 * scatter).accelerometer))
        stated.append(share(found, "between_holds").sigma[:-1])
        places = [ACCELEROMETER_NAMES.index(name) for name in found.covariance_names[:-1]]
        noises.append(share(found, "within_hold").input_sigma)
        scatters.append(share(found, "between_holds").input_sigma)
    truly, claimed = np.mean(np.square(moved), axis=0)[places], np.mean(np.square(stated), axis=0)
    estimated = claimed > 0
    assert np.mean(truly[estimated] / claimed[estimated]) == pytest.approx(1, abs=0.15)
    assert np.mean(noises) == pytest.approx(WITHIN_M_S2, rel=0.02)
    assert np.sqrt(np.mean(np.square(scatters))) == pytest.approx(SCATTER_M_S2, rel=0.05)


def test_effective_degrees_of_freedom_of_the_gum_s_end_gauge() -> None:
    # JCGM 100:2008, H.1.6: the end gauge, nm; 16.7, so that k of 99 % is 2.92 and the expanded uncertainty 93 nm.
    sigma, freedom = np.array([25.0, 9.7, 2.9, 16.6]), np.array([18, 25.6, 50, 2])
    found = float(welch_satterthwaite(sigma**2, freedom))
    assert found == pytest.approx(16.7, abs=0.1)
    k = student_factor(int(found), chance=0.01)
    assert k == pytest.approx(2.92, abs=0.005)
    assert k * np.sqrt(np.sum(sigma**2)) == pytest.approx(93, abs=0.6)


def test_shares_of_the_same_residuals_count_as_one_estimate() -> None:
    one = Share(name="one", kind="A", residuals="fit", degrees_of_freedom=12.0, sigma=np.array([3.0, 1.0, 1.0]))
    two = replace(one, name="two", sigma=np.array([4.0, 0.0, 0.0]))
    known = Share(name="known", kind="B", sigma=np.array([0.0, 1.0, 0.0]))
    # The first is 5 with 12; of the second half of the variance is estimated, so 12 over its square.
    assert effective_freedom([one, two, known]) == pytest.approx([12, 48, 12])
    assert np.isinf(effective_freedom([known])[1])
    assert effective_freedom([replace(one, degrees_of_freedom=0.0), known])[1] == 0


def test_the_factor_of_one_for_all_is_that_of_the_mean_parameter() -> None:
    session = Session(directions=faces_first(), has_noise_known=False)
    observations, _ = session.take(np.random.default_rng(5))
    found = calibrate_accelerometer(observations, KNOWN, model="linear", grade="mems")
    freedom, stated = effective_freedom(found.budget)[:-1], degrees_of_freedom(found.quality.student_factor_95)
    estimated = np.isfinite(freedom)
    assert freedom[estimated].min() <= stated <= freedom[estimated].max()
