from typing import Any

import numpy as np
import pytest

from imufield.calibrate.accelerometer.drift import MOST_CONFUSION, order_confusion
from imufield.dataclass import replace
from imufield.guide.cross_checks.running_fit import FEWEST, running_fit
from imufield.guide.hold.observe import Observation
from imufield.guide.lead.plan import Plan, next_best
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from tests.guide.guided import noise_output


def observation(name: str, start_s: Any = 0.0) -> Any:
    nothing = np.full(3, np.nan)
    return Observation(
        name=name,
        direction=nothing,
        mean_raw=nothing,
        covariance_raw=np.eye(3),
        gyroscope_mean_raw=nothing,
        gyroscope_covariance_raw=np.eye(3),
        gyroscope_rounding_raw=np.zeros(3),
        start_s=start_s,
        duration_s=10.0,
        temperature_degc=20.0,
        output=noise_output(),
    )


@pytest.fixture
def plan() -> Any:
    return Plan(scheme("faces6"))


def test_tolerance_is_never_more_than_half_way_to_the_next() -> None:
    assert Plan(scheme("faces6")).tolerance_deg == 20
    assert Plan(scheme("paper24")).tolerance_deg == 20
    assert Plan(scheme("paper36")).tolerance_deg == pytest.approx(15)


def test_nearest_prefers_what_is_asked_for() -> None:
    plan = Plan(scheme("corners24"))
    first = plan.find("+z")
    again = plan.find("+z (2)")
    assert first is not None
    assert again is not None
    up = np.array([0.0, 0.0, 1.0])
    assert plan.nearest(up, pending=True).index == min(first, again)
    plan.accept(first, observation("+z"))
    assert plan.nearest(up, pending=True).index == again
    plan.accept(again, observation("+z (2)"))
    assert plan.nearest(up, pending=True).angle_deg > 50
    assert plan.nearest(up, pending=False).angle_deg == pytest.approx(0, abs=1e-3)


def test_retake_keeps_the_older_and_undo_brings_it_back(plan: Any) -> None:
    plan.accept(0, observation(plan.position(0).name, 1.0))
    plan.accept(1, observation(plan.position(1).name, 2.0))
    plan.want_again(0)
    assert plan.proposed() == 0
    assert plan.accepted[0].start_s == 1.0
    assert plan.accept(0, observation(plan.position(0).name, 3.0))
    assert plan.accepted[0].start_s == 3.0
    assert plan.undo() == ("accept", 0)
    assert plan.accepted[0].start_s == 1.0
    assert plan.proposed() == 0


def test_undo_of_each_action(plan: Any) -> None:
    assert plan.undo() is None
    plan.skip(0)
    assert plan.proposed() == 1
    assert plan.undo() == ("skip", 0)
    assert plan.proposed() == 0
    plan.accept(0, observation(plan.position(0).name))
    plan.want_again(0)
    assert plan.undo() == ("retake", 0)
    assert plan.proposed() == 1
    assert plan.undo() == ("accept", 0)
    assert plan.proposed() == 0
    assert plan.accepted == {}


def test_a_skipped_position_is_taken_when_shown(plan: Any) -> None:
    plan.skip(0)
    assert plan.is_pending(0)
    plan.accept(0, observation(plan.position(0).name))
    assert plan.skipped == set()


def test_nothing_is_left_when_all_is_measured_or_skipped(plan: Any) -> None:
    for index in range(5):
        plan.accept(index, observation(plan.position(index).name))
    plan.skip(5)
    assert plan.proposed() is None
    assert plan.missing() == (plan.position(5).name,)


def test_a_revisit_replaces_nothing_and_can_be_undone_and_skipped(plan: Any) -> None:
    plan.accept(0, observation(plan.position(0).name, 1.0))
    plan.revisiting = 0
    assert plan.is_pending(0)
    assert not plan.accept(0, observation(plan.position(0).name, 9.0))
    assert plan.accepted[0].start_s == 1.0
    assert plan.revisited.start_s == 9.0
    assert plan.undo() == ("revisit", 0)
    assert (plan.revisiting, plan.revisited) == (0, None)
    plan.skip(0)
    assert plan.revisiting is None
    assert plan.skipped == set()


def test_nearest_of_pending_is_nothing_when_all_is_measured(plan: Any) -> None:
    for index in range(6):
        plan.accept(index, observation(plan.position(index).name))
    assert plan.nearest(np.array([0.0, 0.0, 1.0]), pending=True) is None


def shows(**directions: Any) -> Any:
    """Return what ``place_anew`` asks: where an observation has up, by its start."""
    return lambda one: np.array(directions[f"at_{one.start_s:.0f}"], dtype=float)


