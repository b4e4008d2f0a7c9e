import math
import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from imufield.guide import refusals
from imufield.guide.events import (
    Accepted,
    Advice,
    Done,
    Hold,
    LinkBack,
    LinkLost,
    Marked,
    Move,
    NoiseFloorMeasured,
    RefusalCode,
    Rejected,
    Topic,
    Turning,
)
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import State
from imufield.guide.positions import scheme
from imufield.guide.refusals import RefusalKind
from imufield.samples import SampleUnits, Status, concatenate
from tests.guide.guided import FACES, SHORT, faces_session, is_said_by, key_of, of, run, values_of


def test_a_whole_session_in_any_order(make_path: Any) -> None:
    order = ("+z", "+x", "-z", "+y", "-x", "-y")
    guide, events = run(faces_session(make_path, order).samples())
    assert guide.done
    assert isinstance(events[0], NoiseFloorMeasured)
    assert isinstance(events[1], Move)
    assert events[1].why == "the unit is already in this position"
    assert [event.position for event in of(events, Accepted)] == list(order)
    assert of(events, Done)[0].skipped == ()
    assert not of(events, Rejected)
    observations = guide.observations()
    assert observations.name == order
    np.testing.assert_allclose(observations.direction, [FACES[name] for name in order])
    error = observations.mean_raw - 9.80665 * observations.direction
    sigma = np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.5
    np.testing.assert_allclose(observations.gyroscope_mean_raw, 0.002, atol=5e-4)


@pytest.mark.parametrize("name", ["paper24", "corners24"])
def test_schemes_with_placement_errors(make_path: Any, name: str) -> None:
    """24 positions up to 15 degrees off, at 2000 Hz tactical noise; no accepted interval touches true motion."""
    rng = np.random.default_rng(11)
    path = make_path(200.0, lever_m=np.array([0.0, 0.08, 0.05])).hold([0, 0, 1], 4)
    for position in scheme(name).positions:
        away = np.cross(position.direction, rng.normal(size=3))
        off = math.tan(math.radians(rng.uniform(0, 15)))
        path.turn(position.direction + off * away / np.linalg.norm(away), rng.uniform(0.8, 4)).hold(path.up[-1][-1], 4)
    guide, events = run(path.samples(0.02, 2e-3), name)
    assert guide.done
    assert len(of(events, Accepted)) == 24
    for event in of(events, Accepted):
        assert any(a <= event.start_s and event.start_s + event.duration_s <= b for a, b in path.still)


