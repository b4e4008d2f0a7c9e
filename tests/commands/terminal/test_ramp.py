"""What the operator of a ramp is told, and when."""

from __future__ import annotations

from dataclasses import replace

from imufield.calibrate.temperature.ramp import FASTEST_DEGC_PER_MIN
from imufield.calibrate.temperature.ramp_progress import ramp_progress
from imufield.commands.terminal.ramp import RampSpeaker
from imufield.samples import FloatArray
from tests.calibrate.temperature.ramp_under_way import AT_DEGC, TIME_S, pose
from tests.told import keys


def told(force: FloatArray) -> dict[float, list[str]]:
    """Return the keys of what is said, by time, window by window."""
    speaker, said = RampSpeaker(), {}
    for count in range(1, len(TIME_S) + 1):
        progress = ramp_progress(TIME_S[:count], AT_DEGC[:count], force[:count])
        assert progress is not None
        if news := speaker.news(progress):
            said[float(TIME_S[count - 1])] = keys(news)
    return said


def test_each_thing_is_told_once_and_in_time() -> None:
    said = told(pose())
    order = [key for keys_then in said.values() for key in keys_then]
    assert order == [
        "ramp.begins",
        "ramp.even",
        "ramp.covered",
        "ramp.covered",
        "ramp.fast",
        "ramp.even_again",
    ]
    times = {key: at_s for at_s, keys_then in said.items() for key in keys_then}
    assert times["ramp.even"] == 300.0
    assert 1900 < times["ramp.fast"] <= 1960
    assert 2270 <= times["ramp.even_again"] <= 2340


def test_a_move_is_told_when_it_is_seen() -> None:
    assert told(pose(moved_s=1500.0))[1500.0][0] == "ramp.moved"


def test_too_fast_is_told_beyond_the_limit_and_again_only_after_it_was_good() -> None:
    speaker = RampSpeaker()
    now = ramp_progress(TIME_S, AT_DEGC, pose())
    assert now is not None
    speaker.news(now)
    # At the limit an estimate is above it half of the time; and one that goes up and down about the margin is told once.
    rates = [2.0, 2.02, -2.05, 2.5, 2.1, 2.5, 1.9, 2.3]
    told_at = [rate for rate in rates if "ramp.fast" in keys(speaker.news(replace(now, degc_per_min=rate)))]
    assert told_at == [2.5, 2.3]
    assert min(map(abs, told_at)) > FASTEST_DEGC_PER_MIN
