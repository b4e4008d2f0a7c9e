"""Dataclasses whose methods are made late, beside those of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from imufield.lean.dataclass import dataclass

Decorator = Callable[..., Callable[[type], Any]]


@dataclass(frozen=True, slots=True)
class Pickled:
    """One that stands in a module, where pickle finds it."""

    number: int
    names: list[str]


def pair(**options: bool) -> list[Any]:
    """Return one class by the standard library and one by us."""

    def made(decorate: Decorator) -> Any:
        @decorate(**options)
        class Value:
            """A value."""

            number: int
            word: str = "none"
            listed: list[int] = dataclasses.field(default_factory=list)
            hidden: float = dataclasses.field(default=1.0, repr=False, compare=False)

            @property
            def twice(self) -> int:
                return 2 * self.number

        return Value

    return [made(dataclasses.dataclass), made(dataclass)]


OPTIONS: list[dict[str, bool]] = [
    {},
    {"frozen": True},
    {"slots": True},
    {"frozen": True, "slots": True},
    {"frozen": True, "slots": True, "eq": False},
    {"frozen": True, "slots": True, "kw_only": True},
    {"slots": True, "kw_only": True},
]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_values_are_those_of_the_standard_library(options: dict[str, bool]) -> None:
    standard, late = pair(**options)
    ours, theirs = (inspect.signature(kind).parameters.values() for kind in (late, standard))
    assert [(each.name, each.kind, each.annotation) for each in ours] == [
        (each.name, each.kind, each.annotation) for each in theirs
    ]
    first = [kind(number=2, listed=[3]) for kind in (standard, late)]
    again = [kind(number=2, listed=[3], hidden=5.0) for kind in (standard, late)]
    other = [kind(number=3) for kind in (standard, late)]
    assert repr(first[1]) == repr(first[0])
    assert (first[1] == again[1], first[1] == other[1]) == (first[0] == again[0], first[0] == other[0])
    assert first[1] != first[0]
    assert other[1].listed is not late(number=3).listed
    assert dataclasses.replace(first[1], number=4).twice == 8
    assert dataclasses.asdict(first[1]) == dataclasses.asdict(first[0])
    assert dataclasses.astuple(copy.copy(first[1])) == dataclasses.astuple(first[0])
    assert late.__match_args__ == standard.__match_args__
    assert hasattr(first[1], "__dict__") == hasattr(first[0], "__dict__")


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize(
    "doing",
    [
        lambda value: setattr(value, "number", 5),
        lambda value: delattr(value, "number"),
        lambda value: hash(dataclasses.replace(value, listed=())),
        lambda value: type(value)(),
        lambda value: type(value)(number=1, wrong=2),
        lambda value: type(value)(1, "two"),
    ],
)
def test_what_is_refused_is_that_of_the_standard_library(options: dict[str, bool], doing: Callable[[Any], object]) -> None:
    def refusal(value: object) -> type[Exception] | None:
        try:
            doing(value)
        except (TypeError, AttributeError) as error:
            return type(error)
        return None

    standard, late = (kind(number=2) for kind in pair(**options))
    assert refusal(late) is refusal(standard)


def test_fields_come_from_bases_and_are_checked_after() -> None:
    @dataclass(frozen=True, slots=True, kw_only=True)
    class Base:
        number: int

        def __post_init__(self) -> None:
            if self.number < 0:
                raise ValueError("negative")

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Derived(Base):
        word: str = "none"

    assert repr(Derived(number=1)).endswith("Derived(number=1, word='none')")
    assert Base(number=1) != Derived(number=1)
    assert {Derived(number=1), Derived(number=1)} == {Derived(number=1)}
    with pytest.raises(ValueError, match="negative"):
        Derived(number=-1)


def test_one_without_docstring_has_its_name() -> None:
    @dataclass
    class Bare:
        number: int

    assert Bare.__doc__ == "Bare"


def test_one_that_holds_itself_has_a_representation() -> None:
    value = Pickled(1, [])
    value.names.append(value)  # type: ignore[arg-type]  # what nobody does
    assert repr(value) == "Pickled(number=1, names=[...])"


def test_frozen_ones_are_pickled() -> None:
    value = Pickled(3, ["a"])
    assert pickle.loads(pickle.dumps(value)) == value  # noqa: S301  (what was written here)
    assert copy.deepcopy(value) == value
