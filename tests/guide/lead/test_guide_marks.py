"""What the operator's retake and undo do: to the hold under way, where the unit rests, and to what is asked for next."""

from typing import Any

import pytest

from imufield.guide.events import Accepted, Hold, Move, Rejected
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.state_table import State
from imufield.guide.positions import scheme
from tests.guide.guided import SHORT, faces_session, of, run


def test_a_retake_undone_ends_its_hold(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 24).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=SHORT)
    guide.feed(samples[:800])
    first = guide.observations().start_s[0]
    events = guide.mark("retake", guide.time_s) + guide.feed(samples[800:1000])
    assert guide.snapshot().position == "+z"
    events += guide.mark("undo", guide.time_s) + guide.feed(samples[1000:])
    assert guide.state is State.RESTING
    assert [event.position for event in of(events, Hold)] == ["+z"]
    assert not of(events, Accepted)
    assert not of(events, Rejected)
    assert guide.observations().start_s[0] == first


@pytest.mark.parametrize("order", [("+z",), ("+z", "-y")])
def test_an_accept_undone_is_measured_again_where_the_unit_rests(make_path: Any, order: Any) -> None:
    """Also where another position stays the one that is asked for, as it does for -y."""
    path = faces_session(make_path, order)
    at_s = path.time_s
    guide, events = run(path.hold(path.up[-1][-1], 8).samples(), marks=(("undo", at_s),))
    assert [event.position for event in of(events, Accepted)] == [*order, order[-1]]
    assert of(events, Accepted)[-1].start_s > at_s
    assert guide.observations().name == order


def test_a_replaced_measurement_comes_back_and_is_measured_again(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 24).samples()
    guide, events = run(samples, marks=(("retake", 8.0), ("undo", 15.0)))
    assert [event.replaces for event in of(events, Accepted)] == [False, True, True]
    assert of(events, Accepted)[-1].start_s > 15.0
    assert len(guide.observations()) == 1


def test_what_is_retaken_is_asked_for_first(make_path: Any) -> None:
    """Also where the unit rests on another side, and that side is not complained about."""
    samples = faces_session(make_path, ("+z", "-y", "+x", "-y")).samples()
    guide = Guide(scheme("faces6"), samples.units, settings=SHORT)
    before = guide.feed(samples[:1900])
    assert guide.snapshot().accepted == ("+z", "-y", "+x")
    assert guide.snapshot().target != "-y"
    events = guide.mark("retake", guide.time_s, "-y") + guide.feed(samples[1900:1950])
    assert of(events, Move)[-1].position == guide.snapshot().target == "-y"
    assert not of(before + events, Rejected)
    events += guide.feed(samples[1950:]) + guide.flush()
    assert [(event.position, event.replaces) for event in of(events, Accepted)] == [("-y", True)]
    assert guide.snapshot().target == of(before, Move)[-1].position
