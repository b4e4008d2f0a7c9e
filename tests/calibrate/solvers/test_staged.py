from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.solvers.base import Problem, SolverResult, SolverStatus
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.calibrate.solvers.staged import (
    PAPER_CATEGORIES,
    CategoryProblem,
    default_categories,
    solve_bsas_staged,
    solve_stages,
)
from imufield.samples import FloatArray
from imufield.study.instruments import BSAS_AXES, BSAS_GRAVITY_M_S2, BSAS_TRUTH, PresetError, bsas_outputs, bsas_preset

pytestmark = pytest.mark.numerical


def staged_problem(preset: FloatArray, raw: FloatArray) -> NormProblem:
    return NormProblem(
        raw=raw,
        gravity_m_s2=BSAS_GRAVITY_M_S2,
        sigma_m_s2=np.ones(len(raw)),
        origin=preset,
        basis=np.eye(15),
        quadratic_axes=BSAS_AXES,
        cost_name="absolute",
    )


def test_categories_are_the_four_steps_of_the_paper() -> None:
    assert PAPER_CATEGORIES == ((0, 1, 2), (3, 4, 5), (6, 7, 8, 9, 10, 11), (12, 13, 14))
    assert default_categories(15) == PAPER_CATEGORIES
    assert default_categories(4) == ((0, 1, 2), (3,))


def test_a_category_moves_its_members_only() -> None:
    problem = staged_problem(BSAS_TRUTH, bsas_outputs(np.random.default_rng(0)))
    part = CategoryProblem(problem, np.arange(15.0), (3, 4, 5))
    filled = part.fill(np.array([[-1.0, -2.0, -3.0]]))
    assert filled.tolist() == [[0.0, 1.0, 2.0, -1.0, -2.0, -3.0, *range(6, 15)]]
    assert part.start.tolist() == [3.0, 4.0, 5.0]
    assert part.jacobian(np.zeros(3)).shape == (24, 3)


def test_with_the_truth_in_the_other_categories_scale_and_bias_reach_the_papers_cost() -> None:
    rng = np.random.default_rng(3)
    raw = bsas_outputs(rng)
    for members, off in ((PAPER_CATEGORIES[0], 0.5), (PAPER_CATEGORIES[1], 5e-3)):
        preset = BSAS_TRUTH.copy()
        preset[list(members)] += off * rng.uniform(-1, 1, 3)
        found = solve_stages(staged_problem(preset, raw), (members,), rng=rng)[0]
        assert found.cost < 8.5e-7


def test_realistic_presets_stall_far_above_and_are_not_called_converged() -> None:
    rng = np.random.default_rng(4)
    raw = bsas_outputs(rng)
    preset = bsas_preset(rng, PresetError(500e-6, 5e-4, 1e-5, 0.5))
    found = solve_bsas_staged(staged_problem(preset, raw), rng=rng)
    assert found.cost > 1e-4
    assert not found.converged


def test_stages_follow_one_another_for_any_solver() -> None:
    calls: list[int] = []

    def count(problem: Problem, *, rng: np.random.Generator | None = None) -> SolverResult:
        calls.append(len(problem.start))
        return SolverResult(
            x=problem.start, cost=1.0, status=SolverStatus.CONVERGED, message="", evaluations=1, history=np.ones(1)
        )

    raw = bsas_outputs(np.random.default_rng(0))
    stages = solve_stages(
        staged_problem(BSAS_TRUTH, raw), PAPER_CATEGORIES, rng=np.random.default_rng(0), rounds=2, solver=count
    )
    assert calls == [3, 3, 6, 3] * 2
    assert len(stages) == 8
