"""Record, checks and ending of the swarm methods: the best point ever, the start within its bounds, and a probe at the end.

A swarm has no gradient to show that it has arrived, so it is asked twice. First its own sign: the antennae of the beetles
smell no difference any more, or the costs of the population agree. Then a probe: points around the best one, on rings from the
first step down to the last, must not be clearly better. A swarm that fails the first stopped at its iteration limit, one that
fails the second has stalled; neither is "converged".
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.solvers.base import Problem, SolverResult, SolverStatus
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_RINGS = 24  # Distances at which a finished swarm is probed.
_SMALLEST_RING = 1e-12  # Of the largest ring, which is the first step: below that a cost in double precision says nothing.
_DIRECTIONS_PER_COORDINATE = 4  # Directions drawn for each coordinate, beside its own two.
# Share of the cost a probe must gain: L1 costs have edges along which a finished swarm is still 1e-4 above the minimum.
_CLEARLY_BETTER = 0.01


class Record:
    """Counts evaluations and keeps the best point ever apart from where the swarm stands.

    Parameters
    ----------
    problem : Problem
    rng : Generator, optional
        Default: one with the seed 0.

    Raises
    ------
    CalibrationError
        If the problem starts outside its bounds.
    """

    def __init__(self, problem: Problem, rng: np.random.Generator | None) -> None:
        check_start(problem)
        self.rng = rng or np.random.default_rng(0)
        self.evaluations = 0
        self.best_cost = float("inf")
        self.best = problem.start
        self.history: list[float] = []
        self._problem = problem

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return the cost of a population and count it."""
        self.evaluations += len(candidates)
        return self._problem.cost(candidates)

    def offer(self, candidate: FloatArray, cost: float) -> None:
        """Keep a point if it is the best ever."""
        if cost < self.best_cost:
            # A copy: the swarm moves its candidates in place.
            self.best_cost, self.best = cost, candidate.copy()

    def offer_best(self, members: FloatArray, costs: FloatArray) -> None:
        """Keep the best of a population if it is the best ever."""
        best = int(np.argmin(costs))
        self.offer(members[best], float(costs[best]))

    def end_of_iteration(self) -> None:
        """Write the history."""
        self.history.append(self.best_cost)

    def result(self, reach: float | FloatArray, message: Sentence, *, converged: bool) -> SolverResult:
        """Return the result, once a probe around the best point has had its say.

        Parameters
        ----------
        reach : float or ndarray, shape (n,)
            Radius of the largest ring, in the coordinates.
        message : Sentence
        converged : bool
            What the method itself thinks.
        """
        if not np.isfinite(self.best_cost):
            return self._result(SolverStatus.STALLED, sentence("population.no_point"))
        if not converged:
            return self._result(SolverStatus.ITERATION_LIMIT, message)
        cost, evaluations = lowest_nearby(self._problem, self.best, reach, self.rng)
        self.evaluations += evaluations
        # A cost of zero cannot be bettered.
        gain = 1 - cost / self.best_cost if self.best_cost > 0 else 0.0
        if gain > _CLEARLY_BETTER:
            return self._result(SolverStatus.STALLED, sentence("population.stalled", message=message, gain=gain))
        return self._result(SolverStatus.CONVERGED, message)

    def population_result(self, costs: FloatArray, tolerance: float, generations: int) -> SolverResult:
        """Return the result of a population that has these costs at its end."""
        lower, upper = self._problem.bounds
        spread = relative_spread(costs)
        agreed = spread <= tolerance
        key = "population.agreed" if agreed else "population.generation_limit"
        return self.result(upper - lower, sentence(key, spread=spread, generations=generations), converged=agreed)

    def _result(self, status: SolverStatus, message: Sentence) -> SolverResult:
        return SolverResult(
            x=self.best,
            cost=self.best_cost,
            status=status,
            message=message,
            evaluations=self.evaluations,
            history=np.array(self.history),
        )


def relative_spread(costs: FloatArray) -> float:
    """Return the spread of a population's costs relative to the lowest; 0 where all are 0, inf where some are infinite."""
    lowest, highest = float(costs.min()), float(costs.max())
    if highest == lowest:
        return 0.0 if np.isfinite(highest) else np.inf
    return (highest - lowest) / lowest if lowest > 0 else np.inf


def lowest_nearby(problem: Problem, x: FloatArray, reach: float | FloatArray, rng: np.random.Generator) -> tuple[float, int]:
    """Return the lowest cost of a cloud of points, and how many: along each coordinate and at random, on rings of all sizes."""
    n = len(x)
    random = rng.standard_normal((_DIRECTIONS_PER_COORDINATE * n, n))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    # Along the coordinates themselves too: an edge of an absolute cost often lies along one.
    directions = np.concatenate([np.eye(n), -np.eye(n), random]) * reach
    rings = np.geomspace(_SMALLEST_RING, 1.0, _RINGS)
    cloud = into_bounds(problem, (x + rings[:, None, None] * directions).reshape(-1, n))
    return float(np.min(problem.cost(cloud))), len(cloud)


def into_bounds(problem: Problem, candidates: FloatArray) -> FloatArray:
    """Return candidates moved to the nearest point within the bounds."""
    lower, upper = problem.bounds
    return np.clip(candidates, lower, upper)


def coordinate_name(problem: Problem, index: int) -> str:
    """Return the name of a coordinate where the problem has names, else its number."""
    names = getattr(problem, "names", None)
    return str(names[index]) if names else f"coordinate {index + 1}"


def check_start(problem: Problem) -> None:
    """Refuse bounds that exclude the start, and a start or bounds that are not numbers.

    Raises
    ------
    CalibrationError
        Naming the parameter.
    """
    start, (lower, upper) = problem.start, problem.bounds
    for index in np.flatnonzero(~((lower <= start) & (start <= upper))):
        values = {"start": float(start[index]), "lower": lower[index], "upper": upper[index]}
        reason = Reason.NOT_FINITE if np.isnan(list(values.values())).any() else Reason.BOUNDS
        raise CalibrationError(sentence("population.start", parameter=coordinate_name(problem, int(index)), **values), reason)


def check_finite_bounds(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return the bounds; refuse those within which no population can be drawn.

    Raises
    ------
    CalibrationError
        Naming the parameter.
    """
    check_start(problem)
    lower, upper = problem.bounds
    for index in np.flatnonzero(~np.isfinite(upper - lower)):
        name = coordinate_name(problem, int(index))
        endless = sentence("population.endless_bounds", parameter=name, lower=lower[index], upper=upper[index])
        raise CalibrationError(endless, Reason.BOUNDS)
    return lower, upper
