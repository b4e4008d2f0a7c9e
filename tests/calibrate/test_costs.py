"""Cost functions by hand, and the problem that solvers see."""

from __future__ import annotations

import math

import numpy as np
import pytest
from calibration_truth import GRAVITY, campaign, outputs, paper24, random_parameters

from imufield.calibrate.costs import COSTS, NormProblem, absolute_cost, squares_cost, weighted_cost
from imufield.calibrate.fit import column_basis
from imufield.calibrate.models import to_vector
from imufield.calibrate.observability import LOWER_GAUGE_COLUMNS

NORMS = np.array([[9.0, 11.0, 10.0], [10.0, 10.0, 10.0]])
SIGMA = np.array([1.0, 2.0, 1.0])


def test_costs_by_hand() -> None:
    assert absolute_cost(NORMS, 10.0, SIGMA).tolist() == [2.0, 0.0]
    assert squares_cost(NORMS, 10.0, SIGMA).tolist() == [math.sqrt((19**2 + 21**2) / 2), 0.0]
    assert weighted_cost(NORMS, 10.0, SIGMA).tolist() == [1.25, 0.0]
    assert set(COSTS) == {"absolute", "squares", "weighted"}


def make_problem() -> NormProblem:
    rng = np.random.default_rng(4)
    observations = campaign(random_parameters(rng), rng)
    origin = to_vector(random_parameters(rng))
    basis = column_basis(origin, LOWER_GAUGE_COLUMNS, GRAVITY)
    return NormProblem(observations.mean_raw, GRAVITY, np.full(24, 1e-3), origin, basis, reach_m_s2=0.5)


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
    problem = NormProblem(outputs(random_parameters(rng), GRAVITY * paper24()), GRAVITY, np.ones(24), origin, basis)
    bent = np.zeros((2, 12))
    bent[1, 9] = -100.0
    cost = problem.cost(bent)
    assert np.isfinite(cost[0])
    assert cost[1] == np.inf
