"""Differential evolution: DE/rand/1, DE/current-to-best/1, their combination, and the improved form (IDE), after [1]_.

All share initialisation within the bounds (eq. 9), crossover (eq. 12) and selection (eq. 13); they differ in how a mutant is
made. The paper maximises ``f = 1 / L``; here ``L`` itself is minimised, and ``1 / f_min - 1 / f_max`` of eq. 17 is the
difference between the largest and smallest cost of the population.

What the paper does not print: ``F_max`` and ``F_min``, and what becomes of a candidate outside the bounds (its offending
entries are drawn anew within them). With 1.2 and 0.35 all of 300 runs in the setting of Table 2 ended within 3e-8 of the
optimum; with 0.3 one of 100 froze 6e-5 above it, with 0.5 half had not quite arrived.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021: section 3.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from imufield.calibrate.solvers.base import Problem, SolverResult
from imufield.calibrate.solvers.population import Record, check_finite_bounds, relative_spread
from imufield.dataclass import dataclass
from imufield.errors import UsageError
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Strategy = Literal["rand", "current-to-best", "combined"]
_FEWEST = 4  # Members a mutant is made from: three distinct ones, and its own parent.


@dataclass(frozen=True, slots=True, kw_only=True)
class EvolutionSettings:
    """Settings of section 3 of [1]_ that all strategies share, under its names."""

    NP: int = 60
    """Population size."""
    EG: int = 1200
    """Generations."""
    CR: float = 0.6
    """Crossover probability."""
    tolerance: float = 1e-6
    """Spread of the population's costs, relative to the lowest, at which it counts as converged. Ours."""
    interval: float = 1e-13
    """The same, at which it stops before ``EG`` ("falls within preset convergence interval", section 3.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeSettings(EvolutionSettings):
    """A mutation factor that stays."""

    F: float = 1.2


@dataclass(frozen=True, slots=True, kw_only=True)
class IdeSettings(EvolutionSettings):
    """A mutation factor that adapts (eq. 17)."""

    F_max: float = 1.2
    F_min: float = 0.35
    alpha: float = 0.1
    beta: float = 0.15


DE_SETTINGS = DeSettings()
IDE_SETTINGS = IdeSettings()


def evolve(
    problem: Problem,
    *,
    strategy: Strategy,
    rng: np.random.Generator | None = None,
    settings: DeSettings | IdeSettings = DE_SETTINGS,
) -> SolverResult:
    """Minimise within the problem's bounds by one of the strategies, with a mutation factor that stays or one that adapts.

    Raises
    ------
    CalibrationError
        If a coordinate has no finite bounds, or starts outside them.
    UsageError
        If the population is too small.
    """
    lower, upper = check_finite_bounds(problem)
    if settings.NP < _FEWEST:
        raise UsageError(sentence("evolution.small_population", members=settings.NP, fewest=_FEWEST))
    record = Record(problem, rng)
    rng = record.rng
    members = lower + rng.random((settings.NP, len(lower))) * (upper - lower)  # eq. 9
    costs = record.cost(members)
    record.offer_best(members, costs)
    for t in range(settings.EG):
        best = members[int(np.argmin(costs))]
        mutants = _mutants(strategy, members, best, _weights(t, costs, settings), rng=rng)
        trials = np.where(rng.random(members.shape) < settings.CR, mutants, members)  # eq. 12
        # Entries outside the bounds are drawn anew within them; the paper does not say what becomes of them.
        outside = (trials < lower) | (trials > upper)
        if outside.any():
            trials[outside] = (lower + rng.random(trials.shape) * (upper - lower))[outside]
        trial_costs = record.cost(trials)
        wins = trial_costs < costs  # eq. 13
        members[wins], costs[wins] = trials[wins], trial_costs[wins]
        record.offer_best(members, costs)
        record.end_of_iteration()
        if relative_spread(costs) <= settings.interval:
            break
    return record.population_result(costs, settings.tolerance, settings.EG)


solve_de_rand_1 = partial(evolve, strategy="rand")
"""DE/rand/1 (eq. 11)."""
solve_de_current_to_best_1 = partial(evolve, strategy="current-to-best")
"""DE/current-to-best/1 (eq. 14)."""
solve_de_combined = partial(evolve, strategy="combined")
"""The weighted combination of the two (eq. 15, 16)."""
solve_ide = partial(evolve, strategy="combined", settings=IDE_SETTINGS)
"""IDE: the combination with an adaptive mutation factor (eq. 17, 18)."""


def _weights(t: int, costs: FloatArray, settings: DeSettings | IdeSettings) -> tuple[float, float]:
    """Return b and F, the two numbers that change with the generation."""
    b = 2 * t / settings.EG - (t / settings.EG) ** 2  # eq. 16
    if isinstance(settings, DeSettings):
        return b, settings.F
    # eq. 17 with 1 / f_min - 1 / f_max = L_max - L_min; without a largest cost F stays up
    spread = float(costs.max() - costs.min()) if np.isfinite(costs).all() else np.inf
    damping = 1 + settings.alpha * spread + settings.beta * (1 - t / settings.EG)
    return b, settings.F_max - (settings.F_max - settings.F_min) / damping  # eq. 17


def _mutants(
    strategy: Strategy, members: FloatArray, best: FloatArray, weights: tuple[float, float], *, rng: np.random.Generator
) -> FloatArray:
    x, y, z = _three_distinct(len(members), rng)
    b, F = weights
    to_best = members + F * (best - members)
    origins = {
        "rand": members[x],  # eq. 11
        "current-to-best": to_best,  # eq. 14
        "combined": (1 - b) * members[x] + b * to_best,  # eq. 15 and 18
    }
    return np.asarray(origins[strategy] + F * (members[y] - members[z]))


def _three_distinct(size: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return three indices for each member, all distinct, uniformly from the population."""
    draw = (rng.random((3, size)) * np.array([[size], [size - 1], [size - 2]])).astype(np.intp)
    # The second and third skip the places that are already taken.
    x = draw[0]
    y = draw[1] + (draw[1] >= x)
    z = draw[2] + (draw[2] >= np.minimum(x, y))
    z += z >= np.maximum(x, y)
    return x, y, z
