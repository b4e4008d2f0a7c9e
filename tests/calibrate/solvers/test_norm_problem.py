"""Cost functions against their formulas, and the problem that solvers see."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_truth import GRAVITY, campaign, numeric_jacobian, outputs, paper24, random_parameters

from imufield.calibrate.accelerometer.fit import column_basis
from imufield.calibrate.model.models import recover_vectors, to_vector
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS
from imufield.calibrate.model.result import QuadraticAxes
from imufield.calibrate.solvers.norm_problem import CostName, NormProblem
from imufield.samples import FloatArray
from imufield.study.instruments import BSAS_GRAVITY_M_S2, BSAS_TRUTH, bsas_outputs

pytestmark = pytest.mark.numerical

STEP = np.concatenate([np.full(3, 1e-2), np.full(3, 1e-3), np.full(6, 1e-4), np.full(3, 1e-4)])


def population(axes: QuadraticAxes, cost: CostName) -> NormProblem:
    raw = bsas_outputs(np.random.default_rng(1), 1e-5)
    sigma = np.linspace(1e-5, 2e-5, len(raw))
    return NormProblem(
        raw=raw,
        gravity_m_s2=BSAS_GRAVITY_M_S2,
        sigma_m_s2=sigma,
        origin=BSAS_TRUTH,
        basis=np.diag(STEP),
        quadratic_axes=axes,
        cost_name=cost,
    )


def plain_cost(problem: NormProblem, z: FloatArray) -> FloatArray:
    """The formulas as the papers print them, over the model's own inverse."""
    n = np.linalg.norm(recover_vectors(problem.vector(z), problem.raw, problem.quadratic_axes), axis=-1)
    g, m = problem.gravity_m_s2, len(problem.raw)
    formulas = {
        "absolute": np.abs(n - g).sum(axis=-1),
        "squares": np.sqrt(((g**2 - n**2) ** 2).sum(axis=-1) / (m - 1)),
        "weighted": (((n - g) / problem.sigma_m_s2) ** 2).sum(axis=-1),
    }
    return np.asarray(formulas[problem.cost_name])


@pytest.mark.parametrize("axes", ["sensing", "body"])
@pytest.mark.parametrize("cost", ["absolute", "squares", "weighted"])
def test_costs_equal_their_formulas(axes: QuadraticAxes, cost: CostName) -> None:
    problem = population(axes, cost)
    z = np.random.default_rng(2).standard_normal((30, 15))
    assert problem.cost(z) == pytest.approx(plain_cost(problem, z), rel=1e-9)


@pytest.mark.parametrize(
    ("cost", "expected"), [("absolute", 2.0), ("squares", np.sqrt((19**2 + 21**2) / 2)), ("weighted", 1.25)]
)
def test_costs_by_hand(cost: CostName, expected: float) -> None:
    unit = np.concatenate([np.ones(3), np.zeros(12)])
    raw = np.array([[9.0, 0, 0], [0, 11.0, 0], [0, 0, 10.0]])
    problem = NormProblem(
        raw=raw, gravity_m_s2=10.0, sigma_m_s2=np.array([1.0, 2.0, 1.0]), origin=unit, basis=np.eye(15), cost_name=cost
    )
    assert problem.cost(np.zeros((1, 15)))[0] == pytest.approx(expected)


def make_problem() -> NormProblem:
    rng = np.random.default_rng(4)
    observations = campaign(random_parameters(rng), rng)
    origin = to_vector(random_parameters(rng))
    basis = column_basis(origin, LOWER_GAUGE_COLUMNS, GRAVITY)
    return NormProblem(
        raw=observations.mean_raw, gravity_m_s2=GRAVITY, sigma_m_s2=np.full(24, 1e-3), origin=origin, basis=basis, reach=0.5
    )


def test_cost_of_a_population_is_the_sum_of_squared_residuals() -> None:
    problem = make_problem()
    population = np.random.default_rng(0).normal(0, 0.01, (5, 12))
    expected = [np.sum(problem.residuals(z) ** 2) for z in population]
    assert problem.cost(population) == pytest.approx(expected, rel=1e-12)


def test_jacobian_against_differences() -> None:
    problem = make_problem()
    z = np.random.default_rng(1).normal(0, 0.01, 12)
    for k in range(12):
        step = 1e-5 * np.eye(12)[k]
        difference = (problem.residuals(z + step) - problem.residuals(z - step)) / 2e-5
        assert problem.jacobian(z)[:, k] == pytest.approx(difference, abs=1e-5 * np.abs(difference).max())


def test_bounds_and_start_have_the_size_of_the_basis() -> None:
    problem = make_problem()
    assert problem.start.tolist() == [0.0] * 12
    low, high = problem.bounds
    assert low.tolist() == [-0.5] * 12
    assert high.tolist() == [0.5] * 12


def test_a_candidate_outside_the_model_costs_infinity() -> None:
    rng = np.random.default_rng(4)
    origin = to_vector(random_parameters(rng))
    basis = column_basis(origin, LOWER_GAUGE_COLUMNS, GRAVITY)
    problem = NormProblem(
        raw=outputs(random_parameters(rng), GRAVITY * paper24()),
        gravity_m_s2=GRAVITY,
        sigma_m_s2=np.ones(24),
        origin=origin,
        basis=basis,
    )
    bent = np.zeros((2, 12))
    bent[1, 9] = -100.0
    cost = problem.cost(bent)
    assert np.isfinite(cost[0])
    assert cost[1] == np.inf


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_wild_candidates_cost_infinity_and_do_not_spoil_their_neighbours(axes: QuadraticAxes) -> None:
    problem = population(axes, "absolute")
    z = np.zeros((3, 15))
    z[1, 12:] = 1e9
    costs = problem.cost(z)
    assert costs[0] == costs[2] == pytest.approx(problem.cost(z[:1])[0])
    assert costs[1] == np.inf or costs[1] > 1.0


def test_a_singular_alignment_costs_infinity() -> None:
    problem = population("sensing", "absolute")
    z = np.zeros((2, 15))
    z[1, 6:12] = (1.0 - BSAS_TRUTH[6:12]) / STEP[6:12]  # all ones: rank 1
    costs = problem.cost(z)
    assert np.isfinite(costs[0])
    assert costs[1] > 1e3


@pytest.mark.parametrize("cost", ["weighted", "squares"])
def test_derivatives_of_the_norm_problem(cost: CostName) -> None:
    problem = population("body", cost)
    z = np.random.default_rng(3).standard_normal(15)
    expected = numeric_jacobian(problem.residuals, z, np.full(15, 1e-2))
    assert problem.jacobian(z) == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())


def test_squares_cost_is_the_root_of_the_summed_squared_residuals() -> None:
    problem = population("body", "squares")
    z = np.random.default_rng(3).standard_normal(15)
    assert problem.cost(z[None])[0] == pytest.approx(np.linalg.norm(problem.residuals(z)), rel=1e-12)
