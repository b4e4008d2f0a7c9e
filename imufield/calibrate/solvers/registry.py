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


_PACKAGE = "imufield.calibrate.solvers"
_ALL = (
    Method(
        name="least-squares",
        title="Levenberg-Marquardt, weighted",
        module="least_squares",
        function="solve_least_squares",
        cost_name="weighted",
    ),
    Method(
        name="bsas",
        title="beetle swarm, all parameters at once in whitened coordinates",
        module="beetles",
        function="solve_bsas",
        cost_name="absolute",
    ),
    Method(
        name="bsas-staged",
        title="beetle swarm, four categories in turn, as printed",
        module="staged",
        function="solve_bsas_staged",
        cost_name="absolute",
    ),
    Method(name="bas", title="one beetle", module="beetles", function="solve_bas", cost_name="absolute"),
    Method(
        name="ide",
        title="differential evolution, combined strategy with adaptive factor",
        module="evolution",
        function="solve_ide",
        cost_name="squares",
    ),
    Method(
        name="de-combined",
        title="differential evolution, combined strategy",
        module="evolution",
        function="solve_de_combined",
        cost_name="squares",
    ),
    Method(
        name="de-rand-1",
        title="differential evolution, rand/1",
        module="evolution",
        function="solve_de_rand_1",
        cost_name="squares",
    ),
    Method(
        name="de-current-to-best-1",
        title="differential evolution, current-to-best/1",
        module="evolution",
        function="solve_de_current_to_best_1",
        cost_name="squares",
    ),
    Method(
        name="ga", title="genetic algorithm (pymoo, for comparison)", module="library", function="solve_ga", cost_name="squares"
    ),
    Method(
        name="pso", title="particle swarm (pymoo, for comparison)", module="library", function="solve_pso", cost_name="squares"
    ),
)
METHODS: Mapping[str, Method] = MappingProxyType({method.name: method for method in _ALL})


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
    module = importlib.import_module(f"{_PACKAGE}.{method.module}")
    return cast("Solver", getattr(module, method.function))