def test_events_and_observations_do_not_depend_on_the_cuts(make_path: Any, cut_blocks: Any) -> None:
    samples = faces_session(make_path).samples()
    samples.status[900:940] |= np.uint32(Status.ACCELEROMETER_INVALID)
    marks = (("skip", 9.0), ("retake", 20.0), ("undo", 23.03))
    guide, events = run(samples, marks=marks)
    told = [event.to_dict() for event in events]
    rng = np.random.default_rng(0)
    for sizes in ([2] * (len(samples) // 2), [100] * 60, rng.integers(1, 400, 50).tolist()):
        other, others = run(samples, marks=marks, blocks=list(cut_blocks(samples, sizes)))
        assert [event.to_dict() for event in others] == told
        np.testing.assert_array_equal(other.observations().covariance_raw, guide.observations().covariance_raw)


def test_a_hold_that_is_moved_is_refused_with_value_limit_and_axis(make_path: Any) -> None:
    path = make_path(100.0).hold([0, 0, 1], 5).hold([0, 0, 1], 1.5).turn([0.0, 0.3, 1], 0.7).hold([0, 0.3, 1], 5)
    guide, events = run(path.samples(), settings=GuideSettings(hold_s=8.0))
    refused = of(events, Rejected)
    assert [event.reason for event in refused] == [RefusalCode.MOVED]
    assert refused[0].measured > refused[0].limit > 0
    assert (refused[0].unit, refused[0].axis, refused[0].position) == ("rad/s", "x", "+z")
    assert is_said_by(refusals.MOVED, refused[0])
    assert len(of(events, Hold)) == 2
    assert len(guide.observations()) == 0


def test_far_from_every_position_is_refused_with_the_nearest(make_path: Any) -> None:
    path = faces_session(make_path, ("+z",)).turn([1, 1, 0], 1.5).hold([1, 1, 0], 4)
    _, events = run(path.samples())
    refused = of(events, Rejected)[0]
    assert refused.reason is RefusalCode.NOT_NEAR
    assert refused.measured == pytest.approx(45, abs=0.5)
    assert refused.limit == 20
    assert "45 deg" in refused.words
    proposed = [event.position for event in of(events, Move) if event.time_s <= refused.time_s][-1]
    assert is_said_by(refusals.NOT_NEAR, refused)
    assert proposed in refused.remedy


def test_a_position_done_before_is_named(make_path: Any) -> None:
    _, events = run(faces_session(make_path, ("+z", "+x", "+z")).samples())
    assert [event.reason for event in of(events, Rejected)] == [RefusalCode.ALREADY_DONE]
    assert "+z" in of(events, Rejected)[0].words


def test_a_repeat_needs_the_unit_to_be_lifted(make_path: Any) -> None:
    """corners24 asks for each face twice: lying on is no second measurement, nor is a knock on the table."""
    path = make_path(100.0).hold([0, 0, 1], 20)
    samples = path.samples()
    samples.accelerometer[1000:1020] += np.random.default_rng(0).normal(0, 1, (20, 3))
    guide, events = run(samples, "corners24")
    assert [event.position for event in of(events, Accepted)] == ["+z"]
    assert not of(events, Rejected)
    path = make_path(100.0).hold([0, 0, 1], 6).turn([0, 0, 1], 2.0).hold([0, 0, 1], 5)
    guide, events = run(path.samples(), "corners24")
    assert [event.position for event in of(events, Accepted)] == ["+z", "+z (2)"]
    assert guide.observations().name == ("+z", "+z (2)")


@pytest.mark.parametrize("action", ["skip", "pause", "link"])
@pytest.mark.parametrize("tilt_deg", [0.0, 2.0])
def test_what_nobody_moved_is_no_second_position(make_path: Any, action: str, tilt_deg: float) -> None:
    """The turn that led to a position is not taken for one that led away from it, whatever happens while it rests."""
    tilt = np.radians(tilt_deg)
    path = make_path(100.0).hold([1, 0, 0], 6).turn([0, 0, 1], 2.0).hold([0, 0, 1], 7)
    samples = path.samples()
    after = make_path(100.0).hold([np.sin(tilt), 0, np.cos(tilt)], 8).samples(seed=2)
    guide = Guide(scheme("corners24"), samples.units, settings=SHORT)
    events = guide.feed(samples)
    if action == "link":
        events += guide.link_lost()
    else:
        # A pause is over when it is asked for again.
        events += guide.mark(action, 15.0) + guide.mark(action if action == "pause" else "skip", 15.0)
    events += guide.feed(replace(after, time_s=after.time_s + samples.time_s[-1] + 0.01)) + guide.flush()
    # Only while the link was gone it may have been moved without being seen.
    again = ["+z (2)"] if action == "link" and tilt_deg else []
    assert [event.position for event in of(events, Accepted)] == ["+x", "+z", *again]


def test_lifting_off_a_side_that_is_done_is_no_fault(make_path: Any) -> None:
    path = make_path(100.0).hold([1, 0, 0], 6).turn([0, 0, 1], 1.5).hold([0, 0, 1], 6).turn([1, 0, 0], 1.5)
    path.hold([1, 0, 0], 14).turn([0, 1, 0], 3.0).hold([0, 1, 0], 6)
    _, events = run(path.samples())
    assert [event.reason for event in of(events, Rejected)] == [RefusalCode.ALREADY_DONE]


def test_retake_keeps_the_older_until_the_new_one_is_accepted(make_path: Any) -> None:
    samples = faces_session(make_path, ("+z", "+x", "+z")).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=SHORT)
    guide.feed(samples[:700])
    first = guide.observations().start_s[0]
    assert not guide.mark("retake", guide.time_s, "+z")
    events = guide.feed(samples[700:1250])
    assert of(events, Marked)[0].position == "+z"
    assert guide.observations().name == ("+z", "+x")
    assert guide.observations().start_s[0] == first
    events = guide.feed(samples[1250:]) + guide.flush()
    assert of(events, Accepted)[0].replaces
    assert guide.observations().name == ("+x", "+z")


def test_retake_of_the_position_it_lies_in_begins_at_once(make_path: Any) -> None:
    guide, events = run(make_path(100.0).hold([0, 0, 1], 16).samples(), marks=(("retake", 8.0),))
    assert [event.position for event in of(events, Accepted)] == ["+z", "+z"]
    assert of(events, Accepted)[1].replaces
    assert of(events, Accepted)[1].start_s > 8.0
    assert len(guide.observations()) == 1


def test_undo_skip_and_finish(make_path: Any) -> None:
    samples = faces_session(make_path, ("+z", "+x", "+y")).samples()
    marks = (("undo", 12.0), ("skip", 12.5), ("finish", 19.0))
    guide, events = run(samples, marks=marks)
    said = of(events, Marked)
    assert [event.action for event in said] == ["undo", "skip"]
    assert said[0].position == "+x"
    assert guide.observations().name == ("+z", "+y")
    done = of(events, Done)[0]
    assert guide.done
    assert set(done.skipped) == {"+x", "-x", "-y", "-z"}
    assert said[1].position == "+y"  # taken all the same, because it was shown


def test_marks_that_make_no_sense_are_answered(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 4).samples()
    _, events = run(samples, marks=(("undo", 1.0), ("retake", 1.5)))
    answers = of(events, Marked)
    assert [(event.action, event.position) for event in answers] == [("undo", None), ("retake", None)]
    assert all(event.action in event.words for event in answers)
    with pytest.raises(ValueError, match=r"`action`.*explode.*retake.*skip"):
        run(samples, marks=(("explode", 1.0),))


def test_marks_are_offered_that_do_something(make_path: Any) -> None:
    samples = faces_session(make_path, ("+z", "+x")).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=4.0))
    guide.feed(samples[:100])
    assert set(guide.snapshot().marks) == {"skip", "pause", "finish"}
    guide.feed(samples[100:])
    assert set(guide.snapshot().marks) == {"retake", "skip", "undo", "pause", "finish"}
    guide.link_lost()
    # Nobody can pause what is not there.
    assert "pause" not in guide.snapshot().marks
    (answer,) = of(guide.mark("pause", guide.time_s), Marked)
    assert key_of(answer.words) == "guide.nothing_to_pause"
    guide.mark("finish", guide.time_s)
    assert not {"pause", "finish"} & {*guide.snapshot().marks}


