"""``dataclass`` as that of the standard library, but that it makes ``__init__`` when the first object is made.

A short command imports 250 dataclasses and makes objects of a third of them. The standard library compiles five methods of each
at import, which took a third of the time of ``solve``. Here four of them are shared, and the fifth waits until it is used.
"""

from __future__ import annotations

import dataclasses
from dataclasses import KW_ONLY, MISSING, Field, FrozenInstanceError, asdict, field, fields, is_dataclass, replace
from functools import cache
from operator import attrgetter
from types import FunctionType
from typing import TYPE_CHECKING, cast

__all__ = ["KW_ONLY", "MISSING", "Field", "asdict", "dataclass", "field", "fields", "is_dataclass", "replace"]

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import dataclass as dataclass  # noqa: PLC0414  (what checks types knows that one alone)

    from _typeshed import DataclassInstance
else:

    def dataclass(kind=None, /, *, frozen=False, slots=False, kw_only=False, eq=True):
        """Decorate a class as ``dataclasses.dataclass`` does, with those of its options that are used here."""

        def decorated(kind):
            made = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, kw_only=kw_only)(kind)
            given = {"__init__": _Initialiser(made, frozen), "__repr__": _text}
            if eq:
                given |= {"__eq__": _is_equal, "__hash__": _hash if frozen else None}
            if frozen:
                given |= {"__setattr__": _refuse, "__delattr__": _refuse}
            if frozen and slots:
                given |= {"__getstate__": _state, "__setstate__": _set_state}
            for name, method in given.items():
                # What the class states itself stays.
                if name not in kind.__dict__:
                    setattr(made, name, method)
            return made

        return decorated if kind is None else decorated(kind)


class _Initialiser:
    """Stands for ``__init__`` until somebody looks for it."""

    def __init__(self, kind: type[DataclassInstance], frozen: bool) -> None:
        self.kind, self.frozen = kind, frozen

    def __get__(self, instance: object, owner: type) -> object:
        method = _initialiser(self.kind, self.frozen)
        self.kind.__init__ = method  # type: ignore[method-assign]  # the very place that this object stands in
        return method if instance is None else method.__get__(instance, owner)


def _initialiser(kind: type[DataclassInstance], frozen: bool) -> FunctionType:
    names: dict[str, object] = {"_set": object.__setattr__, "_missing": MISSING}
    ordered, keywords, lines = ["self"], ["*"], list[str]()
    for entry in fields(kind):
        name = value = entry.name
        default = ""
        if entry.default_factory is not MISSING:
            names[f"_make_{name}"] = entry.default_factory
            default, made = " = _missing", f"_make_{name}()"
            value = f"{made} if {name} is _missing else {name}" if entry.init else made
        elif entry.default is not MISSING:
            names[f"_default_{name}"] = entry.default
            default = f" = _default_{name}"
            value = name if entry.init else f"_default_{name}"
        if entry.init:
            (keywords if entry.kw_only else ordered).append(name + default)
        lines.append(f"_set(self, {name!r}, {value})" if frozen else f"self.{name} = {value}")
    if hasattr(kind, "__post_init__"):
        lines.append("self.__post_init__()")
    taken = ", ".join(ordered + (keywords if len(keywords) > 1 else []))
    exec(f"def __init__({taken}):\n " + "\n ".join(lines or ["pass"]), names)  # noqa: S102  (as the standard library makes it)
    method = cast("FunctionType", names["__init__"])
    method.__qualname__, method.__module__ = f"{kind.__qualname__}.__init__", kind.__module__
    return method


def _text(self: DataclassInstance) -> str:
    shown = ", ".join(f"{entry.name}={getattr(self, entry.name)!r}" for entry in fields(self) if entry.repr)
    return f"{type(self).__qualname__}({shown})"


@cache
def _compared(kind: type[DataclassInstance]) -> Callable[[object], object]:
    names = [entry.name for entry in fields(kind) if entry.compare]
    return attrgetter(*names) if names else lambda _: ()


def _is_equal(self: DataclassInstance, other: object) -> bool:
    return _compared(type(self))(self) == _compared(type(self))(other) if type(other) is type(self) else NotImplemented


def _hash(self: DataclassInstance) -> int:
    return hash(_compared(type(self))(self))


def _refuse(self: object, name: str, *_value: object) -> None:
    raise FrozenInstanceError(f"{type(self).__name__}.{name} cannot be changed")


def _state(self: DataclassInstance) -> list[object]:
    return [getattr(self, entry.name) for entry in fields(self)]


def _set_state(self: DataclassInstance, state: list[object]) -> None:
    for entry, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, entry.name, value)
