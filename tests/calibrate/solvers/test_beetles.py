from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from imufield.calibrate.accelerometer.swarm_coordinates import whitened_problem
from imufield.calibrate.solvers.base import SolverStatus
from imufield.calibrate.solvers.beetles import WHITENED_SETTINGS, BasSettings, BsasSettings, solve_bas, solve_bsas
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.samples import FloatArray
from imufield.sentences import Sentence
from imufield.study.instruments import BSAS_AXES, BSAS_GRAVITY_M_S2, bsas_outputs, bsas_preset
from imufield.study.optimum import exact_absolute_minimum
from tests.told import key_of


@dataclass
class Slope:
    """The cost is the first coordinate: only the direction of a step matters."""

    @property
    def start(self) -> FloatArray:
        return np.zeros(2)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        return np.full(2, -np.inf), np.full(2, np.inf)

    def cost(self, candidates: FloatArray) -> FloatArray:
        return candidates[:, 0] + 100

    def residuals(self, z: FloatArray) -> FloatArray:
        return z

    def jacobian(self, z: FloatArray) -> FloatArray:
        return np.eye(len(z))


def test_a_beetle_walks_downhill() -> None:
    # Equation 5 as printed would walk uphill: every step has to lower the cost here.
    found = solve_bas(Slope(), rng=np.random.default_rng(1), settings=BasSettings(k_max=10))
    assert np.all(np.diff(found.history) < 0)


def test_one_beetle_takes_two_antennae_and_one_step_a_round() -> None:
    found = solve_bas(Slope(), rng=np.random.default_rng(1), settings=BasSettings(k_max=10))
    assert found.evaluations == 1 + 10 * 3


def test_paper_settings_are_table_2() -> None:
    s = BsasSettings()
    assert (s.m, s.p_pos, s.p_st, s.n_st, s.s, s.c_s, s.d, s.c_d, s.k_max) == (10, 0.8, 0.8, 2, 0.98, 0.9, 2.0, 0.9, 300)
    assert s.s_0 == s.d_0 == 2.22e-16


def test_always_stepping_to_the_best_needs_no_luck_and_still_keeps_the_best_ever() -> None:
    for p_pos in (0.0, 1.0):
        found = solve_bsas(Slope(), rng=np.random.default_rng(2), settings=BsasSettings(k_max=10, p_pos=p_pos))
        assert found.cost == found.history.min()


@cache
def _table_3_optimum(seed: int) -> float:
    """Return the exact minimum of the cost."""
    return exact_absolute_minimum(_table_3_problem(seed)[0])[0]


def _table_3_problem(seed: int) -> tuple[NormProblem, np.random.Generator]:
    rng = np.random.default_rng(seed)
    raw, preset = bsas_outputs(rng), bsas_preset(rng)
    return whitened_problem(preset, raw, BSAS_GRAVITY_M_S2, quadratic_axes=BSAS_AXES), rng


@pytest.mark.parametrize("seed", range(5))
def test_table_3_setting_ends_at_the_exact_minimum(seed: int) -> None:
    problem, rng = _table_3_problem(seed)
    found = solve_bsas(problem, rng=rng)
    exact = _table_3_optimum(seed)
    assert found.converged
    assert key_of(found.message) == "beetles.smelled"
    assert exact * (1 - 1e-9) <= found.cost <= 1.1 * exact


def test_a_search_that_the_least_step_ended_says_so() -> None:
    problem, rng = _table_3_problem(0)
    # Steps no smaller than 0.2 sigma end far above where the antennae smell no difference.
    found = solve_bsas(problem, rng=rng, settings=replace(WHITENED_SETTINGS, c_s=0.5, s_0=0.1, p_st=1.0))
    assert isinstance(found.message, Sentence)
    ending = found.message.values.get("message", found.message)
    assert (ending.key, round(ending.values["step"], 9)) == ("beetles.least_step", 0.2)


def test_one_beetle_stalls_there_and_says_so() -> None:
    problem, rng = _table_3_problem(0)
    found = solve_bas(problem, rng=rng)
    assert found.status is SolverStatus.STALLED
    assert key_of(found.message) == "population.stalled"
    assert found.cost > 10 * _table_3_optimum(0)


def test_too_few_iterations_do_not_claim_to_have_converged() -> None:
    problem, rng = _table_3_problem(0)
    found = solve_bsas(problem, rng=rng, settings=replace(WHITENED_SETTINGS, k_max=300))
    assert found.cost > 1.1 * _table_3_optimum(0)
    assert not found.converged
