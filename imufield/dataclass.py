"""``dataclass`` as that of the standard library, except that ``__init__`` is compiled once a class has had a few objects.

A short command imports 250 dataclasses, makes objects of half of them, and of most of these no more than three. The standard
library compiles five or six methods of each at import, a fifth of the time of a short ``solve``. Here one is compiled, once the
class has had a few; the others serve every class.

Other differences: what a type checker finds (a required field behind a default) is told by the ninth object, or to who looks at
``__init__``, not at import; there is no ``InitVar``. A class derived from a frozen one of these takes this decorator, too, as
what they are made with does not say that they are frozen; all others may take either.
"""

from __future__ import annotations

import dataclasses
from dataclasses import KW_ONLY, MISSING, Field, FrozenInstanceError, asdict, field, fields, is_dataclass, replace
from functools import cache, partial
from inspect import get_annotations
from operator import attrgetter
from types import FunctionType
from typing import TYPE_CHECKING, cast

__all__ = ["KW_ONLY", "MISSING", "Field", "asdict", "dataclass", "field", "fields", "is_dataclass", "replace"]

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import dataclass as dataclass  # noqa: PLC0414  (type checkers know that one alone)

    from _typeshed import DataclassInstance
else:

    def dataclass(cls=None, /, *, frozen=False, slots=False, kw_only=False, eq=True):
        """Decorate a class as ``dataclasses.dataclass`` does, with those of its options that are used here."""

        def decorate(cls):
            made = _with_fields(cls, dataclasses.dataclass(init=False, repr=False, eq=False, slots=slots, kw_only=kw_only))
            methods = {"__init__": _LazyInit(made, frozen), "__repr__": _repr}
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


def _with_fields(cls: type, decorate: Callable[[type], type]) -> type:
    """Decorate with annotations replaced by None: the standard library parses each string for ClassVar and KW_ONLY."""
    told = get_annotations(cls)
    if not all(isinstance(each, str) and "ClassVar" not in each and "KW_ONLY" not in each for each in told.values()):
        return decorate(cls)
    cls.__annotations__ = dict.fromkeys(told)
    made = decorate(cls)
    made.__annotations__ = told
    for each in fields(made):
        each.type = told.get(each.name, each.type)
    return made


_FEW = 8  # Objects that are filled field by field: some microseconds more each; compiling takes a hundred.


class _LazyInit:
    """Stands for ``__init__`` of the first few objects, or until somebody looks for it."""

    def __init__(self, cls: type[DataclassInstance], frozen: bool) -> None:
        self.cls, self.frozen, self.left = cls, frozen, _FEW

    def __get__(self, instance: DataclassInstance | None, owner: type) -> object:
        self.left -= 1
        if instance is not None and self.left >= 0:
            return partial(self._fill, instance)
        init = _compile_init(self.cls, self.frozen)
        self.cls.__init__ = init  # type: ignore[method-assign]  # the very place that this object stands in
        return init if instance is None else init.__get__(instance, owner)

    def _fill(self, instance: DataclassInstance, /, *given: object, **named: object) -> None:
        left, rest, lacks = iter(given), named.copy(), False
        put = object.__setattr__ if self.frozen else setattr
        for each in fields(self.cls):
            value: object = next(left, MISSING) if each.init and not each.kw_only else MISSING
            if value is MISSING and each.init:
                value = rest.pop(each.name, MISSING)
            if value is MISSING:
                value = each.default if each.default_factory is MISSING else each.default_factory()
            if value is not MISSING:
                put(instance, each.name, value)
            lacks |= value is MISSING and each.init
        if lacks or rest or next(left, MISSING) is not MISSING:
            # Python says what is wrong.
            _compile_init(self.cls, self.frozen)(instance, *given, **named)
        elif (finish := getattr(instance, "__post_init__", None)) is not None:
            finish()


def _compile_init(cls: type[DataclassInstance], frozen: bool) -> FunctionType:
    names: dict[str, object] = {"_set": object.__setattr__, "_missing": MISSING}
    ordered, keywords, lines = ["self"], ["*"], list[str]()
    for each in fields(cls):
        name = value = each.name
        default = ""
        if each.default_factory is not MISSING:
            names[f"_make_{name}"] = each.default_factory
            default, value = " = _missing", f"_make_{name}() if {name} is _missing else {name}"
        elif each.default is not MISSING:
            names[f"_default_{name}"] = each.default
            default = f" = _default_{name}"
        if each.init:
            (keywords if each.kw_only else ordered).append(name + default)
        elif default:
            # No parameter: it begins with its default.
            lines.append(f"{name}{default}")
        else:
            continue
        lines.append(f"_set(self, {name!r}, {value})" if frozen else f"self.{name} = {value}")
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    parameters = ", ".join(ordered + (keywords if len(keywords) > 1 else []))
    text = f"def __init__({parameters}):\n " + "\n ".join(lines or ["pass"])
    exec(text, names)  # noqa: S102  (as the standard library makes it)
    init = cast("FunctionType", names["__init__"])
    init.__qualname__, init.__module__ = f"{cls.__qualname__}.__init__", cls.__module__
    return init


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