def test_pause_measures_nothing(make_path: Any) -> None:
    guide, events = run(make_path(100.0).hold([0, 0, 1], 20).samples(), marks=(("pause", 3.2), ("pause", 12.0)))
    accepted = of(events, Accepted)
    assert len(accepted) == 1
    assert accepted[0].start_s > 12.0
    assert guide.state is State.RESTING


def test_skipping_everything_ends_the_session(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 20).samples()
    guide, events = run(samples, marks=[("skip", 8.0 + i) for i in range(5)])
    assert guide.done
    assert len(of(events, Done)) == 1


def test_link_lost_and_back_with_a_clock_from_zero(make_path: Any) -> None:
    samples = faces_session(make_path, ("+z", "+x")).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=SHORT)
    events = guide.feed(samples[:800]) + guide.link_lost()
    assert isinstance(events[-1], LinkLost)
    assert guide.state is State.LOST
    again = faces_session(make_path, ("-x", "-y")).samples(seed=2)
    events = guide.feed(again) + guide.flush()
    assert isinstance(events[0], LinkBack)
    assert guide.observations().name == ("+z", "-x", "-y")


def test_samples_after_a_lost_link_mean_that_it_is_back(make_path: Any) -> None:
    samples = faces_session(make_path, ("+z", "+x")).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=SHORT)
    guide.feed(samples[:200])
    guide.link_lost()
    assert isinstance(guide.feed(samples[400:])[0], LinkBack)
    guide.flush()
    assert "+x" in guide.observations().name


