import time

import pytest

from imufield.acquire.link.host_clock import ScaledClock, SystemClock


def test_system_clock_is_the_machine_s() -> None:
    clock = SystemClock()
    before_s, before_ns = time.monotonic(), time.time_ns()
    assert before_s <= clock.monotonic_s() <= time.monotonic()
    assert before_ns <= clock.utc_ns() <= time.time_ns()


def test_scaled_clock_passes_faster_on_both_scales() -> None:
    clock = ScaledClock(8.0)
    # What stops this process between two clocks falls between those that enclose them.
    begin_s, start_s, start_ns, sleep_s = time.monotonic(), clock.monotonic_s(), clock.utc_ns(), time.monotonic()
    clock.sleep(0.4)
    woken_s, passed_s, passed_ns = time.monotonic(), clock.monotonic_s() - start_s, clock.utc_ns() - start_ns
    shortest_s, longest_s = 8.0 * (woken_s - sleep_s), 8.0 * (time.monotonic() - begin_s)
    assert 0.4 <= shortest_s <= passed_s <= longest_s
    assert shortest_s <= passed_ns * 1e-9 <= longest_s


def test_scaled_clock_refuses_to_stand_still() -> None:
    with pytest.raises(ValueError, match="speed"):
        ScaledClock(0.0)
