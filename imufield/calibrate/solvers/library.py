"""Genetic algorithm and particle swarm, for comparison ([1]_ Table 5), from pymoo (the ``study`` extra)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from imufield.calibrate.solvers.base import Callback, Problem, SolverResult, SolverStatus
from imufield.calibrate.solvers.population import Record, check_finite_bounds
from imufield.errors import Reason, UsageError
from imufield.samples import FloatArray

if TYPE_CHECKING:
    from types import ModuleType


@dataclass(frozen=True, slots=True)
class LibrarySettings:
    """Population and generations, the same as the paper gives to all methods; the rest is pymoo's default."""

    population: int = 60
    generations: int = 1200
    tolerance: float = 1e-6
    """Relative spread of the population's costs at which it counts as converged."""


def solve_ga(
    problem: Problem,
    *,
    rng: np.random.Generator | None = None,
    callback: Callback | None = None,
    settings: LibrarySettings | None = None,
) -> SolverResult:
    """Minimise with pymoo's genetic algorithm (simulated binary crossover, polynomial mutation)."""
    settings = settings or LibrarySettings()
    algorithm = _pymoo("pymoo.algorithms.soo.nonconvex.ga").GA(pop_size=settings.population)
    return _run(algorithm, problem, rng, callback, settings=settings)


def solve_pso(
    problem: Problem,
    *,
    rng: np.random.Generator | None = None,
    callback: Callback | None = None,
    settings: LibrarySettings | None = None,
) -> SolverResult:
    """Minimise with pymoo's particle swarm (adaptive weights)."""
    settings = settings or LibrarySettings()
    algorithm = _pymoo("pymoo.algorithms.soo.nonconvex.pso").PSO(pop_size=settings.population)
    return _run(algorithm, problem, rng, callback, settings=settings)


def _pymoo(module: str) -> ModuleType:
    import importlib

    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the methods ga and pso need the package pymoo, which is not installed ({error}); install imufield[study]",
            Reason.MISSING_PACKAGE,
            package="pymoo",
        ) from error


def _run(
    algorithm: Any, problem: Problem, rng: np.random.Generator | None, callback: Callback | None, *, settings: LibrarySettings
) -> SolverResult:
    check_finite_bounds(problem)
    rng = rng or np.random.default_rng(0)
    record = Record(problem, callback)
    lower, upper = problem.bounds

    def evaluate(x: FloatArray, out: dict[str, FloatArray]) -> None:
        costs = record.cost(x)
        best = int(np.argmin(costs))
        record.offer(x[best], float(costs[best]))
        out["F"] = np.where(np.isfinite(costs), costs, np.finfo(float).max)[:, None]

    base = _pymoo("pymoo.core.problem").Problem
    adapted = type("Adapted", (base,), {"_evaluate": lambda _self, x, out, *_args, **_kwargs: evaluate(x, out)})
    algorithm.setup(
        adapted(n_var=len(lower), n_obj=1, xl=lower, xu=upper),
        termination=("n_gen", settings.generations),
        seed=int(rng.integers(2**31)),
        verbose=False,
    )
    while algorithm.has_next():
        algorithm.next()
        if record.end_of_iteration():
            return record.stopped()
    costs = np.asarray(algorithm.pop.get("F"), dtype=np.float64).ravel()
    spread = float((costs.max() - costs.min()) / costs.min()) if costs.min() > 0 else float("inf")
    if spread <= settings.tolerance:
        return record.result(SolverStatus.CONVERGED, f"the costs of the population agree to {spread:.1e}", upper - lower, rng)
    message = f"not converged within {settings.generations} generations: the costs still spread by {spread:.1e} of the lowest"
    return record.result(SolverStatus.ITERATION_LIMIT, message, upper - lower, rng)
