"""How long a session takes to a target: what is said before, and what guided sessions of a virtual person then take."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.calibrate.model.grades import GRADES
from imufield.earth import MICRO_G_M_S2
from imufield.guide.events import Accepted, Advice, Event, Move, Topic
from imufield.guide.hold.hold_time import LONGEST_S, SHORTEST_S
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.session_time import SessionTime, session_time
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.operator import NO_POSITION, OperatorSettings, Visit

pytestmark = pytest.mark.numerical


def said(grade: str = "tactical", positions: str = "paper24", **settings: float) -> SessionTime:
    """Return what is said of an instrument of a grade."""
    typical = GRADES[grade]
    options = GuideSettings(**settings, revisit_first=True)  # type: ignore[arg-type]
    noise = typical.accelerometer.noise_density
    return session_time(scheme(positions), options, noise=noise, scatter_m_s2=typical.scatter_m_s2)


def test_a_hold_is_as_long_as_white_noise_needs_to_average_out() -> None:
    noise_ug = GRADES["tactical"].accelerometer.noise_density / MICRO_G_M_S2
    assert said(target_bias_ug=20.0).hold_s == pytest.approx((noise_ug / 20) ** 2)
    assert said(target_bias_ug=1.0).hold_s == LONGEST_S
    assert said(target_bias_ug=1000.0).hold_s == SHORTEST_S
    # The smaller of both is what counts; a fixed time is that.
    assert said(target_bias_ug=1000.0, target_scale_ppm=20.0).hold_s == said(target_bias_ug=20.0).hold_s
    assert said(target_bias_ug=20.0, hold_s=5.0).hold_s == 5.0
    assert said().hold_s == 10.0


def test_more_is_wanted_more_is_needed() -> None:
    positions = [said(target_bias_ug=float(target)).positions for target in (600, 300, 200, 150)]
    assert positions == sorted(positions)
    assert len(set(positions)) > 1
    never = said(target_bias_ug=5.0)
    assert (never.is_met, never.positions) == (False, 24)
    assert never.words.key == "session_time.unmet"
    # More positions, a better instrument.
    assert said(target_bias_ug=5.0, positions="paper36").forecast["bias_ug"] < never.forecast["bias_ug"]
    assert said("navigation", target_bias_ug=5.0).forecast["bias_ug"] < never.forecast["bias_ug"]
    assert said().words.key == "session_time.free"


def guided(target_bias_ug: float, seed: int) -> tuple[list[Event], float]:
    """Return the events of a session up to where it is as good as wanted, and the minutes it took."""
    positions = scheme("paper24")
    habits = OperatorSettings(initial_still_s=8.0, hold_s=1.0, waits=True, turn_s=(4.0, 7.0))
    first = positions.directions()[:1]
    source = make_virtual_imu(
        Emulation(device="text", rate_hz=50.0, grade="tactical", seed=seed, directions=first, operator=habits)
    )
    guide = Guide(positions, source.imu.instrument.grade.units, settings=GuideSettings(target_bias_ug=target_bias_ug))
    events: list[Event] = []
    while source.time_s < 3600 and not any(isinstance(event, Advice) and event.topic is Topic.TARGET_MET for event in events):
        new = guide.feed(source.next_block(5))
        events += new
        for event in new:
            if isinstance(event, Move):
                source.operator.show(Visit(NO_POSITION, positions.directions()[guide.plan.find(event.position) or 0]))
    return events, source.time_s / 60


# A session of the guide, some ten thousand samples: it shows that what is said before is what it takes.
def test_what_is_said_before_is_what_a_session_takes() -> None:
    target_ug = 150.0
    events, minutes = guided(target_ug, 1)
    before = said(target_bias_ug=target_ug)
    holds = [event for event in events if isinstance(event, Accepted)]
    assert before.is_met
    assert abs(len(holds) - before.positions) <= 4
    assert float(np.median([event.duration_s for event in holds])) == pytest.approx(before.hold_s, rel=0.25)
    assert minutes == pytest.approx(before.minutes, rel=0.35)
    # The guide says it too, by the noise that it has measured.
    told = next(event for event in events if isinstance(event, Advice) and event.topic is Topic.TIME)
    assert told.measured == pytest.approx(before.minutes, rel=0.25)
    assert not math.isfinite(told.limit)
