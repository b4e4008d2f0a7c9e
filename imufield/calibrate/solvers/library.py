"""Genetic algorithm and particle swarm, for comparison ([1]_ Table 5), from pymoo (the ``study`` extra)."""

from __future__ import annotations

from functools import partial
from types import ModuleType

import numpy as np

from imufield.calibrate.solvers.base import Problem, SolverResult
from imufield.calibrate.solvers.population import Record, check_finite_bounds
from imufield.dataclass import dataclass
from imufield.errors import load_package
from imufield.samples import FloatArray


@dataclass(frozen=True, slots=True)
class LibrarySettings:
    """Population and generations, the same as the paper gives to all methods; the rest is pymoo's default."""

    population: int = 60
    generations: int = 1200
    tolerance: float = 1e-6
    """Relative spread of the population's costs at which it counts as converged."""


LIBRARY_SETTINGS = LibrarySettings()


def _pymoo(module: str) -> ModuleType:
    return load_package(module, "each of the methods ga and pso", "study")


def solve_with_pymoo(
    problem: Problem,
    *,
    name: str,
    rng: np.random.Generator | None = None,
    settings: LibrarySettings = LIBRARY_SETTINGS,
) -> SolverResult:
    """Minimise with a class of pymoo's single-objective algorithms."""
    algorithm = getattr(_pymoo(f"pymoo.algorithms.soo.nonconvex.{name.lower()}"), name)(pop_size=settings.population)
    lower, upper = check_finite_bounds(problem)
    record = Record(problem, rng)

    def evaluate(x: FloatArray, out: dict[str, FloatArray]) -> None:
        costs = record.cost(x)
        record.offer_best(x, costs)
        # pymoo takes no infinite cost.
        out["F"] = np.where(np.isfinite(costs), costs, np.finfo(float).max)[:, None]

    base = _pymoo("pymoo.core.problem").Problem
    adapted = type("Adapted", (base,), {"_evaluate": lambda _self, x, out, *_args, **_kwargs: evaluate(x, out)})
    algorithm.setup(
        adapted(n_var=len(lower), n_obj=1, xl=lower, xu=upper),
        termination=("n_gen", settings.generations),
        seed=int(record.rng.integers(2**31)),  # pymoo has a generator of its own
        verbose=False,
    )
    while algorithm.has_next():
        algorithm.next()
        record.end_of_iteration()
    costs = np.asarray(algorithm.pop.get("F"), dtype=np.float64).ravel()
    return record.population_result(costs, settings.tolerance, settings.generations)


solve_ga = partial(solve_with_pymoo, name="GA")
"""pymoo's genetic algorithm (simulated binary crossover, polynomial mutation)."""
solve_pso = partial(solve_with_pymoo, name="PSO")
"""pymoo's particle swarm (adaptive weights)."""
