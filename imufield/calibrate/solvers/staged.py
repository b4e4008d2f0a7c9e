"""BSAS as [1]_ uses it: the parameters in four categories, one after the other, as often as wanted.

Every beetle takes one step size in all its coordinates, so the paper optimises scale factors, biases, misalignments and
quadratic terms in turn, in their own units, the other three fixed (section 3.4, steps 1 to 4). That is coordinate descent on a
cost with edges: each category can only reach what the errors of the other three leave it, and three of the six misalignments
are turns of the body frame, which change nothing. It is here to reproduce the paper; ``beetles.solve_bsas`` is the one to use.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from imufield.calibrate.model.models import BIAS, MISALIGNMENT, PARAMETERS, QUADRATIC, SCALE
from imufield.calibrate.solvers.base import Problem, Solver, SolverResult
from imufield.calibrate.solvers.beetles import BsasSettings, solve_bsas
from imufield.calibrate.solvers.population import Record
from imufield.dataclass import dataclass, replace
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Categories = tuple[tuple[int, ...], ...]

PAPER_CATEGORIES: Categories = tuple(tuple(range(PARAMETERS))[part] for part in (SCALE, BIAS, MISALIGNMENT, QUADRATIC))
"""Steps 1 to 4: K, b, T, K2."""
_GROUP = 3  # Coordinates per category where a problem does not have the paper's fifteen.


@dataclass(frozen=True, slots=True, kw_only=True)
class StagedSettings(BsasSettings):
    """The swarm of each category, and how often the four steps are repeated."""

    rounds: int = 1


STAGED_SETTINGS = StagedSettings()


@dataclass(frozen=True, slots=True)
class CategoryProblem:
    """Some coordinates of a problem, the others fixed."""

    whole: Problem
    fixed: FloatArray
    members: tuple[int, ...]

    @property
    def start(self) -> FloatArray:
        """Where the members are, shape (k,)."""
        return self.fixed[list(self.members)]

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of the members."""
        lower, upper = self.whole.bounds
        return lower[list(self.members)], upper[list(self.members)]

    def fill(self, z: FloatArray) -> FloatArray:
        """Return all coordinates, shape (..., k) -> (..., n)."""
        filled = np.empty((*z.shape[:-1], len(self.fixed)))
        filled[...] = self.fixed
        filled[..., list(self.members)] = z
        return filled

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return the cost of a population of members."""
        return self.whole.cost(self.fill(candidates))

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return the residuals of the whole problem."""
        return self.whole.residuals(self.fill(z))

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return their derivative by the members."""
        return self.whole.jacobian(self.fill(z))[:, list(self.members)]


def solve_stages(
    problem: Problem,
    categories: Categories,
    *,
    rng: np.random.Generator,
    rounds: int = 1,
    solver: Solver = solve_bsas,
) -> tuple[SolverResult, ...]:
    """Run a solver on each category in turn; one result per stage, with all coordinates in its ``x``."""
    x = np.asarray(problem.start, dtype=np.float64)
    stages: list[SolverResult] = []
    # Section 3.4 of [1]_, steps 1 to 4, each from where the one before ended.
    for members in categories * rounds:
        part = CategoryProblem(problem, x, members)
        solved = solver(part, rng=rng)
        x = part.fill(solved.x)
        stages.append(replace(solved, x=x))
    return tuple(stages)


def solve_bsas_staged(
    problem: Problem,
    *,
    rng: np.random.Generator | None = None,
    settings: StagedSettings = STAGED_SETTINGS,
) -> SolverResult:
    """Minimise category by category (section 3.4 of [1]_)."""
    record = Record(problem, rng)
    swarm = partial(solve_bsas, settings=settings)
    categories = default_categories(len(problem.start))
    stages = solve_stages(problem, categories, rng=record.rng, rounds=settings.rounds, solver=swarm)
    # Converged only if the last round is, and nothing nearby is better.
    record.evaluations = sum(stage.evaluations for stage in stages)
    record.history = [float(cost) for stage in stages for cost in stage.history]
    record.offer(stages[-1].x, stages[-1].cost)
    # Earlier rounds may stop early: only the last has to converge.
    last_round = stages[-(len(stages) // settings.rounds) :]
    open_stages = [stage for stage in last_round if not stage.converged]
    message = sentence("staged.converged", round=settings.rounds)
    if open_stages:
        counts = {"open": len(open_stages), "categories": len(last_round)}
        message = sentence("staged.open_categories", message=open_stages[0].message, **counts)
    return record.result(settings.s, message, converged=not open_stages)


def default_categories(n: int) -> Categories:
    """Return the paper's categories for its 15 parameters or the 12 without K2, else groups of three coordinates."""
    if n in (PARAMETERS, QUADRATIC.start):
        return tuple(members for members in PAPER_CATEGORIES if members[0] < n)
    return tuple(tuple(range(first, min(first + _GROUP, n))) for first in range(0, n, _GROUP))
