"""How far a ramp has come, and what its operator is told when."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.temperature.progress import RampProgress, RampSpeaker, ramp_progress
from imufield.calibrate.temperature.ramp import FASTEST_DEGC_PER_MIN, in_one_pose
from imufield.samples import FloatArray
from tests.told import keys

TIME_S = np.arange(0.0, 4000.0, 10.0)
# Even for 700 s, 1 degC/min for 20 degC, 3 degC/min for 6, and even again.
AT_DEGC = np.interp(TIME_S, [0.0, 700.0, 1900.0, 2020.0, 4000.0], [-10.0, -10.0, 10.0, 16.0, 16.0])


def pose(moved_s: float = math.inf) -> FloatArray:
    force = np.tile([0.1, 0.2, 9.8], (len(TIME_S), 1))
    force[moved_s <= TIME_S] = [0.1, 0.6, 9.8]
    return force


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
        "progress.begins",
        "progress.even",
        "progress.covered",
        "progress.covered",
        "progress.fast",
        "progress.even_again",
    ]
    times = {key: at_s for at_s, keys_then in said.items() for key in keys_then}
    assert times["progress.even"] == 300.0
    assert 1900 < times["progress.fast"] <= 1960
    assert 2270 <= times["progress.even_again"] <= 2340


def test_what_is_covered_counts_from_the_last_move() -> None:
    said = told(pose(moved_s=1500.0))
    assert said[1500.0][0] == "progress.moved"
    progress = ramp_progress(TIME_S, AT_DEGC, pose(moved_s=1500.0))
    assert progress is not None
    assert (progress.moved_s, progress.high_degc) == (1500.0, 16.0)
    assert progress.low_degc == pytest.approx(-10 + 800 / 60)
    # And that is what is cut from it: the longest stretch.
    assert in_one_pose(pose(moved_s=1500.0)) == slice(150, 400)
    assert in_one_pose(pose()) == slice(0, 400)


def test_without_a_temperature_nothing_is_known() -> None:
    assert ramp_progress(TIME_S, np.full(400, np.nan), pose()) is None
    first = ramp_progress(TIME_S[:1], AT_DEGC[:1], pose()[:1])
    assert isinstance(first, RampProgress)
    assert math.isnan(first.degc_per_min)
    assert [first.is_even, first.is_too_fast, first.is_enough] == [False] * 3


def test_too_fast_is_told_beyond_the_limit_and_again_only_after_it_was_good() -> None:
    speaker = RampSpeaker()
    now = ramp_progress(TIME_S, AT_DEGC, pose())
    assert now is not None
    speaker.news(now)
    # At the limit an estimate is above it half of the time; and one that goes up and down about the margin is told once.
    rates = [2.0, 2.02, -2.05, 2.5, 2.1, 2.5, 1.9, 2.3]
    told_at = [rate for rate in rates if "progress.fast" in keys(speaker.news(replace(now, degc_per_min=rate)))]
    assert told_at == [2.5, 2.3]
    assert min(map(abs, told_at)) > FASTEST_DEGC_PER_MIN
