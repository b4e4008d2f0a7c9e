"""``dataclass`` as that of the standard library, except that no method is compiled.

A short command imports 250 dataclasses, and makes a few objects of every other one. The standard library compiles five or six
methods of each at import, a fifth of the time of a short ``solve``. Here methods look the fields up; an object takes 1 us more.

Other differences: what a type checker finds (a required field behind a default) is told at the first object, not at import;
there is no ``InitVar``. A class derived from a frozen one of these takes this decorator, too, as what they are made with does
not say that they are frozen; all others may take either.
"""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import KW_ONLY, MISSING, Field, FrozenInstanceError, asdict, field, fields, is_dataclass, replace
from functools import cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any

__all__ = ["KW_ONLY", "MISSING", "Field", "asdict", "dataclass", "field", "fields", "is_dataclass", "replace"]

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import dataclass as dataclass  # noqa: PLC0414  (type checkers know that one alone)

    from _typeshed import DataclassInstance
else:

    def dataclass(cls=None, /, *, frozen=False, slots=False, kw_only=False, eq=True):
        """Decorate a class as ``dataclasses.dataclass`` does, with those of its options that are used here."""

        def decorate(cls):
            made = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, kw_only=kw_only)(cls)
            methods = {"__init__": _make_init(made, frozen), "__repr__": _repr, "__signature__": _Signature()}
            if eq:
                methods |= {"__eq__": _eq, "__hash__": _hash if frozen else None}
            if frozen:
                methods |= {"__setattr__": _refuse, "__delattr__": _refuse}
            if frozen and slots:
                methods |= {"__getstate__": _get_state, "__setstate__": _set_state}
            for name, method in methods.items():
                # What the class states itself stays; beside an ``__eq__`` of its own, Python puts a hash of None.
                if cls.__dict__.get(name) is None:
                    setattr(made, name, method)
            return made

        return decorate if cls is None else decorate(cls)


def _make_init(cls: type[DataclassInstance], frozen: bool) -> Callable[..., None]:
    put = object.__setattr__ if frozen else setattr

    def __init__(self: object, /, *values: object, **named: object) -> None:  # noqa: N807  (that is what it becomes)
        ordered, every = _parameters(cls)
        if len(values) > len(ordered) or not named.keys().isdisjoint(ordered[: len(values)]):
            raise TypeError(f"{cls.__qualname__} takes {len(ordered)} values by place, and each of them once")
        named |= zip(ordered, values, strict=False)
        for name, is_given, default, make in every:
            if is_given and name in named:
                put(self, name, named.pop(name))
            elif make is not MISSING:
                put(self, name, make())
            elif default is not MISSING:
                put(self, name, default)
            elif is_given:
                raise TypeError(f"{cls.__qualname__} lacks {name}")
        if named:
            raise TypeError(f"{cls.__qualname__} knows no {', '.join(named)}")
        if hasattr(self, "__post_init__"):
            self.__post_init__()

    __init__.__qualname__, __init__.__module__ = f"{cls.__qualname__}.__init__", cls.__module__
    return __init__


@cache
def _parameters(cls: type[DataclassInstance]) -> tuple[list[str], list[tuple[str, bool, Any, Any]]]:
    """Return the names given by place, and of every field its name, whether it can be given, default and factory."""
    ordered = [each.name for each in fields(cls) if each.init and not each.kw_only]
    return ordered, [(each.name, each.init, each.default, each.default_factory) for each in fields(cls)]


class _Signature:
    """What ``inspect.signature`` and ``help`` ask a class for."""

    def __get__(self, instance: object, owner: type[DataclassInstance]) -> inspect.Signature:
        found = inspect.Parameter
        given = sorted((each for each in fields(owner) if each.init), key=attrgetter("kw_only"))
        return inspect.Signature(
            [
                found(
                    each.name,
                    found.KEYWORD_ONLY if each.kw_only else found.POSITIONAL_OR_KEYWORD,
                    default=found.empty if each.default is each.default_factory is MISSING else each.default,
                    annotation=each.type,
                )
                for each in given
            ]
        )


def _repr(self: DataclassInstance) -> str:
    shown = ", ".join(f"{each.name}={getattr(self, each.name)!r}" for each in fields(self) if each.repr)
    return f"{type(self).__qualname__}({shown})"


@cache
def _compared(cls: type[DataclassInstance]) -> Callable[[object], tuple[object, ...]]:
    """Return what gives the compared values of an object, always as a tuple: it takes an object as equal to itself."""
    names = [each.name for each in fields(cls) if each.compare]
    return attrgetter(*names) if len(names) > 1 else lambda self: tuple(getattr(self, name) for name in names)


def _eq(self: DataclassInstance, other: object) -> bool:
    return _compared(type(self))(self) == _compared(type(self))(other) if type(other) is type(self) else NotImplemented


def _hash(self: DataclassInstance) -> int:
    return hash(_compared(type(self))(self))


def _refuse(self: object, name: str, *_value: object) -> None:
    raise FrozenInstanceError(f"{type(self).__name__}.{name} cannot be changed")


def _get_state(self: DataclassInstance) -> list[object]:
    return [getattr(self, each.name) for each in fields(self)]


def _set_state(self: DataclassInstance, state: list[object]) -> None:
    for each, value in zip(fields(self), state, strict=True):
        object.__setattr__(self, each.name, value)
