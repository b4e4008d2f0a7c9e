"""Time stamps of the instrument."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.acquire.clock.stamp_clock import StampClock
from imufield.acquire.protocol.samples_and_clock import ClockRule


def run(stamps: np.ndarray, rule: ClockRule, size: int) -> tuple[np.ndarray, np.ndarray]:
    clock = StampClock(rule)
    clock.start(stamps[:size])
    parts = [clock.time(stamps[at : at + size], lambda _: 0.01) for at in range(0, len(stamps), size)]
    return np.concatenate([part.time_s for part in parts]), np.concatenate([part.reset for part in parts])


def test_stamps_are_kept_as_they_are() -> None:
    stamps = 0.02984 + np.arange(100) * 0.01
    time_s, reset = run(stamps, ClockRule(time_field="t"), 33)
    np.testing.assert_array_equal(time_s, stamps)
    assert not reset.any()


def test_many_wraps_of_a_short_stamp() -> None:
    ticks = np.arange(1000, dtype=np.int64) * 7
    time_s, reset = run(ticks % 256, ClockRule(time_field="t", time_modulus=256, time_ticks_per_s=100.0), 9)
    np.testing.assert_array_equal(time_s, ticks / 100)
    assert not reset.any()


@pytest.mark.parametrize("size", [1, 7, 200])
def test_garbage_keeps_time_finite_and_forward_however_cut(size: int) -> None:
    rng = np.random.default_rng(3)
    stamps = np.arange(200) * 0.01
    stamps[rng.integers(0, 200, 60)] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e10, -1e10], 60)
    time_s, reset = run(stamps, ClockRule(time_field="t"), size)
    assert np.isfinite(time_s).all()
    assert (np.diff(time_s) >= 0).all()
    wanted_s, wanted = run(stamps, ClockRule(time_field="t"), 50)
    np.testing.assert_array_equal(time_s, wanted_s)
    np.testing.assert_array_equal(reset, wanted)


def test_a_restart_goes_on_where_time_was() -> None:
    stamps = np.concatenate([100 + np.arange(10) * 0.01, np.arange(10) * 0.01])
    time_s, reset = run(stamps, ClockRule(time_field="t"), 6)
    np.testing.assert_allclose(time_s, 100 + np.arange(20) * 0.01, atol=1e-9)
    assert np.flatnonzero(reset).tolist() == [10]


@pytest.mark.parametrize(("before_end_s", "is_reset"), [(0.05, False), (50.0, False), (70.0, True), (1290.0, True)])
def test_a_restart_is_no_wrap_where_the_end_of_the_range_was_far(before_end_s: float, is_reset: bool) -> None:
    rule = ClockRule(time_field="t", time_modulus=1 << 32, time_ticks_per_s=1e6)
    last = (1 << 32) - round(before_end_s * 1e6)
    stamps = np.concatenate([last - np.arange(9, -1, -1) * 10_000, np.arange(10) * 10_000])
    time_s, reset = run(stamps, rule, 6)
    assert np.flatnonzero(reset).tolist() == ([10] if is_reset else [])
    assert time_s[10] - time_s[9] == pytest.approx(0.01 if is_reset else before_end_s)
