"""Every solver by name. Listing imports nothing; loading imports one module."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import cast

from imufield.calibrate.solvers.base import Solver
from imufield.calibrate.solvers.costs import CostName
from imufield.errors import Reason, UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """Where a solver is, and what it minimises."""

    name: str
    title: str
    module: str
    function: str
    cost_name: CostName
    """The cost its paper gives it: eq. 13 for beetles, eq. 7 for evolution, chi squared for least squares."""


# Name, title, module, function and cost of each method.
_TABLE: tuple[tuple[str, str, str, str, CostName], ...] = (
    ("least-squares", "Levenberg-Marquardt, weighted", "least_squares", "solve_least_squares", "weighted"),
    ("bsas", "beetle swarm, all parameters at once in whitened coordinates", "beetles", "solve_bsas", "absolute"),
    ("bsas-staged", "beetle swarm, four categories in turn, as printed", "staged", "solve_bsas_staged", "absolute"),
    ("bas", "one beetle", "beetles", "solve_bas", "absolute"),
    ("ide", "differential evolution, combined strategy with adaptive factor", "evolution", "solve_ide", "squares"),
    ("de-combined", "differential evolution, combined strategy", "evolution", "solve_de_combined", "squares"),
    ("de-rand-1", "differential evolution, rand/1", "evolution", "solve_de_rand_1", "squares"),
    ("de-current-to-best-1", "differential evolution, current-to-best/1", "evolution", "solve_de_current_to_best_1", "squares"),
    ("ga", "genetic algorithm (pymoo, for comparison)", "library", "solve_ga", "squares"),
    ("pso", "particle swarm (pymoo, for comparison)", "library", "solve_pso", "squares"),
)
METHODS: Mapping[str, Method] = MappingProxyType(
    {
        name: Method(name=name, title=title, module=module, function=function, cost_name=cost_name)
        for name, title, module, function, cost_name in _TABLE
    }
)


def find_method(name: str) -> Method:
    """Return a method by name.

    Raises
    ------
    UsageError
        If there is none.
    """
    if name not in METHODS:
        raise UsageError(f"there is no method {name!r}; use one of {', '.join(METHODS)}", Reason.USAGE, method=name)
    return METHODS[name]


def load_solver(name: str) -> Solver:
    """Return the function behind a name.

    Raises
    ------
    UsageError
        If there is no such method.
    """
    method = find_method(name)
    module = importlib.import_module(f"{__package__}.{method.module}")
    return cast("Solver", getattr(module, method.function))