@pytest.mark.parametrize(
    ("flag", "row"),
    [
        (Status.ACCELEROMETER_SATURATED, refusals.SATURATED_ON_AXIS),
        (Status.START_UP, refusals.START_UP),
        (Status.INSTRUMENT_FAULT, refusals.FAULT),
        (Status.GYROSCOPE_INVALID, refusals.GYROSCOPE_INVALID),
    ],
)
def test_unusable_samples_are_told_and_never_measured(make_path: Any, flag: Any, row: RefusalKind) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 20).samples()
    samples.status[:] = np.uint32(flag)
    guide, events = run(samples)
    assert all(is_said_by(row, event) for event in of(events, Rejected))
    if row is refusals.SATURATED_ON_AXIS:
        assert of(events, Rejected)[0].axis == "z"
    assert 1 <= len(of(events, Rejected)) <= 3
    assert len(guide.observations()) == 0


def test_values_that_are_not_finite_never_enter_a_mean(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 8).samples()
    samples.accelerometer[::50] = np.nan
    guide, _ = run(samples)
    assert np.isfinite(guide.observations().mean_raw).all()
    samples.accelerometer[400:] = np.nan
    _, events = run(samples)
    assert of(events, Rejected)[-1].reason is RefusalCode.SAMPLE_LOSS


def test_sample_loss_in_a_hold_is_refused_and_measured_again(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 30).samples()
    keep = np.ones(len(samples), dtype=bool)
    keep[330:530:4] = False
    guide, events = run(samples[keep], settings=GuideSettings(hold_s=5.0))
    refused = of(events, Rejected)
    assert refused[0].reason is RefusalCode.SAMPLE_LOSS
    assert refused[0].measured > 5 == pytest.approx(refused[0].limit)
    assert len(guide.observations()) == 1


def test_a_scale_that_no_offset_explains_is_refused_as_gravity(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 8).samples(0.01, scale=(0.1, 1.0))
    guide, events = run(samples)
    refused = of(events, Rejected)[0]
    assert refused.reason is RefusalCode.GRAVITY
    assert refused.measured == pytest.approx(0.98, abs=0.1)
    assert len(guide.observations()) == 0


def test_half_a_scale_is_refused_as_soon_as_the_sides_show_that_it_is_no_offset(make_path: Any) -> None:
    """One hold of 0.5 g is an offset as well as a scale; six sides are not."""
    guide, events = run(faces_session(make_path).samples(0.01, scale=(0.5, 1.0)))
    refused = of(events, Rejected)
    assert [event.reason for event in refused] == 6 * [RefusalCode.GRAVITY]
    assert all(event.measured == pytest.approx(4.9, abs=0.1) for event in refused)
    assert {event.position for event in refused} == set(FACES)
    assert len(guide.observations()) == 0


def test_the_scale_of_a_gyroscope_that_nobody_knows_is_told(make_path: Any) -> None:
    units = SampleUnits(accelerometer="m/s^2", gyroscope="count")
    _, events = run(faces_session(make_path).samples(0.01, scale=(1.0, 939.65), units=units))
    (told,) = (event for event in of(events, Advice) if event.unit == "deg")
    assert told.topic is Topic.SCALE
    assert values_of(told.words)["count_deg_s"] == pytest.approx(np.degrees(1 / 939.65), rel=0.03)
    assert told.measured < told.limit


