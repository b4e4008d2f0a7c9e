from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import numeric_jacobian

from imufield.calibrate.solvers.triad_costs import TriadProblem, TurnsProblem
from imufield.study.instruments import GYROSCOPE_TRUTH, IDE_GRAVITY_M_S2, IDE_TRUTH, gyroscope_turns_problem, ide_problem

pytestmark = pytest.mark.numerical


def test_triad_cost_by_hand() -> None:
    # Two positions, unit instrument: norms 2 and 1 against 1, so L = sqrt((1 - 4)^2 + 0) / 1 = 3.
    problem = TriadProblem(np.array([[2.0, 0, 0], [0, 1.0, 0]]), 1.0, np.zeros(12), np.ones(12))
    unit = np.array([1.0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    assert problem.cost(unit[None])[0] == pytest.approx(3.0)


def test_triad_recovers_what_was_put_in() -> None:
    problem = ide_problem(np.random.default_rng(0), noise_m_s2=0.0)
    norms = np.linalg.norm(problem.inputs(IDE_TRUTH[None])[0], axis=0)
    assert norms == pytest.approx(np.full(24, IDE_GRAVITY_M_S2), rel=1e-13)


def test_triad_derivatives() -> None:
    problem = ide_problem(np.random.default_rng(0))
    step = np.concatenate([np.full(3, 0.1), np.full(6, 1e-5), np.full(3, 0.1)])
    expected = numeric_jacobian(problem.residuals, IDE_TRUTH, step)
    assert problem.jacobian(IDE_TRUTH) == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("form", ["norm", "vector"])
def test_turns_derivatives(form: str) -> None:
    problem = gyroscope_turns_problem(np.random.default_rng(0), form)
    step = np.concatenate([np.full(3, 0.1), np.full(6, 1e-5)])
    expected = numeric_jacobian(problem.residuals, GYROSCOPE_TRUTH[:9], step)
    assert problem.jacobian(GYROSCOPE_TRUTH[:9]) == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())
    assert problem.cost(GYROSCOPE_TRUTH[None, :9])[0] == pytest.approx(
        np.linalg.norm(problem.residuals(GYROSCOPE_TRUTH[:9])), rel=1e-12
    )


@pytest.mark.parametrize(("form", "rank"), [("norm", 3), ("vector", 9)])
def test_equation_26_has_rank_3_and_the_vector_form_9(form: str, rank: int) -> None:
    problem = gyroscope_turns_problem(np.random.default_rng(0), form)
    scale = np.concatenate([np.full(3, 8000.0), np.ones(6)])
    assert np.linalg.matrix_rank(problem.jacobian(GYROSCOPE_TRUTH[:9]) * scale, tol=None) == rank


def test_three_pairs_determine_the_vector_form_exactly() -> None:
    whole = gyroscope_turns_problem(np.random.default_rng(0), "vector")
    three: TurnsProblem = replace(whole, difference=whole.difference[:3], rate=whole.rate[:3])
    KE = (three.difference / 2).T @ np.linalg.inv(three.rate.T)
    K = np.diag(KE)
    E = (KE / K[:, None])[(0, 0, 1, 1, 2, 2), (1, 2, 0, 2, 0, 1)]
    assert three.cost(np.concatenate([K, E])[None])[0] == pytest.approx(0.0, abs=1e-9)
