"""Every solver by name, as ``methods.toml`` lists them. Listing imports no solver; loading imports one module.

The settings of a solver have the symbols of its paper; for some of them a word does as well (``_SYMBOLS``).
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, cast

import tomli

from imufield.calibrate.solvers.base import Solver
from imufield.calibrate.solvers.norm_problem import CostName
from imufield.dataclass import dataclass, fields, replace
from imufield.errors import UsageError
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

sentence = Sentences(__package__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """Where a solver is, and what it minimises."""

    name: str
    module: str
    function: str
    cost_name: CostName
    settings: str = ""
    """The name of its settings in the module; empty where it has none."""


_LISTED = tomli.loads(Path(__file__).with_name("methods.toml").read_text(encoding="utf-8"))
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


# Words for the symbols of the papers; IDE's factor begins at its largest.
_SYMBOLS = {
    "beetles": ("m",),
    "iterations": ("k_max",),
    "population": ("NP",),
    "generations": ("EG",),
    "factor": ("F", "F_max"),
    "crossover": ("CR",),
}
# A share is a chance, or what a step shrinks to: at 1 a step never shrinks, and a chance has its upper limit there.
_SHARES = ("p_pos", "p_st", "CR")
_SHRINKING = ("c_s", "c_d")
_MOST = 1_000_000  # Members, beetles or rounds: a slip of the keyboard must not ask for more memory than there is.


def load_solver(name: str, settings: Mapping[str, str] | None = None) -> Solver:
    """Return the function behind a name, with settings as they are typed (``{"m": "20"}``) in place of its own.

    Raises
    ------
    UsageError
        If there is no such method or setting, or a value makes no sense.
    """
    method = find_method(name)
    module = importlib.import_module(f"{__package__}.{method.module}")
    solver = cast("Solver", getattr(module, method.function))
    if not settings:
        return solver
    if not method.settings:
        raise UsageError(sentence("registry.no_settings", method=name, settings=list(settings)))
    chosen = _changed(name, getattr(module, method.settings), settings)
    return cast("Solver", partial(cast("Callable[..., object]", solver), settings=chosen))


def _changed(method: str, own: DataclassInstance, settings: Mapping[str, str]) -> DataclassInstance:
    """Return a solver's settings with the typed ones in their place."""
    known = {field.name: getattr(own, field.name) for field in fields(own)}
    values: dict[str, float] = {}
    for name, text in settings.items():
        symbol = next((symbol for symbol in (name, *_SYMBOLS.get(name, ())) if symbol in known), None)
        if symbol is None:
            raise UsageError(sentence("registry.no_setting", method=method, setting=name, known=list(known)))
        whole = isinstance(known[symbol], int)
        lowest = 1 if whole else 0.0
        highest = _MOST if whole else 1.0 if symbol in (*_SHARES, *_SHRINKING) else math.inf
        try:
            value = int(text) if whole else float(text)
        except ValueError:
            value = math.nan
        if not lowest <= value <= highest or math.isinf(value) or (symbol in _SHRINKING and value == highest):
            kind = "whole number" if whole else "number"
            limits = {"lowest": lowest, "highest": highest}
            raise UsageError(sentence("registry.setting", setting=name, value=text, kind=kind, **limits))
        values[symbol] = value
    return replace(own, **values)
