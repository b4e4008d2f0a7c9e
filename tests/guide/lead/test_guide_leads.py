"""What the guide does beyond the positions: hands, doubt, targets, drift check, warm-up, clocks."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imufield.calibrate.accelerometer.drift import MOST_CONFUSION
from imufield.earth import MILLI_G_M_S2, choose_gravity
from imufield.guide.events import Accepted, Advice, Done, Event, Hold, Move, RefusalCode, Rejected, Topic
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.guide.refusals import what_is_left
from imufield.guide.view.marks import with_keys
from imufield.guide.view.plain import PlainView
from imufield.samples import FloatArray, Samples
from imufield.sentences import Sentences
from tests.guide.guided import FACES, feed, of, values_of
from tests.told import key_of, told

sentence = Sentences("imufield.guide.lead")

ORDER = ("+z", "+x", "-z", "+y", "-x", "-y")


def corners(
    make_path: Any, spoil: int | None = None, again: tuple[int, ...] = (), hold_s: float = 4.5, turned: FloatArray | None = None
) -> Samples:
    """All of corners24, then some of its positions again, turned by a rotation matrix; one reading is 3 mg long."""
    rotations = [np.eye(3)] * 23 + [np.eye(3) if turned is None else turned] * len(again)
    positions = scheme("corners24").positions
    path = make_path(100.0).hold(positions[0].direction, 8)
    starts = [0.0]
    for index, rotation in zip((*range(1, 24), *again), rotations, strict=True):
        direction = rotation @ positions[index].direction
        path.turn(direction, 1.2)
        starts.append(path.time_s)
        path.hold(direction, hold_s)
    samples = path.samples(2e-3, 5e-4)
    if spoil is not None:
        rows = (samples.time_s >= starts[spoil] - 0.6) & (samples.time_s < starts[spoil] + hold_s)
        samples.accelerometer[rows] *= 1.003
    return samples


def test_a_position_that_disagrees_is_named_and_asked_for_again(make_path: Any) -> None:
    name = scheme("corners24").positions[14].name
    guide, events = feed(corners(make_path, spoil=14, again=(14,)), "corners24")
    doubt = next(event for event in of(events, Advice) if event.topic is Topic.DOUBTFUL)
    assert doubt.position == name
    assert doubt.measured == pytest.approx(3e-3 * 9.8, rel=0.25)
    assert "mg" in doubt.words
    assert "sigma" in doubt.words
    values = values_of(doubt.words)
    assert 5.0 <= values["limit_sigmas"] < values["sigmas"]
    assert doubt.limit / doubt.measured == pytest.approx(values["limit_sigmas"] / values["sigmas"])
    assert of(events, Move)[-1].position == name
    assert [event.position for event in of(events, Accepted) if event.replaces] == [name]
    assert guide.done
    assert guide.snapshot().suspects == ()


def test_a_bump_is_a_suspect_in_the_line_that_accepts_it_and_on_the_map(make_path: Any) -> None:
    """The 18th hold of a session is bumped: suspect at once, no other, and ``r`` shows until it is measured again."""
    name = scheme("corners24").positions[17].name
    samples = corners(make_path, spoil=17, again=(17,))
    guide = Guide(scheme("corners24"), samples.units, settings=GuideSettings(hold_s=3.0))
    told: list[str] = []
    suspects: list[Any] = []
    again: list[Any] = []
    view = PlainView(told.append)
    taken: list[Accepted] = []
    for start in range(0, len(samples), 20):
        new = guide.feed(samples[start : start + 20])
        view.show(new)
        taken += of(new, Accepted)
        if any(event.suspect for event in of(new, Accepted)):
            assert guide.snapshot().suspects == (name,)
            # Programs hear of it as before, a person once.
            assert [event.position for event in of(new, Advice) if event.topic is Topic.DOUBTFUL] == [name]
        suspects += [one for one in guide.snapshot().suspects if one not in suspects]
        if taken and taken[-1].position == scheme("corners24").positions[20].name and not again:
            view.show(guide.mark("retake", float("nan")))
            again = [*guide.snapshot().again]
    assert suspects == again == [name]
    assert [event.position for event in taken if event.suspect] == [name]
    # What the others show of good holds is not what the bump makes of them.
    assert all(abs(event.leave_one_out_m_s2 or 0.0) < 0.5e-3 * 9.8 for event in taken[9:] if not event.suspect)
    assert guide.snapshot().again == guide.snapshot().suspects == ()
    assert guide.done
    lines = [line for line in told if "moved or bumped" in line or "SUSPECT" in line]
    assert len(lines) == 1
    assert f"accepted {name}: SUSPECT" in lines[0]
    assert with_keys("[retake]") in lines[0]


def test_skip_during_a_hold_ends_it_and_skips_its_position(make_path: Any) -> None:
    """The unit is held at another position than the one proposed; where it lies, nothing begins before it is moved."""
    path = make_path(100.0).hold([0, 0, 1], 5).turn([0, -1, 0], 1.5).hold([0, -1, 0], 12).turn([1, 0, 0], 1.5)
    samples = path.hold([1, 0, 0], 6).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=4.0))
    events = guide.feed(samples[:800])
    assert guide.snapshot().position == "-y"
    assert guide.snapshot().target != "-y"
    events += guide.mark("skip", guide.time_s) + guide.feed(samples[800:])
    assert [event.position for event in of(events, Accepted)] == ["+z", "+x"]
    assert guide.snapshot().skipped == ("-y",)
    assert [event.position for event in of(events, Hold)] == ["+z", "-y", "+x"]
    assert not of(events, Rejected)


def test_a_skip_undone_measures_where_the_unit_lies(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 20).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=4.0))
    events = guide.feed(samples[:350]) + guide.mark("skip", guide.time_s) + guide.feed(samples[350:1000])
    assert not of(events, Accepted)
    events = guide.mark("undo", guide.time_s) + guide.feed(samples[1000:])
    assert [event.position for event in of(events, Accepted)] == ["+z"]


def test_a_doubt_that_no_longer_stands_is_withdrawn_aloud(make_path: Any) -> None:
    """The doubtful position is measured again at once: the doubt is said once and withdrawn once."""
    positions = scheme("corners24").positions
    samples = corners(make_path, spoil=21, again=(21,))
    guide = Guide(scheme("corners24"), samples.units, settings=GuideSettings(hold_s=3.0))
    events: list[Event] = []
    for start in range(0, len(samples), 100):
        new = guide.feed(samples[start : start + 100])
        if any(event.topic is Topic.DOUBTFUL for event in of(new, Advice)):
            guide.mark("retake", guide.time_s)
        events += new
    told = [event for event in of(events, Advice) if event.topic in (Topic.DOUBTFUL, Topic.SETTLED)]
    assert [(event.topic, event.position) for event in told] == [
        (Topic.DOUBTFUL, positions[21].name),
        (Topic.SETTLED, positions[21].name),
    ]
    assert told[1].words != told[0].words
    assert positions[21].name in told[1].words
    assert told[1].measured < told[1].limit
    assert positions[21].name not in of(events, Done)[-1].words


def test_a_doubt_that_others_settle_asks_for_nothing_any_more(make_path: Any) -> None:
    guide, _ = feed(corners(make_path), "corners24")
    adviser, plan = guide.adviser, guide.plan
    assert adviser.fit is not None
    first = adviser.fit.names[3]
    adviser.suspects = {[*plan.accepted][3]: replace(adviser.fit.disagreements()[3], sigmas=50.0)}
    assert [(one.topic, one.position) for one in adviser.advise(1.0)] == [(Topic.DOUBTFUL, first)]
    adviser.ask_again()
    assert plan.wanted_again == {plan.find(first)}
    adviser.fit_again(guide.detector.scale)
    assert [(one.topic, one.position) for one in adviser.advise(2.0)] == [(Topic.SETTLED, first)]
    assert not plan.wanted_again
    adviser.ask_again()
    assert not plan.wanted_again


def test_a_doubt_follows_its_position_where_an_offset_renames_it(make_path: Any) -> None:
    guide, _ = feed(corners(make_path), "corners24")
    adviser, plan = guide.adviser, guide.plan
    assert adviser.fit is not None
    (index, doubtful), (other, _) = list(zip(plan.accepted, adviser.fit.disagreements(), strict=True))[3:5]
    adviser.suspects = {index: replace(doubtful, sigmas=50.0)}
    adviser.advise(1.0)
    adviser.ask_again()
    observed = {plan.accepted[index].start_s: other, plan.accepted[other].start_s: index}
    shown = {one.start_s: plan.position(observed.get(one.start_s, i)).direction for i, one in plan.accepted.items()}
    # The two change places.
    assert plan.place_anew(lambda observation: shown[observation.start_s]) == 2
    adviser.fit_again(guide.detector.scale)
    renamed = plan.position(other).name
    assert [(one.topic, one.position) for one in adviser.advise(2.0)] == [(Topic.SETTLED, renamed)]
    assert not plan.wanted_again
    # Asked for once already.
    adviser.suspects = {other: replace(doubtful, sigmas=50.0)}
    adviser.ask_again()
    assert not plan.wanted_again


def test_a_doubt_that_stands_is_named_at_the_end(make_path: Any) -> None:
    guide, _ = feed(corners(make_path, spoil=14), "corners24")
    done = of(guide.mark("finish", guide.time_s) + guide.flush(), Done)
    assert done[0].words.endswith(sentence("guide_actions.in_doubt", names=scheme("corners24").positions[14].name))


def test_retake_means_the_doubtful_position(make_path: Any) -> None:
    guide, _ = feed(corners(make_path, spoil=14), "corners24")
    assert not guide.done
    assert guide.plan.wanted_again == {14}


def test_accepted_tells_how_it_fits_and_what_is_known(make_path: Any) -> None:
    _, events = feed(corners(make_path), "corners24")
    taken = of(events, Accepted)
    assert [event.residual_m_s2 is None for event in taken[:5]] == [True, True, True, False, False]
    assert taken[-1].rank == 12
    assert abs(taken[-1].leave_one_out_m_s2) < 5e-3
    assert taken[-1].forecast["bias_ug"] < taken[10].forecast["bias_ug"]
    assert not [event for event in of(events, Advice) if event.topic is Topic.DOUBTFUL]


def test_finishing_early_is_offered_once_when_the_target_is_met(make_path: Any) -> None:
    samples = corners(make_path)
    _, events = feed(samples, "corners24", target_bias_ug=600.0)
    offers = [event for event in of(events, Advice) if event.topic is Topic.TARGET_MET]
    assert len(offers) == 1
    assert offers[0].measured <= offers[0].limit == 600.0
    assert offers[0].time_s < samples.time_s[-1] - 10


def test_the_first_position_is_revisited_and_replaces_nothing(make_path: Any) -> None:
    guide, events = feed(corners(make_path, again=(0,)), "corners24", revisit_first=True)
    assert guide.done
    drift = [event for event in of(events, Advice) if event.topic is Topic.DRIFT]
    assert len(drift) == 1
    assert drift[0].measured <= drift[0].limit
    assert len(guide.observations()) == 24
    assert not any(event.replaces for event in of(events, Accepted))
    *before, last = of(events, Move)
    assert last.position == scheme("corners24").positions[0].name
    assert last.why not in {event.why for event in before}


def test_another_side_at_the_revisit_is_told_which_is_wanted(make_path: Any) -> None:
    _, events = feed(corners(make_path, again=(5,)), "corners24", revisit_first=True)
    wanted = what_is_left([scheme("corners24").positions[0].name])
    assert [event.remedy for event in of(events, Rejected) if event.reason is RefusalCode.ALREADY_DONE] == [wanted]


def test_drift_is_seen_at_the_revisit(make_path: Any) -> None:
    samples = corners(make_path, again=(0,))
    samples.accelerometer[-500:] *= 1.002
    _, events = feed(samples, "corners24", revisit_first=True)
    drift = next(event for event in of(events, Advice) if event.topic is Topic.DRIFT)
    assert drift.measured > drift.limit
    assert drift.position == scheme("corners24").positions[0].name
    assert drift.measured == pytest.approx(2e-3 * 9.8, rel=0.2)


def test_the_check_is_against_the_position_itself_also_where_it_was_retaken(make_path: Any) -> None:
    samples = corners(make_path, again=(0, 5, 0))
    samples.accelerometer[:] += [0.0, 0.0, 0.3]
    first, asked = scheme("corners24").positions[0].name, len(corners(make_path))
    guide = Guide(scheme("corners24"), samples.units, settings=GuideSettings(hold_s=3.0, revisit_first=True))
    guide.feed(samples[:asked])
    guide.mark("retake", guide.time_s, first)
    events = guide.feed(samples[asked:]) + guide.flush()
    assert [event.position for event in of(events, Accepted) if event.replaces] == [first]
    (drift,) = (event for event in of(events, Advice) if event.topic is Topic.DRIFT)
    assert drift.position == first
    assert drift.measured <= drift.limit


def test_the_revisit_says_what_drift_it_can_show_in_another_attitude(make_path: Any) -> None:
    """A bias b across a turn by the angle t changes the norm by b t."""
    turn, bias_m_s2 = math.radians(3.0), 0.3
    across = np.cross(scheme("corners24").positions[0].direction, [0.36, 0.48, 0.8])
    x, y, z = across / np.linalg.norm(across)
    about = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    limits, said = {}, []
    for turned in (None, np.eye(3) + np.sin(turn) * about + (1 - np.cos(turn)) * about @ about):
        samples = corners(make_path, again=(0,), turned=turned)
        samples.accelerometer[:] += [0.0, 0.0, bias_m_s2]
        _, events = feed(samples, "corners24", revisit_first=True)
        (drift,) = (event for event in of(events, Advice) if event.topic is Topic.DRIFT)
        limits[key_of(drift.words)] = drift.limit
        said += told([drift.words], "advice.no_drift_turned")
    (values,) = (sentence.values for sentence in said)
    same_m_s2 = values["same_mg"] * MILLI_G_M_S2
    assert values["turned_deg"] == pytest.approx(3.0, abs=0.1)
    assert limits["advice.no_drift"] == pytest.approx(same_m_s2, rel=0.5)
    assert limits["advice.no_drift_turned"] == pytest.approx(np.hypot(same_m_s2, 4 * bias_m_s2 * turn), rel=0.05)


def test_a_wrong_common_scale_is_told(make_path: Any) -> None:
    samples = corners(make_path)
    samples.accelerometer[:] *= 1.05
    _, events = feed(samples, "corners24")
    told = [event for event in of(events, Advice) if event.topic is Topic.SCALE]
    assert len(told) == 1
    assert told[0].measured == pytest.approx(0.05, abs=0.002)


@pytest.mark.parametrize("latitude_error_deg", [0.0, 5.0])
def test_a_wrong_latitude_shows_against_an_earlier_calibration(make_path: Any, latitude_error_deg: float) -> None:
    """Gravity of WGS 84 at 45 degrees grows by 90 ppm per degree of latitude."""
    wrong = 1 + 90e-6 * latitude_error_deg
    samples = corners(make_path)
    gravity = float(np.linalg.norm(samples.accelerometer[:300].mean(axis=0)))
    _, events = feed(
        samples, "corners24", gravity=replace(choose_gravity(), gravity_m_s2=gravity * wrong), earlier_scale_raw=1.0
    )
    said = [event for event in of(events, Advice) if event.topic is Topic.SCALE]
    assert len(said) == 1
    assert (said[0].measured > said[0].limit) is (latitude_error_deg > 0)
    assert ("latitude" in said[0].remedy) is (latitude_error_deg > 0)
    assert said[0].measured == pytest.approx(90e-6 * latitude_error_deg, abs=40e-6)
    assert isinstance(events[-1], Done)


def warming(make_path: Any, slope_degc_min: float, from_s: float = 0.0, to_s: float = math.inf) -> Samples:
    """Hold three sides for 30 s each while the temperature changes for some of the time."""
    path = make_path(100.0).hold([0, 0, 1], 30).turn([1, 0, 0], 2).hold([1, 0, 0], 28).turn([0, 1, 0], 2).hold([0, 1, 0], 28)
    samples = path.samples()
    samples.temperature_degc[:] = 20 + np.round(slope_degc_min / 60 * np.clip(samples.time_s - from_s, 0, to_s - from_s), 2)
    return samples


@pytest.mark.parametrize("slope_degc_min", [2.0, -30.0])
@pytest.mark.parametrize("hold_s", [3.0, 8.0, None])
def test_nothing_is_accepted_while_the_temperature_changes(make_path: Any, hold_s: float | None, slope_degc_min: float) -> None:
    guide, events = feed(warming(make_path, slope_degc_min), hold_s=hold_s)
    refused = of(events, Rejected)
    assert {event.reason for event in refused} == {RefusalCode.WARMING_UP}
    assert refused[0].measured == pytest.approx(abs(slope_degc_min), rel=0.2)
    assert len(guide.observations()) == 0
    # Nothing asks to hold still, and nobody who moves on hears that a hold ended too early.
    assert [event.position for event in of(events, Hold)] == ["+z"]
    assert [event.position for event in refused] == ["+z", "+x", "+y"]


def test_a_slow_change_of_temperature_is_none(make_path: Any) -> None:
    assert len(feed(warming(make_path, 0.3), hold_s=8.0)[0].observations()) == 3


def test_a_later_change_of_temperature_ends_no_session(make_path: Any) -> None:
    guide, events = feed(warming(make_path, 3.0, 20.0, 50.0), hold_s=3.0)
    assert guide.observations().name == ("+z", "+x", "+y")
    assert not of(events, Rejected)


def test_the_first_hold_starts_when_the_temperature_is_steady(make_path: Any) -> None:
    guide, events = feed(warming(make_path, 3.0, 0.0, 35.0), hold_s=3.0)
    assert guide.observations().name == ("+x", "+y")
    assert [event.position for event in of(events, Rejected)] == ["+z", "+x"]
    # The line through half a minute sees what is over, in part.
    assert 40 < guide.observations().start_s[0] < 60


def test_the_operator_may_measure_while_the_temperature_changes(make_path: Any) -> None:
    samples = warming(make_path, 2.0)
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=8.0))
    guide.mark("go_on", 15.0)
    events = guide.feed(samples)
    assert len(of(events, Rejected)) == 1
    # At once, where the unit lies.
    assert guide.observations().name == ("+z", "+x", "+y")
    assert 15 < guide.observations().start_s[0] < 17


def test_without_a_temperature_nothing_is_waited_for(make_path: Any) -> None:
    samples = warming(make_path, 2.0)
    samples.temperature_degc[:] = np.nan
    _, events = feed(samples, hold_s=3.0)
    assert of(events, Accepted)[0].time_s < 4


def test_a_jump_of_the_clock_is_told(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 20).samples()
    samples.time_s[500:] += 3600
    guide, events = feed(samples, hold_s=8.0)
    told = [event for event in of(events, Rejected) if event.reason is RefusalCode.CLOCK_JUMP]
    assert [event.measured for event in told] == [pytest.approx(3600, abs=1)]
    assert len(guide.observations()) == 1
    assert guide.observations().start_s[0] > 3600


def test_a_changed_sample_rate_is_told(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 30).samples()
    thinned = np.ones(len(samples), dtype=bool)
    thinned[1000::5] = False
    _, events = feed(samples[thinned], hold_s=20.0)
    told = [event for event in of(events, Rejected) if event.reason is RefusalCode.RATE]
    assert len(told) == 1
    assert values_of(told[0].words)["percent"] == pytest.approx(-20)


def test_finish_ends_a_session_with_turns_left(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 10).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=3.0, rotations="horizontal"))
    guide.feed(samples)
    assert of(guide.mark("finish", math.nan), Done)
    assert guide.done


def test_what_was_finished_early_is_taken_up_again(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 10).turn([1, 0, 0], 2).hold([1, 0, 0], 10).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=3.0, rotations="horizontal"))
    first = int(np.searchsorted(samples.time_s, 10.5))
    guide.feed(samples[:first])
    guide.mark("finish", math.nan)
    assert guide.finished_early
    assert [event.kind for event in guide.mark("reopen", math.nan)] == ["link_lost"]
    events = guide.feed(samples[first:])
    assert not guide.done
    assert not guide.finished_early
    assert of(events, Move)[0].accepted == 1
    assert [event.accepted for event in of(events, Accepted)] == [2]
    asked = guide.asked_to_finish()
    assert asked.action == "finish"
    assert re.search(r"\b2\b.*\b6\b.*\b0\b.*\b6\b", asked.words)
    assert not guide.mark("reopen", math.nan)


def test_undone_positions_are_known_no_longer(make_path: Any) -> None:
    path = make_path(100.0).hold(FACES[ORDER[0]], 6.0)
    for name in ORDER[1:5]:
        path.turn(FACES[name], 1.5).hold(FACES[name], 5.0)
    guide, _ = feed(path.samples())
    assert guide.snapshot().forecast is not None
    for _ in range(2):
        guide.mark("undo", guide.time_s)
    guide.flush()
    assert len(guide.plan.accepted) == 3
    assert guide.snapshot().forecast is None


def test_an_order_that_cannot_tell_drift_from_curvature_is_told(make_path: Any) -> None:
    positions = scheme("paper24").positions
    faces = [position for position in positions if np.max(np.abs(position.direction)) > 0.99]
    path = make_path(100.0).hold(faces[0].direction, 6.0)
    for position in faces[1:]:
        path.turn(position.direction, 1.5).hold(position.direction, 5.0)
    _, events = feed(path.samples(), "paper24")
    (told,) = [event for event in of(events, Advice) if event.topic is Topic.ORDER]
    assert told.measured > told.limit == MOST_CONFUSION
    assert f"{told.limit:g}" in told.words
