from typing import Any

import numpy as np
import pytest

from imufield.guide.hold.observe import Observation
from imufield.guide.lead.plan import Plan
from imufield.guide.positions import scheme
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
    assert [one.start_s for one in plan.withdrawn] == [1.0]
    assert plan.undo() == ("accept", 0)
    assert plan.accepted[0].start_s == 1.0
    assert [one.start_s for one in plan.withdrawn] == [3.0]
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
