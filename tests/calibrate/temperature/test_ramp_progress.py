"""How far a ramp has come."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.calibrate.temperature.ramp import in_one_pose
from imufield.calibrate.temperature.ramp_progress import RampProgress, ramp_progress
from tests.calibrate.temperature.ramp_under_way import AT_DEGC, TIME_S, pose


def test_what_is_covered_counts_from_the_last_move() -> None:
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
