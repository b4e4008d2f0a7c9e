from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from imufield.calibrate.solvers import evolution
from imufield.calibrate.solvers.base import SolverResult
from imufield.calibrate.solvers.evolution import IdeSettings, solve_de_combined, solve_de_rand_1, solve_ide
from imufield.errors import Reason, UsageError
from imufield.study.instruments import ide_problem
from imufield.study.optimum import squares_optimum
from tests.refused import refused
from tests.told import key_of

SEEDS = range(3)


@cache
def solved(solver: Callable[..., SolverResult], seed: int) -> SolverResult:
    """Return what a strategy finds in the problem of the paper, which takes it 1200 generations."""
    rng = np.random.default_rng(seed)
    return solver(ide_problem(rng), rng=rng)


@pytest.mark.parametrize("seed", SEEDS)
def test_table_2_setting_ends_at_the_global_optimum(seed: int) -> None:
    found = solved(solve_ide, seed)
    optimum, _ = squares_optimum(ide_problem(np.random.default_rng(seed)))
    assert found.converged
    assert found.cost == pytest.approx(optimum, rel=1e-6)


def test_the_order_of_the_strategies_is_the_papers() -> None:
    strategies = (solve_de_rand_1, solve_de_combined, solve_ide)
    costs = [np.mean([solved(solver, seed).cost for seed in SEEDS]) for solver in strategies]
    assert costs[0] > costs[1] > costs[2]


def test_what_has_not_converged_says_so() -> None:
    found = solved(solve_de_rand_1, 0)
    assert not found.converged
    assert key_of(found.message) == "population.generation_limit"
    assert "1200 generations" in found.message


def test_three_indices_are_distinct_and_uniform() -> None:
    rng = np.random.default_rng(0)
    counts = np.zeros((3, 5))
    for _ in range(4000):
        drawn = np.array(evolution._three_distinct(5, rng))
        assert np.all(np.diff(np.sort(drawn, axis=0), axis=0) > 0)
        for row in range(3):
            counts[row] += np.bincount(drawn[row], minlength=5)
    assert np.all(np.abs(counts / 20000 - 0.2) < 0.015)


def test_weights_follow_equations_16_and_17() -> None:
    settings = IdeSettings()
    b, F = evolution._weights(0, np.array([1.0, 3.0]), settings)
    assert b == 0
    assert pytest.approx(1.2 - 0.85 / (1 + 0.1 * 2 + 0.15)) == F
    b, F = evolution._weights(settings.EG, np.array([1.0, 1.0]), settings)
    assert b == 1
    assert pytest.approx(settings.F_min) == F


def test_a_population_too_small_for_a_mutant_is_refused() -> None:
    with refused(UsageError, Reason.USAGE, "NP = 3", key="evolution.small_population"):
        solve_ide(ide_problem(np.random.default_rng(0)), settings=IdeSettings(NP=3))
