"""Holds that do not count, or no more, by what the guide learns of the outputs; undo among them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imufield.guide.cross_checks.outputs import Outputs
from imufield.guide.events import (
    Accepted,
    Advice,
    Marked,
    RefusalCode,
    Rejected,
    Topic,
)
from imufield.guide.lead.settings import GuideSettings
from imufield.samples import Samples, Status
from tests.guide.guided import FACES, faces_session, key_of, of, run


def clipped_later(make_path: Any, *more: Any) -> Samples:
    """+x is shown 3.7 degrees off, where 1 % of the samples are clipped, and later upright, where most are."""
    path = make_path(100.0).hold(FACES["+z"], 7.0)
    for side in ([1, 0.0638, 0], FACES["+y"], FACES["+x"], *more):
        path.turn(side, 1.5).hold(side, 6.0)
    samples: Samples = path.samples()
    samples.accelerometer[:, 0] = np.minimum(samples.accelerometer[:, 0], 9.81)
    return samples


def test_a_hold_is_taken_back_when_a_later_one_shows_that_it_was_clipped(make_path: Any, cut_blocks: Any) -> None:
    samples = clipped_later(make_path)
    guide, events = run(samples, "paper24", settings=GuideSettings(hold_s=5.0))
    accepted = [event.position for event in of(events, Accepted)]
    assert len(accepted) == 3
    taken_back, refused = of(events, Rejected)
    assert {taken_back.reason, refused.reason} <= {RefusalCode.SATURATED, RefusalCode.STUCK}
    assert key_of(taken_back.words) == "refusals.taken_back"
    assert (taken_back.taken_back, refused.taken_back) == (True, False)
    assert taken_back.position == accepted[1]
    assert taken_back.measured == pytest.approx(1, abs=0.8)
    assert refused.position != taken_back.position
    assert guide.observations().name == (accepted[0], accepted[2])
    # It is pending again, and nothing of this depends on the cuts.
    assert guide.plan.is_pending(guide.plan.find(accepted[1]))
    _, again = run(samples, "paper24", settings=GuideSettings(hold_s=5.0), blocks=list(cut_blocks(samples, [7] * 200)))
    assert list(map(repr, of(again, Rejected))) == list(map(repr, of(events, Rejected)))
    assert list(map(repr, of(again, Accepted))) == list(map(repr, of(events, Accepted)))


def test_undo_brings_no_clipped_hold_back(make_path: Any) -> None:
    """+x is retaken right after it was taken back; without the new measurement there is none."""
    samples = clipped_later(make_path, FACES["+z"], [1, 0.09, 0])
    guide, events = run(samples, "paper24", settings=GuideSettings(hold_s=5.0))
    names = guide.observations().name
    taken_back = of(events, Rejected)[0].position
    assert names[-1] == taken_back
    guide.mark("undo", guide.time_s)
    guide.flush()
    assert guide.observations().name == names[:-1]


def test_a_few_flagged_samples_refuse_a_hold(make_path: Any) -> None:
    """Ten of 500, which the mean leaves out: those that are left show one side of the noise."""
    samples = make_path(100.0).hold([0, 0, 1], 12).samples()
    high = np.argsort(samples.accelerometer[:700, 2])[-14:]
    samples.status[high] |= np.uint32(Status.ACCELEROMETER_SATURATED)
    guide, events = run(samples, settings=GuideSettings(hold_s=5.0))
    refused = of(events, Rejected)[0]
    assert refused.reason is RefusalCode.SATURATED
    assert refused.axis == "z"
    assert refused.limit == pytest.approx(0.1)
    assert 1 < refused.measured < 3
    assert not len(guide.observations())


def test_repeated_frames_are_no_noise_floor_and_no_hold(make_path: Any) -> None:
    samples = make_path(50.0).hold([0, 0, 1], 30).samples()
    samples.accelerometer[:1000], samples.gyroscope[:1000] = samples.accelerometer[0], samples.gyroscope[0]
    guide, events = run(samples)
    assert [event.reason for event in of(events, Rejected)] == [RefusalCode.FROZEN] * len(of(events, Rejected))
    assert of(events, Rejected)
    # As soon as frames arrive it goes on.
    assert guide.observations().start_s.min() > 20.0


def test_frames_that_stop_in_a_session_are_refused_and_measured_again(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 5).turn([1, 0, 0], 1.5).hold([1, 0, 0], 16).samples()
    samples.accelerometer[800:1600], samples.gyroscope[800:1600] = samples.accelerometer[800], samples.gyroscope[800]
    guide, events = run(samples)
    assert {event.reason for event in of(events, Rejected)} == {RefusalCode.FROZEN}
    assert guide.observations().name == ("+z", "+x")
    assert guide.observations().start_s[1] > 16.0


def test_a_knock_after_the_offset_was_found_is_no_move(make_path: Any) -> None:
    """The sixth side shows an offset, which turned what was told of up by 14 degrees; then somebody knocks on the table."""
    sides = [FACES[name] for name in ("+z", "-z", "+y", "-y", "-x", "+x")]
    path = make_path(100.0).hold(sides[0], 6)
    for up in sides[1:]:
        path.turn(up, 1.5).hold(up, 6)
    knock = path.count
    samples = path.hold(sides[-1], 7).samples()
    samples.accelerometer[:, 2] += 2.5
    samples.accelerometer[knock : knock + 30] += np.random.default_rng(3).normal(0, 1.0, (30, 3))
    _, events = run(samples, "corners24")
    (found,) = (event for event in of(events, Advice) if event.topic is Topic.OFFSET)
    last = of(events, Accepted)[-1]
    assert (last.position, last.time_s) == ("+x", found.time_s)
    assert not of(events, Rejected)


@pytest.mark.parametrize(
    ("zero_m_s2", "name"), [((0.0, 0.0, -4.9), None), ((-9.8, 0.0, 9.8), "+x")], ids=["its norm", "its side"]
)
def test_undo_judges_what_it_brings_back(make_path: Any, zero_m_s2: Any, name: Any) -> None:
    """+z is replaced; then it becomes known that the first one is none, or shows another side."""
    samples = faces_session(make_path, ("+z", "+z")).samples()
    guide, events = run(samples, marks=(("retake", 5.5),))
    assert [event.replaces for event in of(events, Accepted)] == [False, True]
    guide.detector.scale = replace(guide.detector.scale, raw_zero=np.array(zero_m_s2), centred=True)
    guide.mark("undo", guide.time_s)
    events = guide.flush() + guide.feed(make_path(100.0).hold([0, 0, 1], 0.2).samples(start_s=guide.time_s + 0.01))
    assert of(events, Marked)
    assert guide.observations().name == (() if name is None else (name,))
    assert [event.reason for event in of(events, Rejected)] == ([RefusalCode.GRAVITY] if name is None else [])


def test_a_hold_that_is_measured_again_takes_the_place_of_the_one_before(
    make_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    added: list[bool] = []
    monkeypatch.setattr(Outputs, "add", lambda _self, _hold, *, again=False: added.append(again))
    samples = make_path(100.0).hold([0, 0, 1], 30).turn([1, 0, 0], 1.5).hold([1, 0, 0], 20).samples()
    number = np.arange(len(samples))
    _, events = run(samples[(number < 330) | (number % 4 > 0)], settings=GuideSettings(hold_s=6.0))
    missing = [event for event in of(events, Rejected) if event.reason is RefusalCode.SAMPLE_LOSS]
    # One entry for each of the two sides.
    assert len(added) == len(missing) > 4
    assert added.count(False) == 2


def test_lost_samples_beside_a_flagged_one_are_not_clipped(make_path: Any) -> None:
    """One of 500 is flagged, in a cell that lost four more: one is a knock."""
    samples = make_path(100.0).hold([0, 0, 1], 12).samples()
    samples.status[400] |= np.uint32(Status.ACCELEROMETER_SATURATED)
    samples.status[401:405] |= np.uint32(Status.ACCELEROMETER_INVALID)
    guide, events = run(samples, settings=GuideSettings(hold_s=5.0))
    assert not of(events, Rejected)
    assert len(guide.observations()) == 1


def test_a_few_rates_at_their_end_refuse_no_still(make_path: Any) -> None:
    """Ten of 500: less than may be lost, and the mean of the accelerometer has both sides of its noise."""
    samples = make_path(100.0).hold([0, 0, 1], 12).samples()
    samples.status[305:700:40] |= np.uint32(Status.GYROSCOPE_SATURATED)
    guide, events = run(samples, settings=GuideSettings(hold_s=5.0))
    assert not of(events, Rejected)
    assert len(guide.observations()) == 1
