"""Every solver by name, as ``methods.toml`` lists them. Listing imports no solver; loading imports one module."""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import cast

from imufield.calibrate.solvers.base import Solver
from imufield.calibrate.solvers.costs import CostName
from imufield.errors import UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """Where a solver is, and what it minimises."""

    name: str
    title: str
    module: str
    function: str
    cost_name: CostName


_LISTED = tomllib.loads(Path(__file__).with_name("methods.toml").read_text(encoding="utf-8"))
METHODS: Mapping[str, Method] = MappingProxyType({name: Method(name=name, **row) for name, row in _LISTED.items()})


def find_method(name: str) -> Method:
    """Return a method by name.

    Raises
    ------
    UsageError
        If there is none.
    """
    if name not in METHODS:
        raise UsageError(sentence("registry.unknown", method=name, known=list(METHODS)))
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
