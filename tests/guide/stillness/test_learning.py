"""The first seconds: what keeps the noise floor from being measured, slow streams, dead axes."""

from typing import Any

import numpy as np
import pytest

from imufield.errors import CalibrationError, Reason
from imufield.guide import refusals
from imufield.guide.events import NoiseFloorMeasured, RefusalCode, Rejected
from imufield.guide.lead.state_table import State
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import SampleUnits, make_samples
from tests.guide.guided import FACES, cells_of, faces_session, find_still_intervals, is_said_by, of, run, values_of
from tests.refused import refused


def test_even_noise_waited_for_in_vain_is_said_to_be_a_wrong_unit(make_path: Any) -> None:
    samples = make_path(200.0).hold([0, 0, 1], 30).samples()
    samples.gyroscope[:] *= 57.3
    _, events = run(samples)
    assert {event.reason for event in events} == {RefusalCode.NOT_QUIET}
    assert is_said_by(refusals.NOT_QUIET_SHAKES, events[0])
    assert is_said_by(refusals.NOT_QUIET_GYROSCOPE, events[-1])
    assert "--set" in events[-1].remedy


def test_the_moves_tell_the_factor_of_a_gyroscope_whose_noise_is_none_of_a_unit_at_rest(make_path: Any) -> None:
    samples = faces_session(make_path).samples(sigma_rad_s=2e-3)
    samples.gyroscope[:] *= 57.3
    guide, events = run(samples)
    assert guide.state is State.LEARNING
    told = of(events, Rejected)
    assert is_said_by(refusals.SCALE_DIFFERS, told[-1])
    assert values_of(told[-1].words)["ratio"] == pytest.approx(1 / 57.3, rel=0.03)
    # Before there were moves enough, nothing was known.
    assert {event.reason for event in told} == {RefusalCode.NOT_QUIET, RefusalCode.SCALE}
    with refused(CalibrationError, Reason.UNITS, key="refusals.scale_differs"):
        find_still_intervals([samples])


@pytest.mark.parametrize("rate_hz", [10.0, 12.5, 15.0, 20.0, 25.0, 35.0])
@pytest.mark.parametrize("sigma_m_s2", [0.005, 0.02, 0.05])
def test_slow_streams_have_a_noise_floor_of_their_scatter(make_path: Any, rate_hz: float, sigma_m_s2: float) -> None:
    samples = faces_session(make_path, hold_s=9.0, rate_hz=rate_hz).samples(sigma_m_s2)
    guide, events = run(samples)
    assert guide.done
    assert not of(events, Rejected)
    floor = of(events, NoiseFloorMeasured)[0]
    assert floor.accelerometer_sigma == pytest.approx(sigma_m_s2, rel=0.35)
    assert floor.rate_hz == pytest.approx(rate_hz, rel=0.05)


def test_a_slow_stream_from_a_swaying_hand_is_no_noise_floor(make_path: Any) -> None:
    samples = make_path(10.0).hold([0, 0, 1], 60).samples()
    samples.accelerometer[:, 0] += 0.2 * np.sin(2 * np.pi * 0.9 * samples.time_s)
    guide, events = run(samples)
    assert guide.state is State.LEARNING
    assert {event.reason for event in events} == {RefusalCode.NOT_QUIET}


@pytest.mark.parametrize(("axis", "value"), [(0, 0.0), (1, 3.5)])
def test_a_dead_axis_is_named_after_three_sides(make_path: Any, axis: int, value: float) -> None:
    samples = faces_session(make_path).samples()
    samples.accelerometer[:, axis] = value
    _, events = run(samples)
    (named,) = (event for event in of(events, Rejected) if event.reason is RefusalCode.INVALID)
    assert is_said_by(refusals.DEAD_AXIS, named)
    assert named.axis == "xyz"[axis]
    told = values_of(named.words)
    assert (told["reading"], told["sides"]) == (value, 3)
    assert named.time_s < 20


def test_an_axis_without_noise_is_not_dead(make_path: Any) -> None:
    path = make_path(100.0).hold(FACES["+z"], 6)
    for name in ("+y", "-z", "-y", "+z"):
        path.turn(FACES[name], 1.5).hold(FACES[name], 5)
    _, events = run(path.samples(0.0))
    assert not [event for event in of(events, Rejected) if event.reason is RefusalCode.INVALID]


def test_waiting_for_quiet_says_what_it_waits_for(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 30).samples()
    shaking = 2 * np.sin(2 * np.pi * 3.3 * samples.time_s) + np.sin(2 * np.pi * 0.31 * samples.time_s)
    samples.accelerometer[:] += shaking[:, None]
    guide, events = run(samples)
    assert guide.state is State.LEARNING
    assert {event.reason for event in events} == {RefusalCode.NOT_QUIET}
    assert 2 <= len(events) <= 3
    # Amplitudes of 2 m/s^2 at 3.3 Hz and 1 m/s^2 on top: rms 1.6 m/s^2.
    assert is_said_by(refusals.NOT_QUIET_SHAKES, events[0])
    assert "3 s" in events[0].words
    assert "accelerometer" in events[0].words
    assert events[0].measured > events[0].limit > 0


def test_waiting_for_quiet_names_a_slow_turn_that_noise_does_not_show(make_path: Any) -> None:
    samples = make_path(100.0).hold([0, 0, 1], 20).samples()
    samples.gyroscope[:, 2] += np.radians(3.0) * np.sin(2 * np.pi * 0.2 * samples.time_s)
    _, events = run(samples)
    assert isinstance(events[0], Rejected)
    assert is_said_by(refusals.NOT_QUIET_STRAYS, events[0])
    assert "gyroscope z" in events[0].words
    assert events[0].axis == "z"
    assert events[0].unit == "rad/s"
    # Within 3 s of 5 s the rate strays from its mean by the amplitude at least, and by twice that at most.
    assert np.radians(2.0) < events[0].measured < np.radians(6.0)


def test_waiting_long_for_quiet_costs_no_more_with_every_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    detector = StillnessDetector(RoughScale(accelerometer=1.0, gyroscope=1.0))
    samples = make_samples(np.arange(6_000) / 50.0, rng.normal(0.0, 5.0, (6_000, 3)), None, units=SampleUnits())
    looked_at: list[int] = []
    length = Cells.__len__

    def counted(cells: Cells) -> int:
        looked_at.append(1)
        return length(cells)

    monkeypatch.setattr(Cells, "__len__", counted)
    spent = []
    for cells in cells_of(samples[begin : begin + 5] for begin in range(0, len(samples), 5)):
        looked_at.clear()
        assert not list(detector.judge(cells))
        spent.append(len(looked_at))
    assert len(spent) > 1100
    assert max(spent[1000:]) <= max(spent[100:200])
