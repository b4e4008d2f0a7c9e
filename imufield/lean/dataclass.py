"""``dataclass`` of the standard library, whose methods are made when they are needed first.

The standard one compiles six functions for each class, which takes 0.5 ms (Python 3.11): of the 250 classes that ``solve``
imports, half of which it uses, that was half of the time of its imports. Here a class takes 0.05 ms. Its ``__init__`` is
compiled for its first instance; comparison, hash and representation, which are rare, go over the fields.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from reprlib import recursive_repr
from types import FunctionType, MethodType
from typing import TYPE_CHECKING, cast

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from dataclasses import dataclass

    from _typeshed import DataclassInstance
else:

    def dataclass(kind=None, /, *, frozen=False, eq=True, slots=False, kw_only=False):
        """Return the class as ``dataclasses.dataclass`` does, with the options that are used here."""
        options = {"frozen": frozen, "eq": eq, "slots": slots, "kw_only": kw_only}
        return partial(_made, **options) if kind is None else _made(kind, **options)


def _made(kind: type, *, frozen: bool, eq: bool, slots: bool, kw_only: bool) -> type:
    # In place of the signature that the standard library would compute for it.
    kind.__doc__ = kind.__doc__ or kind.__name__
    kind = dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, kw_only=kw_only)(kind)
    methods: dict[str, object] = {"__init__": _Init(kind, frozen=frozen), "__repr__": _repr}
    if eq:
        methods |= {"__eq__": _eq, "__hash__": _hash if frozen else None}
    if frozen:
        methods |= {"__setattr__": _refuse_set, "__delattr__": _refuse_delete}
        # What copies and pickles would set by name.
        methods |= {"__getstate__": _values, "__setstate__": _set_values} if slots else {}
    for name, method in methods.items():
        setattr(kind, name, method)
    return kind


class _Init:
    """Stands for the ``__init__`` of a class until that is asked for."""

    def __init__(self, kind: type, *, frozen: bool) -> None:
        self._kind, self._frozen = kind, frozen

    def __get__(self, instance: object, owner: type) -> Callable[..., None]:
        made = _compiled_init(self._kind, frozen=self._frozen)
        self._kind.__init__ = made  # type: ignore[misc]  # in place of this
        return made if instance is None else MethodType(made, instance)


def _compiled_init(kind: type[DataclassInstance], *, frozen: bool) -> Callable[..., None]:
    fields = dataclasses.fields(kind)
    known: dict[str, object] = {"_set": object.__setattr__, "_absent": dataclasses.MISSING}
    known |= {f"_default_{field.name}": field.default for field in fields}
    known |= {f"_make_{field.name}": field.default_factory for field in fields}
    typed = [_parameter(field) for field in fields if not field.kw_only]
    named = [_parameter(field) for field in fields if field.kw_only]
    lines = [f"def __init__({', '.join(['self', *typed, *(['*', *named] if named else [])])}):"]
    for field in fields:
        value = field.name
        if field.default_factory is not dataclasses.MISSING:
            value = f"_make_{value}() if {value} is _absent else {value}"
        lines.append(f"_set(self, {field.name!r}, {value})" if frozen else f"self.{field.name} = {value}")
    if hasattr(kind, "__post_init__"):
        lines.append("self.__post_init__()")
    exec("\n ".join(lines), known)  # noqa: S102  (names of fields, as the standard library does)
    init = cast("FunctionType", known["__init__"])
    init.__qualname__ = f"{kind.__qualname__}.__init__"
    init.__annotations__ = {**{field.name: field.type for field in fields}, "return": None}
    return init


def _parameter(field: dataclasses.Field[object]) -> str:
    if field.default is not dataclasses.MISSING:
        return f"{field.name}=_default_{field.name}"
    return field.name if field.default_factory is dataclasses.MISSING else f"{field.name}=_absent"


def _values(self: DataclassInstance) -> list[object]:
    return [getattr(self, field.name) for field in dataclasses.fields(self)]


def _set_values(self: DataclassInstance, values: list[object]) -> None:
    for field, value in zip(dataclasses.fields(self), values, strict=True):
        object.__setattr__(self, field.name, value)


def _compared(self: DataclassInstance) -> tuple[object, ...]:
    return tuple(getattr(self, field.name) for field in dataclasses.fields(self) if field.compare)


def _eq(self: DataclassInstance, other: object) -> bool:
    return _compared(self) == _compared(other) if type(other) is type(self) else NotImplemented


def _hash(self: DataclassInstance) -> int:
    return hash(_compared(self))


@recursive_repr()
def _repr(self: DataclassInstance) -> str:
    shown = (f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self) if field.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"


def _refuse_set(self: object, name: str, value: object) -> None:  # noqa: ARG001  (signature of __setattr__)
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_delete(self: object, name: str) -> None:  # noqa: ARG001  (signature of __delattr__)
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
