"""The hold under way: in the hand, its length and its countdown, and where the clock was set."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from imufield.guide import refusals
from imufield.guide.events import Accepted, Hold, Holding, RefusalCode, Rejected
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.samples import Samples, Status
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from tests.guide.guided import FACES, SHORT, feed, is_said_by, of, run, values_of

ORDER = ("+z", "+x", "-z", "+y")


def hand_session(tremor_deg: float = 0.08, sway_deg: float = 0.3, seed: int = 5) -> tuple[Samples, Operator, Imu]:
    habits = OperatorSettings(
        style="held",
        hold_s=9.0,
        initial_still_s=5.0,
        turn_s=(1.0, 2.5),
        tremor_rad=math.radians(tremor_deg),
        sway_rad=math.radians(sway_deg),
        sway_m=0.001,
    )
    operator = Operator([FACES[name] for name in ORDER], seed, habits)
    imu = Imu(perfect_instrument(TACTICAL), seed, ImuSettings(rate_hz=125, drift=False, loss_probability=0.001))
    count = round((operator.plan_all() - 0.5) * 125)
    return imu.feed(operator.block(0, count, imu.interval_s)), operator, imu


def test_a_unit_in_the_hand_is_measured_as_such() -> None:
    samples, operator, imu = hand_session()
    guide, events = feed(samples, hold_s=5.0)
    taken = of(events, Accepted)
    assert sorted(guide.observations().name) == sorted(ORDER)
    held = [event for event in taken if event.held]
    assert len(held) >= 3
    assert all(0.05 < event.tremor_deg < 0.12 for event in held)
    for event in held:
        end_s = event.start_s + event.duration_s
        assert not any(
            imu.to_sample_clock(move.start_s) < end_s and imu.to_sample_clock(move.end_s) > event.start_s
            for move in operator.moves
        )
    norm = np.linalg.norm(guide.observations().mean_raw, axis=1)
    np.testing.assert_allclose(norm, operator.site.gravity_m_s2, atol=300e-6 * 9.8)


def test_the_time_that_is_told_is_the_time_to_hold() -> None:
    """Guard bands included: whoever lets go when it is over has held long enough."""
    told: list[Holding] = []
    held = 0
    for event in feed(hand_session()[0], hold_s=5.0)[1]:
        if isinstance(event, Hold):
            told = []
        if isinstance(event, Holding):
            told.append(event)
        if isinstance(event, Accepted) and event.held:
            held += 1
            np.testing.assert_allclose([each.time_s + each.remaining_s for each in told], event.time_s, atol=0.6)
    assert held >= 3


def test_guard_bands_do_not_count_in_a_hold_that_ended_too_early() -> None:
    """Of 9 s in the hand 6 count, where 7 are asked for."""
    told = [values_of(event.words) for event in of(feed(hand_session()[0], hold_s=7.0)[1], Rejected)]
    lasted_s = [values["lasted_s"] for values in told if "lasted_s" in values]
    assert len(lasted_s) >= 2
    assert max(lasted_s) < 7


def test_letting_go_too_early_again_and_again_is_helped() -> None:
    """Holds of 9 s in the hand where 12 are asked for: the first refusal says what moved, the others say what to do."""
    samples, _, _ = hand_session()
    _, events = feed(samples, hold_s=12.0)
    let_go = [event for event in of(events, Rejected) if event.reason is RefusalCode.MOVED]
    assert len(let_go) >= 3
    assert is_said_by(refusals.MOVED, let_go[0])
    for times, event in enumerate(let_go[1:], start=2):
        assert is_said_by(refusals.MOVED_AGAIN, event)
        assert values_of(event.remedy)["times"] == times


def test_events_of_a_hand_do_not_depend_on_the_cuts() -> None:
    samples, _, _ = hand_session()
    told = [event.to_dict() for event in feed(samples, hold_s=5.0)[1]]
    for cuts in (7, 611):
        assert [event.to_dict() for event in feed(samples, hold_s=5.0, cuts=cuts)[1]] == told


@pytest.mark.parametrize(("tremor_deg", "sway_deg"), [(0.35, 0.2), (0.05, 4.0)])
def test_larger_movement_is_refused_with_the_value(tremor_deg: float, sway_deg: float) -> None:
    samples, _, _ = hand_session(tremor_deg, sway_deg)
    guide, events = feed(samples, hold_s=5.0)
    refused = of(events, Rejected)
    reasons = {event.reason for event in refused}
    assert reasons & {RefusalCode.TREMBLING, RefusalCode.SWAYING, RefusalCode.NOT_STILL, RefusalCode.MOVED}
    assert all(event.measured > event.limit > 0 for event in refused if event.reason is not RefusalCode.ALREADY_DONE)
    assert not any(event.held for event in of(events, Accepted))
    assert len(guide.observations()) <= 1


def test_a_hold_does_not_go_on_where_the_clock_was_set(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 16).samples()
    samples.status[500] |= np.uint32(Status.CLOCK_SET)
    guide, events = run(samples, settings=GuideSettings(hold_s=6.0))
    assert [event.reason for event in of(events, Rejected)] == [RefusalCode.CLOCK_JUMP]
    assert guide.observations().start_s[0] >= 5


def test_a_link_that_is_lost_before_the_noise_floor_refuses_no_hold(make_path: Any) -> None:
    """What was still before belongs to no hold: nobody was told to hold."""
    samples = make_path(100.0).hold([0, 0, 1], 14).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=SHORT)
    events = guide.feed(samples[:200]) + guide.link_lost() + guide.feed(samples[405:]) + guide.flush()
    assert not of(events, Rejected)
    assert guide.observations().name == ("+z",)
