"""Beetle antennae search (BAS) and beetle swarm antennae search (BSAS), after [1]_.

Each round every beetle draws a direction ``u`` (eq. 1), smells the cost at its two antennae ``x +- d u`` (eq. 2, 3) and steps
to ``x -+ s u``, away from the antenna with the larger cost. Equation 5 is printed for maximising; the sign is reversed here.

A single beetle (Algorithm 1) goes where its antennae send it, and step and distance shrink every round. The swarm (Algorithm
2) starts all its beetles from one point. If some find a better one, the best of them is the next start with probability
``p_pos``, else any of them. If none does, step and distance shrink with probability ``p_st``, and always once ``n_st`` rounds
in a row were in vain. The start may therefore be worse than a point already seen; the best ever is kept apart.

Attenuation and iterations belong together. In whitened coordinates 0.965 and at most 1200 iterations ended within 0.03 % of the
exact minimum of eq. 13 in 200 runs of 200; 0.95 with 600 iterations at up to 3 % above it.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020: Table 2 for the settings.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.solvers.base import Problem, SolverResult
from imufield.calibrate.solvers.population import Record, into_bounds
from imufield.dataclass import dataclass
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)


@dataclass(frozen=True, slots=True, kw_only=True)
class BasSettings:
    """One beetle, Table 2 of [1]_; ``s`` and ``d`` are in units of the coordinates."""

    s: float = 0.98
    """Searching step size."""
    c_s: float = 0.9
    """Attenuation coefficient of the step size."""
    d: float = 2.0
    """Searching distance."""
    c_d: float = 0.9
    """Attenuation coefficient of the searching distance."""
    s_0: float = 2.22e-16
    """Minimum resolution of the step size."""
    d_0: float = 2.22e-16
    """Minimum resolution of the searching distance."""
    k_max: int = 300
    """Iterations at most."""
    tolerance: float = 1e-6
    """Relative difference of the costs at the antennae, at their largest, at which the beetles smell nothing more. Ours."""


@dataclass(frozen=True, slots=True)
class BsasSettings(BasSettings):
    """A swarm, Table 2 of [1]_."""

    m: int = 10
    """Beetles."""
    p_pos: float = 0.8
    """Position update probability constant."""
    p_st: float = 0.8
    """Step size update probability constant."""
    n_st: int = 2
    """Maximum number of invalid searches with one step size."""


BAS_SETTINGS = BasSettings()
WHITENED_SETTINGS = BsasSettings(c_s=0.965, c_d=0.965, k_max=1200)
"""For whitened coordinates: slower attenuation, and the iterations it takes."""


def solve_bas(
    problem: Problem,
    *,
    rng: np.random.Generator | None = None,
    settings: BasSettings = BAS_SETTINGS,
) -> SolverResult:
    """Minimise with one beetle (Algorithm 1)."""
    record = Record(problem, rng)
    x = np.asarray(problem.start, dtype=np.float64)
    record.offer(x, float(record.cost(x[None])[0]))
    s, d = settings.s, settings.d
    smelled = np.inf  # nothing yet
    for _ in range(settings.k_max):
        u = _directions(record.rng, 1, len(x))
        towards, smelled = _antennae(record, problem, x, u, d=d)
        x = into_bounds(problem, x - s * towards * u)[0]  # eq. 5, minimising
        record.offer(x, float(record.cost(x[None])[0]))
        s, d = _attenuate(s, d, settings)
        record.end_of_iteration()
    finished = smelled <= settings.tolerance * record.best_cost
    ending = sentence("beetles.smelled", tolerance=settings.tolerance) if finished else _limit_reached(settings)
    return record.result(settings.s, ending, converged=finished)


def solve_bsas(
    problem: Problem,
    *,
    rng: np.random.Generator | None = None,
    settings: BsasSettings = WHITENED_SETTINGS,
) -> SolverResult:
    """Minimise with a swarm of beetles (Algorithm 2).

    Parameters
    ----------
    problem : Problem
        All coordinates should weigh alike: ``swarm_coordinates.whitened_problem`` makes them so.
    rng : Generator, optional
    settings : BsasSettings
        The default is for whitened coordinates; ``BsasSettings()`` is the paper's.
    """
    record = Record(problem, rng)
    x = np.asarray(problem.start, dtype=np.float64)
    f = float(record.cost(x[None])[0])
    record.offer(x, f)
    s, d, invalid = settings.s, settings.d, 0
    least_s = settings.s_0 / (1 - settings.c_s)  # Eq. 6 approaches it.
    ending: Sentence | None = None
    for _ in range(settings.k_max):
        u = _directions(record.rng, settings.m, len(x))
        towards, smelled = _antennae(record, problem, x, u, d=d)
        beetles = into_bounds(problem, x - s * towards[:, None] * u)  # eq. 7, minimising
        costs = record.cost(beetles)
        better = np.flatnonzero(costs < f)
        if len(better):  # Algorithm 2, lines 8 to 14
            record.offer_best(beetles, costs)
            chosen = int(np.argmin(costs)) if record.rng.random() < settings.p_pos else int(record.rng.choice(better))
            x, f, invalid = beetles[chosen], float(costs[chosen]), 0
        else:
            invalid += 1
            if record.rng.random() < settings.p_st or invalid > settings.n_st:  # Algorithm 2, line 16
                s, d = _attenuate(s, d, settings)
                invalid = 0
        record.end_of_iteration()
        if len(better):
            continue
        if smelled <= settings.tolerance * f:
            ending = sentence("beetles.smelled", tolerance=settings.tolerance)
        elif s <= 1.01 * least_s:
            ending = sentence("beetles.least_step", step=least_s)
        if ending is not None:
            break
    return record.result(settings.s, ending or _limit_reached(settings), converged=ending is not None)


def _directions(rng: np.random.Generator, beetles: int, n: int) -> FloatArray:
    """Return random unit vectors, shape (m, n) (eq. 1)."""
    u = rng.standard_normal((beetles, n))  # eq. 1
    u /= np.sqrt(np.einsum("mn,mn->m", u, u))[:, None]
    return u


def _antennae(record: Record, problem: Problem, x: FloatArray, u: FloatArray, *, d: float) -> tuple[FloatArray, float]:
    """Return which antenna has the larger cost, shape (m,): +1 right, -1 left; and the largest difference (eq. 2, 3)."""
    tips = into_bounds(problem, np.concatenate([x + d * u, x - d * u]))  # eq. 2
    right, left = record.cost(tips).reshape(2, -1)  # eq. 3
    # Where the model cannot be inverted the cost is infinite, so compare and do not subtract.
    towards = (right > left).astype(np.float64) - (right < left)
    finite = np.isfinite(right) & np.isfinite(left)
    smelled = float(np.abs(right[finite] - left[finite]).max()) if finite.any() else np.inf
    return towards, smelled


def _attenuate(s: float, d: float, settings: BasSettings) -> tuple[float, float]:
    """Return the next step and distance (eq. 6 and 4)."""
    return settings.c_s * s + settings.s_0, settings.c_d * d + settings.d_0


def _limit_reached(settings: BasSettings) -> Sentence:
    return sentence("beetles.iteration_limit", iterations=settings.k_max)