def accept_sides(plan: Any, *names: str) -> list[int]:
    """Accept observations that start at 0, 1, ... s; return the positions."""
    found = [plan.find(name) for name in names]
    for start_s, (index, name) in enumerate(zip(found, names, strict=True)):
        plan.accept(index, observation(name, float(start_s)))
    return found


def test_exchanged_positions_are_undone_one_by_one(plan: Any) -> None:
    x, y = accept_sides(plan, "+x", "+y")
    assert plan.place_anew(shows(at_0=[0, 1, 0], at_1=[1, 0, 0])) == 2
    assert [(index, one.name, one.start_s) for index, one in plan.accepted.items()] == [(y, "+y", 0.0), (x, "+x", 1.0)]
    assert plan.undo() == ("accept", x)
    assert [one.start_s for one in plan.accepted.values()] == [0.0]
    assert plan.undo() == ("accept", y)
    assert plan.accepted == {}


def test_what_moves_keeps_its_place_in_the_order_of_acceptance(plan: Any) -> None:
    accept_sides(plan, "+x", "+y", "-z")
    plan.place_anew(shows(at_0=[0, 0, 1], at_1=[0, 1, 0], at_2=[0, 0, -1]))
    assert [one.name for one in plan.accepted.values()] == ["+z", "+y", "-z"]


@pytest.mark.parametrize("why", ["wanted again", "revisiting"])
def test_a_stray_takes_no_position_that_is_measured(plan: Any, why: str) -> None:
    x, y = accept_sides(plan, "+x", "+y")
    if why == "revisiting":
        plan.revisiting = x
    else:
        plan.want_again(x)
    plan.place_anew(shows(at_0=[1, 0, 0], at_1=[1, 0, 0]))
    assert {index: one.start_s for index, one in plan.accepted.items()} == {x: 0.0}
    assert plan.is_pending(y)


def test_what_is_asked_of_an_observation_moves_with_it(plan: Any) -> None:
    x, y = accept_sides(plan, "+x", "+y")
    z, below = plan.find("+z"), plan.find("-z")
    plan.skip(z)
    plan.want_again(x)
    plan.revisiting = y
    plan.place_anew(shows(at_0=[0, 0, 1], at_1=[0, 0, -1]))
    assert (plan.wanted_again, plan.revisiting, plan.skipped) == ({z}, below, set())


def test_undo_passes_over_what_was_taken_back(plan: Any) -> None:
    x, y = accept_sides(plan, "+x", "+y")
    plan.want_again(y)
    plan.accept(y, observation("+y", 2.0))
    plan.take_back(y)
    assert plan.is_pending(y)
    assert plan.undo() == ("accept", x)
    assert plan.undo() is None


def test_undo_brings_back_what_was_replaced_and_not_what_was_taken_back(plan: Any) -> None:
    (x,) = accept_sides(plan, "+x")
    plan.take_back(x)
    plan.accept(x, observation("+x", 1.0))
    assert plan.undo() == ("accept", x)
    assert plan.accepted == {}


def test_a_position_that_is_revisited_and_taken_back_is_measured_first(plan: Any) -> None:
    (x,) = accept_sides(plan, "+x")
    plan.revisiting = x
    plan.take_back(x)
    plan.accept(x, observation("+x", 1.0))
    assert plan.accepted[x].start_s == 1.0
    assert plan.revisited is None


def test_an_undone_position_is_not_revisited(plan: Any) -> None:
    (x,) = accept_sides(plan, "+x")
    plan.revisiting = x
    plan.undo()
    plan.accept(x, observation("+x", 1.0))
    assert plan.accepted[x].start_s == 1.0


def test_what_is_wanted_again_comes_before_all_others(plan: Any) -> None:
    plan.accept(3, observation(plan.position(3).name))
    plan.first = plan.preferred = 2
    plan.want_again(3)
    assert plan.proposed() == 3
    plan.skip(3)
    assert plan.proposed() == 2


@pytest.mark.parametrize("first", ["x+90", "y+0", "z+0", "x+270"])
def test_the_positions_asked_for_tell_drift_from_curvature_whichever_was_first(first: str) -> None:
    positions, gravity = scheme("paper24"), GuideSettings().gravity
    up = positions.directions()
    means = [replace(observation(each.name), mean_raw=gravity.gravity_m_s2 * each.direction) for each in positions.positions]
    fit = running_fit(means, RoughScale(accelerometer=1.0), gravity)
    assert fit is not None
    start = next(place for place, each in enumerate(positions.positions) if each.name == first)
    left = [place for place in range(24) if place != start]
    done = [start]
    while left:
        # Without a fit the guide asks for them in the order of the scheme.
        asked = next_best(fit.of(done), up[done], up[left], hurried=False) if len(done) >= FEWEST and len(left) > 1 else 0
        done.append(left.pop(asked))
    assert order_confusion(up[done]) <= MOST_CONFUSION