@pytest.mark.parametrize("units", [SampleUnits(), SampleUnits(accelerometer="count", gyroscope="count")], ids=["SI", "counts"])
def test_sides_are_told_without_an_offset_as_soon_as_they_show_it(make_path: Any, units: SampleUnits) -> None:
    offset = np.array([4.9, 4.9, -4.9])
    first, again = scheme("corners24").directions(), scheme("corners24").directions()[:8]
    path = make_path(50.0, lever_m=np.array([0.05, 0.02, -0.03])).hold(first[0], 6)
    for up in (*first[1:], *again):
        path.turn(up, 1.5).hold(up, 5)
    samples = path.samples(0.01, units=units)
    samples.accelerometer[:] += offset
    guide, events = run(samples, "corners24")
    (found,) = (event for event in of(events, Advice) if event.topic is Topic.OFFSET)
    assert found.measured == pytest.approx(np.linalg.norm(offset), rel=0.02)
    refused = of(events, Rejected)
    assert RefusalCode.GRAVITY not in {event.reason for event in refused}
    assert all(event.time_s <= found.time_s for event in refused if event.reason is RefusalCode.NOT_NEAR)
    assert any(is_said_by(refusals.NOT_NEAR_BY_OFFSET, event) for event in refused)
    # What was told with the offset in it is put right, or shown again: each has the name of the side that was up.
    assert guide.done
    for observation in guide.plan.accepted.values():
        up = (observation.mean_raw - offset) / np.linalg.norm(observation.mean_raw - offset)
        assert up @ observation.direction > 0.999
    assert guide.check_axes().agrees
    assert not guide.adviser.suspect_names


def test_a_drifting_hold_is_refused_and_measured_again(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 30).samples(0.003, 1e-4)
    drift = np.clip((samples.time_s - 3) / 8, 0, 1) * 0.05
    samples.accelerometer[:, 2] += drift
    guide, events = run(samples, settings=GuideSettings(hold_s=8.0))
    refused = of(events, Rejected)
    assert refused[0].reason is RefusalCode.DRIFTING
    assert (refused[0].unit, refused[0].axis) == ("m/s^2", "z")
    assert 0.03 < refused[0].measured < 0.06
    assert len(guide.observations()) == 1
    assert guide.observations().start_s[0] > 8


def test_an_axis_at_its_end_without_a_flag_is_refused(make_path: Any) -> None:
    path = faces_session(make_path, ("+z", "+x"))
    samples = path.samples()
    samples.accelerometer[:, 0] = np.minimum(samples.accelerometer[:, 0], 9.0)
    guide, events = run(samples)
    refused = of(events, Rejected)
    assert [event.reason for event in refused] == [RefusalCode.STUCK]
    assert refused[0].axis == "x"
    assert guide.observations().name == ("+z",)


def test_counts_without_a_scale_learn_it_and_say_so(make_path: Any) -> None:
    units = SampleUnits(accelerometer="count", gyroscope="count")
    samples = faces_session(make_path).samples(0.008, 0.005, units=units, scale=(8192.0, 4780.0))
    guide, events = run(samples)
    assert events[0].scale_learned
    assert guide.done
    assert guide.detector.scale.accelerometer == pytest.approx(8192, rel=1e-3)


def test_left_handed_gyroscope_is_told_once(make_path: Any) -> None:
    samples = faces_session(make_path).samples()
    samples.gyroscope[:, 1] *= -1
    guide, events = run(samples)
    assert [event.reason for event in of(events, Rejected)] == [RefusalCode.AXES]
    assert "y = -y" in of(events, Rejected)[0].words
    assert guide.check_axes().error is not None


def test_a_gyroscope_far_too_small_is_told_with_the_third_position(make_path: Any) -> None:
    samples = faces_session(make_path).samples()
    samples.gyroscope[:] /= 57.3
    guide, events = run(samples)
    assert guide.done
    (warned,) = of(events, Rejected)
    assert warned.reason is RefusalCode.SCALE
    assert is_said_by(refusals.SCALE_DIFFERS, warned)
    told = values_of(warned.words)
    assert told["ratio"] == pytest.approx(57.3, rel=0.03)
    assert re.findall("deg/s|rad/s", told["cause"]) == ["rad/s", "deg/s"]
    assert len([event for event in events[: events.index(warned)] if isinstance(event, Accepted)]) == 3


def test_a_gyroscope_that_never_turns_is_told_once(make_path: Any) -> None:
    samples = faces_session(make_path).samples()
    samples.gyroscope[:] = 0
    guide, events = run(samples)
    assert guide.done
    (told,) = of(events, Rejected)
    assert is_said_by(refusals.MOTIONLESS, told)


