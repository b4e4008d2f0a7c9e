from typing import Any

import numpy as np
import pytest

from imufield.guide import refusals
from imufield.guide.cross_checks.sides import ENOUGH_SIDES, SidesCheck
from imufield.guide.events import RefusalCode, Rejected
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.guide.view.plain import line
from tests.guide.guided import is_said_by, key_of

pytestmark = pytest.mark.numerical

ASKED = np.array([[1.0, 0, 0], [0, 0.7071, 0.7071], [0, -1, 0], [0.5774, -0.5774, 0.5774], [0, 0, -1]])


def said(shown: Any) -> Any:
    check = SidesCheck()
    return [show(check, asked, side) for asked, side in zip(ASKED, shown, strict=True)]


def show(check: SidesCheck, asked: Any, side: Any) -> Any:
    """Turn the unit far away, and to a side."""
    check.follow(np.cross(side, [0.3, 0.5, 0.81]))
    return check.note(asked, side)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (-np.eye(3), "x = -x, y = -y, z = -z"),
        (np.diag([1.0, -1, -1]), "x = +x, y = -y, z = -z"),
        (np.eye(3)[[1, 2, 0]], "x = +z, y = +x, z = +y"),
    ],
)
def test_wrong_axes_are_named_after_four_sides(wrong: Any, words: str) -> None:
    asked = ASKED[1:] if wrong[0, 0] == 1 else ASKED
    check = SidesCheck()
    found = [show(check, one, wrong @ one) for one in asked]
    assert found[: ENOUGH_SIDES - 1] == [None] * (ENOUGH_SIDES - 1)
    refusal = found[ENOUGH_SIDES - 1]
    assert refusal is not None
    assert is_said_by(refusals.SIDES_EXPLAINED, refusal)
    assert words in refusal.words


def test_a_side_as_asked_ends_the_suspicion() -> None:
    shown = -ASKED
    shown[2] = ASKED[2]
    assert said(shown) == [None] * 5


def test_an_order_of_ones_own_is_no_contradiction() -> None:
    shown = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    assert said(shown) == [None] * 5


def test_sides_about_one_axis_leave_it_open() -> None:
    check = SidesCheck()
    for angle in (0.3, 1.2, 2.1, 3.3, 4.0):
        asked = np.array([np.cos(angle), np.sin(angle), 0.0])
        assert show(check, asked, -asked) is None


def test_the_same_other_side_three_times() -> None:
    check = SidesCheck()
    up = np.array([0, 0, 1.0])
    assert show(check, up, -up) is None
    assert show(check, up, -up) is None
    refusal = show(check, up, -up)
    assert refusal is not None
    assert is_said_by(refusals.SAME_SIDE_AGAIN, refusal)
    assert all(fact in refusal.words.split() for fact in ("3", "+z", "-z"))


def test_a_hold_that_is_measured_again_counts_once() -> None:
    check = SidesCheck()
    up = np.array([0, 0, 1.0])
    for _ in range(6):
        check.follow(np.array([0.2, 0.1, -0.97]))
        assert check.note(up, -up) is None


@pytest.mark.parametrize(
    "wrong", [-np.eye(3), np.diag([1.0, 1, -1]), np.eye(3)[[1, 2, 0]]], ids=["negated", "mirrored", "swapped"]
)
def test_wrong_axes_are_said_within_the_first_positions(make_path: Any, wrong: Any) -> None:
    """Somebody shows what is asked, with a triad that reads wrong @ a: of a negated one the moves would say nothing."""
    path = make_path(100.0).hold(wrong @ [1.0, 0, 0], 8)
    guide = Guide(scheme("corners24"), path.samples().units, settings=GuideSettings(hold_s=3.0))
    rejected: list[Rejected] = []
    fed = 0
    for _ in range(8):
        samples = path.samples()
        events = guide.feed(samples[fed:])
        fed = len(samples)
        rejected += [event for event in events if isinstance(event, Rejected) and event.reason is RefusalCode.AXES]
        target = guide.snapshot().target_direction
        assert target is not None
        path.turn((0.6, 0.8, 0.1), 1.2).turn(wrong @ np.array(target), 1.2).hold(wrong @ np.array(target), 6)
    assert rejected
    assert key_of(rejected[0].remedy) == refusals.SIDES_EXPLAINED.remedy
    assert len(guide.plan.accepted) <= 6


def test_sides_shown_as_asked_prove_the_axes() -> None:
    """Whoever goes another way after that, or begins anew after a pause, is told of the side and not of the driver."""
    check = SidesCheck()
    assert [show(check, one, one) for one in ASKED] == [None] * 5
    up = np.array([0, -0.7071, -0.7071])
    found = [show(check, up, np.array([0, 0, 1.0])) for _ in range(3)]
    assert found[:2] == [None, None]
    refusal = found[2]
    assert refusal is not None
    assert is_said_by(refusals.OTHER_SIDE, refusal)
    assert all(fact in refusal.words for fact in ("+z", "-y-z"))
    assert "-y-z" in refusal.remedy
    assert not line(refusal.event(1.0, None)).split("  ")[-1].startswith("refused")
    assert [show(check, one, -one) for one in ASKED] == [None] * 5


def test_sides_that_a_mirrored_axis_shows_alike_prove_nothing() -> None:
    check = SidesCheck()
    for asked in ([1.0, 0, 0], [0, 1.0, 0], [-0.7071, 0.7071, 0], [0, -1.0, 0]):
        assert show(check, np.array(asked), np.array(asked)) is None
    up = np.array([0, 0, 1.0])
    assert [getattr(show(check, up, -up), "reason", None) for _ in range(3)] == [None, None, RefusalCode.AXES]


def test_what_was_asked_for_because_it_was_seen_proves_nothing() -> None:
    check = SidesCheck()
    for one in ASKED:
        check.follow(np.cross(one, [0.3, 0.5, 0.81]))
        check.note(one, one, chosen=False)
    up = np.array([0, 0, 1.0])
    assert [getattr(show(check, up, -up), "reason", None) for _ in range(3)] == [None, None, RefusalCode.AXES]
