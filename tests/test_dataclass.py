"""``dataclass`` beside that of the standard library: the same answers of objects that differ in nothing else."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
import threading
from collections.abc import Callable
from dataclasses import FrozenInstanceError, asdict, field, fields, is_dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from imufield.dataclass import dataclass


def pair(**options: Any) -> list[type[Any]]:
    """Return the same class, decorated by each."""
    made = []
    for decorator in (dataclass, dataclasses.dataclass):

        class Point:
            kind: ClassVar[str] = "point"
            x: float
            y: float = 2.0
            names: list[str] = field(default_factory=list)
            hidden: int = field(default=0, repr=False, compare=False)
            count: int = field(default=7, init=False)

            def __post_init__(self) -> None:
                object.__setattr__(self, "count", self.count + len(self.names))

        Point.__qualname__ = "Point"
        made.append(decorator(**options)(Point))
    return made


OPTIONS = [
    {},
    {"frozen": True},
    {"frozen": True, "slots": True},
    {"frozen": True, "slots": True, "kw_only": True},
    {"slots": True, "eq": False},
]
ASKED: dict[str, Callable[[type[Any]], object]] = {
    "text": lambda kind: repr(kind(x=1.0, names=["a"])),
    "values": lambda kind: asdict(kind(x=1.0, y=3.0, hidden=4)),
    "fields": lambda kind: [(each.name, each.type, each.init, each.kw_only) for each in fields(kind)],
    "changed": lambda kind: repr(replace(kind(x=1.0), y=5.0)),
    "refused": lambda kind: [refusal(kind), refusal(lambda: kind(x=1.0, count=3)), refusal(lambda: kind(x=1.0, z=3))],
    "by place": lambda kind: refusal(lambda: kind(1.0, 2.0)),
    "given twice": lambda kind: [refusal(lambda: kind(1.0, x=2.0)), refusal(lambda: kind(1.0, 2.0, [], 0, 7))],
    "equal": lambda kind: [kind(x=1.0) == kind(x=1.0, hidden=9), kind(x=1.0) == kind(x=2.0), kind(x=1.0) == (1.0,)],
    "own list": lambda kind: kind(x=1.0).names is kind(x=1.0).names,
    "hash": lambda kind: refusal(lambda: hash(kind(x=1.0))),
    "set": lambda kind: refusal(lambda: setattr(kind(x=1.0), "x", 3.0)),
    "deleted": lambda kind: refusal(lambda: delattr(kind(x=1.0), "x")),
    # Refused by both, where that of Python 3.11 stumbles over its own slots.
    "new name": lambda kind: refusal(lambda: setattr(kind(x=1.0), "new", 3.0)) is None,
    "signature": lambda kind: list(inspect.signature(kind).parameters),
    "matched": lambda kind: kind.__match_args__,
    "room": lambda kind: hasattr(kind(x=1.0), "__dict__"),
}


def refusal(act: Callable[[], object]) -> type[Exception] | None:
    try:
        act()
    except (TypeError, AttributeError, ValueError) as error:
        return type(error)
    return None


@pytest.mark.parametrize("options", OPTIONS, ids=repr)
@pytest.mark.parametrize("asked", ASKED)
@pytest.mark.parametrize("made", [0, 20], ids=["of the first objects", "of one among many"])
def test_both_answer_the_same(options: dict[str, bool], asked: str, made: int) -> None:
    ours, standard = pair(**options)
    assert len({repr(ours(x=1.0)) for _ in range(made)}) == min(made, 1)
    assert ASKED[asked](ours) == ASKED[asked](standard)


def lonely(decorator: Any) -> type[Any]:
    class Lonely:
        value: object

    return decorator(Lonely)


@pytest.mark.parametrize(
    "answer",
    [
        # An object that is not equal to itself.
        lambda kind: kind(value := float("nan")) == kind(value),
        lambda kind: kind(values := np.arange(3)) == kind(values),
        lambda kind: refusal(lambda: kind(np.arange(3)) == kind(np.arange(3))),
        lambda kind: kind((1, 2)) == kind((1, 2)),
    ],
)
def test_one_compared_field_is_compared_as_several_are(answer: Callable[[type[Any]], object]) -> None:
    assert answer(lonely(dataclass)) == answer(lonely(dataclasses.dataclass))


def test_an_equality_of_its_own_keeps_the_hash_of_the_fields() -> None:
    def made(decorator: Any) -> type[Any]:
        @decorator(frozen=True)
        class Own:  # noqa: PLW1641  (what is asked)
            value: int

            def __eq__(self, other: object) -> bool:
                return True

        return Own

    for kind in map(made, (dataclass, dataclasses.dataclass)):
        assert kind(1) == kind(2)
        assert hash(kind(1)) == hash((1,))


def test_a_hash_hangs_on_the_compared_fields_alone() -> None:
    @dataclass(frozen=True)
    class Key:
        name: str
        note: str = field(default="", compare=False)

    assert len({Key("a"), Key("a", note="b"), Key("c")}) == 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """Of a module, where pickle finds it."""

    size: int
    parts: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SentOn(Sent):
    """With a field more than its base."""

    goal: str = "here"


@pytest.mark.parametrize("sent", [Sent(size=3), SentOn(size=3, parts=(1, 2), goal="there")])
@pytest.mark.parametrize("carry", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])  # noqa: S301
def test_what_is_frozen_can_be_sent(sent: Sent, carry: Callable[[Sent], Sent]) -> None:
    assert carry(sent) == sent
    assert type(carry(sent)) is type(sent)
    assert is_dataclass(sent)


def test_a_base_and_what_is_made_of_it_are_never_equal() -> None:
    assert Sent(size=3) != SentOn(size=3)
    with pytest.raises(FrozenInstanceError):
        SentOn(size=3).goal = "there"  # type: ignore[misc]  # what is asked


def test_a_method_of_its_own_stays() -> None:
    @dataclass(frozen=True)
    class Told:
        size: int

        def __repr__(self) -> str:
            return "told"

        def __hash__(self) -> int:
            return 5

    assert (repr(Told(3)), hash(Told(3))) == ("told", 5)


def test_a_first_object_in_each_of_many_threads() -> None:
    @dataclass(frozen=True, slots=True)
    class Once:
        size: int

    made: list[Once] = []
    threads = [threading.Thread(target=lambda: made.append(Once(3))) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made == [Once(3)] * 20


def test_super_finds_the_initialiser_of_a_base() -> None:
    @dataclass
    class Base:
        size: int

    class Derived(Base):
        def __init__(self) -> None:
            super().__init__(4)

    assert Derived().size == 4


@pytest.mark.parametrize("slots", [False, True])
def test_fields_have_the_annotations_of_their_classes(*, slots: bool) -> None:
    found = []
    for decorator in (dataclass, dataclasses.dataclass):

        class Base:
            x: int

        class Derived(decorator(slots=slots)(Base)):  # type: ignore[misc]  # a base that is made here
            y: list[str] = field(default_factory=list)

        made = decorator(slots=slots)(Derived)
        found.append(([(each.name, each.type) for each in fields(made)], made.__annotations__))
    assert found[0] == found[1] == ([("x", "int"), ("y", "list[str]")], {"y": "list[str]"})