def test_turning_is_told_a_few_times_a_second_with_the_angle(make_path: Any) -> None:
    path = make_path(100.0).hold([0, 0, 1], 5).turn([1, 0, 0], 3).hold([1, 0, 0], 1)
    _, events = run(path.samples())
    turning = of(events, Turning)
    assert 10 <= len(turning) <= 18
    assert turning[-1].position == "+x"
    assert turning[-1].angle_deg < 5
    assert all(b.time_s > a.time_s for a, b in pairwise(turning))


def test_a_trembling_hand_is_told_what_keeps_it_from_being_still(make_path: Any) -> None:
    path = make_path(200.0).hold([0, 0, 1], 5).turn([1, 0, 0], 1).hold([1, 0, 0], 20)
    samples = path.samples()
    held = samples.time_s > 6
    samples.gyroscope[held, 1] += 0.9 * np.sin(2 * np.pi * 10 * samples.time_s[held])
    _, events = run(samples, settings=GuideSettings(hold_s=3.0))
    refused = of(events, Rejected)
    assert {event.reason for event in refused} == {RefusalCode.NOT_STILL}
    assert 1 <= len(refused) <= 2
    assert (refused[0].axis, refused[0].unit) == ("y", "rad/s")
    assert "deg/s" in refused[0].words


def test_a_push_within_a_hold_is_refused_and_measured_again(make_path: Any) -> None:
    """Small enough for the detector, which bears a unit that is touched; too large for the norm of the mean."""
    path = make_path(100.0).hold([0, 0, 1], 30)
    samples = path.samples(0.02)
    samples.accelerometer[600:] += 9.8 * np.array([np.radians(0.35), 0, 0])
    guide, events = run(samples, settings=GuideSettings(hold_s=10.0))
    refused = of(events, Rejected)
    assert [event.reason for event in refused] == [RefusalCode.KNOCKED]
    assert refused[0].measured == pytest.approx(0.35, abs=0.05)
    assert is_said_by(refusals.PUSHED, refused[0])
    assert len(guide.observations()) == 1


def test_snapshot_tells_what_a_view_needs(make_path: Any) -> None:
    samples = faces_session(make_path).samples()
    samples.temperature_degc[:] = 31.0
    guide = Guide(scheme("faces6"), samples.units, settings=SHORT)
    assert guide.snapshot().target is None
    guide.feed(samples[:340])
    now = guide.snapshot()
    assert (now.state, now.position) == (State.HOLDING, "+z")
    assert now.rate_hz == pytest.approx(100, rel=0.02)
    assert now.temperature_degc == 31.0
    assert 0 < now.fraction <= 1
    assert now.activity.ratio < 1


def test_at_least_85_percent_of_the_stillness_is_used(make_path: Any) -> None:
    path = faces_session(make_path, hold_s=10.0)
    _, events = run(path.samples(), settings=GuideSettings(hold_s=8.0))
    for event in of(events, Accepted):
        start = next(a for a, b in path.still if a <= event.start_s <= b)
        assert event.duration_s / (event.time_s - start - 0.6) > 0.85


def test_a_session_does_not_wait(make_path: Any) -> None:
    """Holds of 8 s and turns of 1.5 s: each hold is accepted within a second of what it needs."""
    path = faces_session(make_path, hold_s=12.0)
    _, events = run(path.samples(), settings=GuideSettings(hold_s=8.0))
    for event in of(events, Accepted)[1:]:
        start = max(a for a, _ in path.still if a <= event.start_s)
        assert event.time_s - start < 8.0 * 1.25


def test_increment_outputs_work_like_rates(make_path: Any) -> None:
    rates = faces_session(make_path).samples()
    units = SampleUnits(
        accelerometer="m/s", gyroscope="rad", accelerometer_is_increment=True, gyroscope_is_increment=True, interval_s=0.01
    )
    increments = replace(rates, accelerometer=rates.accelerometer * 0.01, gyroscope=rates.gyroscope * 0.01, units=units)
    guide, _ = run(increments)
    assert guide.done
    np.testing.assert_allclose(guide.observations().mean_raw, run(rates)[0].observations().mean_raw, rtol=1e-9)


def test_concatenated_parts_are_one_session(make_path: Any) -> None:
    samples = faces_session(make_path).samples()
    assert run(concatenate([samples[:333], samples[333:]]))[0].done
