"""Whole turns led by the guide, on simulated rolls."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from imufield.guide import refusals
from imufield.guide.events import Done, Event, Marked, RefusalCode, Rejected, Turn, Turned
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.turns import plan_turns
from imufield.guide.positions import scheme
from imufield.samples import Samples, SampleUnits, make_samples
from tests.guide.guided import feed, is_said_by, key_of, of, values_of

RATE = 100.0
G = 9.80665


class Roll:
    """Up and rate over time of a unit that is rolled about body axes."""

    def __init__(self, up: tuple[float, float, float]) -> None:
        self.now = np.array(up)
        self.up: list[np.ndarray] = []
        self.rate: list[np.ndarray] = []

    def rest(self, seconds: float) -> Roll:
        n = round(seconds * RATE)
        self.up.append(np.tile(self.now, (n, 1)))
        self.rate.append(np.zeros((n, 3)))
        return self

    def turn(self, axis: int, degrees: float, seconds: float) -> Roll:
        n = round(seconds * RATE)
        u = np.arange(n) / n
        angle = math.radians(degrees) * (10 * u**3 - 15 * u**4 + 6 * u**5)
        speed = math.radians(degrees) * (30 * u**2 - 60 * u**3 + 30 * u**4) / seconds
        along = np.eye(3)[axis]

        def carried(phi: Any) -> Any:
            c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
            return self.now * c - np.cross(along, self.now) * s + along * (along @ self.now) * (1 - c)

        self.up.append(carried(angle))
        self.rate.append(np.outer(speed, along))
        self.now = carried(np.array([math.radians(degrees)]))[0]
        return self

    def samples(self) -> Samples:
        up, rate = np.concatenate(self.up), np.concatenate(self.rate)
        rng = np.random.default_rng(0)
        force = G * up + rng.normal(0, 0.01, up.shape)
        turning = rate + 0.002 + rng.normal(0, 1e-3, up.shape)
        return make_samples(np.arange(len(up)) / RATE, force, turning, units=SampleUnits())


def run(roll: Roll, about: str = "horizontal", cuts: int = 1) -> list[Event]:
    marks = [("skip", 4.0 + 0.1 * index) for index in range(1, 6)]
    _, events = feed(roll.samples(), cuts=cuts, marks=marks, rotations=about)
    return events


def rolled_both_ways() -> Roll:
    roll = Roll((0.0, 0.0, 1.0)).rest(9)
    for axis, side in ((0, None), (1, None), (2, 0)):
        if side is not None:
            roll.turn(1, 90, 1.5).rest(2)
        for way in (1, -1):
            roll.turn(axis, way * 360, 4).rest(2)
    return roll


def test_rolls_about_every_axis_both_ways() -> None:
    events = run(rolled_both_ways())
    turned = of(events, Turned)
    assert [(event.axis, event.turns) for event in turned] == [("x", 1), ("x", -1), ("y", 1), ("y", -1), ("z", 1), ("z", -1)]
    assert {event.about for event in turned} == {"horizontal"}
    assert all(event.end_s - event.start_s == pytest.approx(4, abs=0.7) for event in turned)
    assert all(abs(event.angle_deg) == pytest.approx(360, abs=3) for event in turned)
    assert not of(events, Rejected)
    assert isinstance(events[-1], Done)


def test_events_of_turns_do_not_depend_on_the_cuts() -> None:
    told = [event.to_dict() for event in run(rolled_both_ways())]
    assert [event.to_dict() for event in run(rolled_both_ways(), cuts=997)] == told


def test_turns_on_a_table() -> None:
    roll = Roll((0.0, 0.0, 1.0)).rest(9).turn(2, 360, 4).rest(2).turn(2, -360, 4).rest(2)
    events = run(roll, "vertical")
    assert [(event.axis, event.turns, event.about) for event in of(events, Turned)] == [
        ("z", 1, "vertical"),
        ("z", -1, "vertical"),
    ]
    assert not of(events, Done)


def test_a_turn_that_is_not_whole_is_refused_with_the_angle() -> None:
    events = run(Roll((0.0, 0.0, 1.0)).rest(9).turn(0, 300, 4).rest(2))
    refused = of(events, Rejected)
    assert [event.reason for event in refused] == [RefusalCode.NOT_WHOLE]
    assert is_said_by(refusals.TURN_TILTED, refused[0])
    assert refused[0].axis == "x"
    assert refused[0].measured == pytest.approx(60, abs=2)
    assert of(events, Turn)[-1].done == 0


def test_the_way_to_another_side_is_no_turn() -> None:
    events = run(Roll((0.0, 0.0, 1.0)).rest(9).turn(0, 90, 2).rest(2))
    assert not of(events, Turned)
    assert not of(events, Rejected)


def test_turns_can_be_skipped_and_undone_sessions_end() -> None:
    samples = Roll((0.0, 0.0, 1.0)).rest(20).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=3.0, rotations="horizontal"))
    events = guide.feed(samples[:700])
    for _ in range(5):
        events += guide.mark("skip", math.nan)
    answers = []
    for _ in range(6):
        answers += guide.mark("skip", math.nan)
    assert guide.done
    assert of(answers, Done)
    assert [key_of(event.words) for event in of(answers, Marked)] == 6 * ["guide.skip_turn"]


def test_the_plan() -> None:
    assert plan_turns(None) == []
    assert len(plan_turns("horizontal")) == 6
    # The way the axes go round is told by their names in order.
    assert re.search(r"\by\b.*\bz\b", plan_turns("horizontal")[0].words)


def test_a_turn_askew_is_refused_with_what_turned_aside() -> None:
    roll = Roll((0.0, 0.0, 1.0)).rest(9)
    # A screw: a whole turn about x, and a quarter about z that gravity does not see because z ends upright again.
    roll.turn(0, 180, 2).turn(2, 90, 1).turn(0, 180, 2).rest(2)
    refused = of(run(roll), Rejected)
    assert [event.reason for event in refused] == [RefusalCode.NOT_WHOLE]
    assert is_said_by(refusals.TURN_ASIDE, refused[0])
    assert refused[0].measured == pytest.approx(90, abs=3)


def test_too_little_about_the_vertical_is_told_in_degrees() -> None:
    refused = of(run(Roll((0.0, 0.0, 1.0)).rest(9).turn(2, 300, 4).rest(2), "vertical"), Rejected)
    assert [event.reason for event in refused] == [RefusalCode.NOT_WHOLE]
    assert is_said_by(refusals.TURN_SHORT, refused[0])
    assert values_of(refused[0].words)["angle"] == pytest.approx(300, abs=3)
    assert refused[0].measured == pytest.approx(60, abs=3)


@pytest.mark.parametrize(
    ("axis", "first_deg", "made"), [(2, 0, ("vertical", "z", "x", "y")), (0, -360, ("horizontal", "x", "z", "y"))]
)
def test_a_turn_that_is_not_left_is_told_with_what_is(axis: int, first_deg: float, made: tuple[str, ...]) -> None:
    """On the table instead of rolled; or once more in the same sense."""
    roll = Roll((0.0, 0.0, 1.0)).rest(9)
    if first_deg:
        roll.turn(axis, first_deg, 4).rest(2)
    events = run(roll.turn(axis, first_deg or 360, 4).rest(2))
    assert len(of(events, Turned)) == (first_deg != 0)
    (told,) = of(events, Rejected)
    assert told.reason is RefusalCode.OTHER_TURN
    assert is_said_by(refusals.OTHER_TURN, told)
    assert values_of(told.words)["left"] == 6 - (first_deg != 0)
    assert tuple(values_of(values_of(told.words)["made"]).values()) == made
    assert tuple(values_of(values_of(told.remedy)["asked"]).values()) == ("horizontal", "x", "y", "z")
    assert told.measured == pytest.approx(first_deg or 360, abs=3)
    assert told.limit == 360
    assert isinstance(events[-1], Turn)


def test_turns_skipped_or_given_up_are_not_counted_as_made() -> None:
    samples = Roll((0.0, 0.0, 1.0)).rest(9).turn(0, 360, 4).rest(2).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=3.0, rotations="horizontal"))
    for index in range(1, 6):
        guide.mark("skip", 4.0 + 0.1 * index)
    guide.feed(samples)
    assert guide.turns == (1, 6)
    guide.mark("skip", math.nan)
    assert guide.turns == (1, 6)
    guide.mark("finish", math.nan)
    assert guide.turns == (1, 6)
