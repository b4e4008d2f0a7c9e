from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.accelerometer.swarm_coordinates import whitened_problem
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.study.instruments import (
    BSAS_GRAVITY_M_S2,
    BSAS_TRUTH,
    bsas_outputs,
    bsas_preset,
    gyroscope_static_problem,
    ide_problem,
)
from imufield.study.optimum import cramer_rao_bound, exact_absolute_minimum, squares_optimum


def test_nothing_near_the_exact_minimum_costs_less() -> None:
    rng = np.random.default_rng(0)
    problem = whitened_problem(bsas_preset(rng), bsas_outputs(rng), BSAS_GRAVITY_M_S2, quadratic_axes="body")
    cost, z = exact_absolute_minimum(problem)
    directions = rng.standard_normal((500, 12))
    for size in (1e-8, 1e-7, 1e-6):
        assert problem.cost(z + size * directions).min() >= cost * (1 - 1e-6)
    # Twelve free numbers: the minimum passes through at least twelve positions exactly.
    residual = np.sort(np.abs(problem.residuals(z)))
    assert residual[11] < 1e-3 * residual[-1]


def test_least_squares_reaches_the_cramer_rao_bound_on_sensing_axes() -> None:
    sigma = 1e-5
    clean = bsas_outputs(np.random.default_rng(0), 0.0)
    bound = cramer_rao_bound(BSAS_TRUTH, clean, BSAS_GRAVITY_M_S2, sigma, quadratic_axes="sensing")
    rng = np.random.default_rng(1)
    problem = whitened_problem(BSAS_TRUTH, clean, BSAS_GRAVITY_M_S2, quadratic_axes="sensing")
    start = solve_least_squares(problem).x
    clean_numbers = intrinsic(problem.vector(start), "sensing")[0]
    errors = []
    for _ in range(300):
        noisy = replace(problem, raw=clean + BSAS_TRUTH[:3] * sigma * rng.standard_normal(clean.shape))
        found = intrinsic(noisy.vector(solve_least_squares(noisy).x), "sensing")[0]
        errors.append(found - clean_numbers)
    assert np.sqrt(np.mean(np.square(errors), axis=0)) / bound == pytest.approx(np.ones(12), abs=0.15)


def test_the_optimum_of_squares_is_flat_where_it_is_free() -> None:
    problem = ide_problem(np.random.default_rng(0))
    cost, x = squares_optimum(problem)
    gradient = problem.jacobian(x).T @ problem.residuals(x)
    # Across all of its bounds no parameter lowers the cost by more than this share.
    assert np.abs(gradient * (problem.upper - problem.lower)).max() < 1e-5 * cost


def test_the_optimum_of_squares_keeps_to_the_bounds() -> None:
    problem = gyroscope_static_problem(np.random.default_rng(0))
    _, x = squares_optimum(problem)
    assert np.all((problem.lower <= x) & (x <= problem.upper))
