"""The pace of an emulated instrument: slow for seconds on end, or for a moment only."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate

import pytest

from imufield.simulate.emulator.core import PaceWatch
from imufield.simulate.emulator.emulate import Emulation, make_emulator

SPEED = 60.0


def after(spans: Iterator[tuple[float, float]], speed: float = SPEED) -> PaceWatch:
    """Return the watch after spans of (wall time, times real time)."""
    watch = PaceWatch(speed)
    parts = [(span_s, span_s * times) for span_s, times in spans]
    for wall_s, delivered_s in accumulate(parts, lambda sums, part: (sums[0] + part[0], sums[1] + part[1])):
        watch.check(wall_s, delivered_s)
    return watch


@pytest.mark.parametrize("span_s", [0.008, 0.3, 1.0, 7.0])
def test_slow_for_seconds_on_end_is_found(span_s: float) -> None:
    spans = round(max(10.0, span_s) / span_s)
    assert after((span_s, SPEED / 4) for _ in range(spans)).reached == pytest.approx(SPEED / 4)
    assert after((span_s, 0.0) for _ in range(spans)).reached == 0.0
    assert after((span_s, SPEED) for _ in range(spans)).reached is None


def test_a_machine_that_stops_for_a_moment_is_not_slow() -> None:
    # Two seconds of every five without a sample, and all of them at once behind that.
    moments = [SPEED, SPEED, 0.0, 0.0, 3 * SPEED]
    assert after((1.0, times) for _ in range(50) for times in moments).reached is None


def test_slower_than_real_time_on_purpose() -> None:
    assert after(((1.0, 0.5) for _ in range(20)), 0.5).reached is None
    assert after(((1.0, 0.25) for _ in range(20)), 0.5).reached == 0.25


def test_who_waits_takes_no_lock_that_an_interrupt_could_leave_held() -> None:
    with make_emulator(Emulation(rate_hz=125.0)) as emulator, emulator._finished._cond:  # type: ignore[attr-defined]
        assert not emulator.wait(0.05)
    assert emulator.wait(10)
