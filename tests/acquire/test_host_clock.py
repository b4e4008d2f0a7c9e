import time

import pytest

from imufield.acquire.host_clock import ScaledClock, SystemClock


def test_system_clock_is_the_machine_s() -> None:
    clock = SystemClock()
    before_s, before_ns = time.monotonic(), time.time_ns()
    assert before_s <= clock.monotonic_s() <= time.monotonic()
    assert before_ns <= clock.utc_ns() <= time.time_ns()


def test_scaled_clock_passes_faster_on_both_scales() -> None:
    clock = ScaledClock(8.0)
    start_s, start_ns, real_s = clock.monotonic_s(), clock.utc_ns(), time.monotonic()
    clock.sleep(0.4)
    passed_s, passed_ns, passed_real_s = clock.monotonic_s() - start_s, clock.utc_ns() - start_ns, time.monotonic() - real_s
    assert passed_s >= 0.4
    assert passed_ns * 1e-9 == pytest.approx(passed_s, abs=0.1)
    assert passed_real_s >= 0.4 / 8.0
    assert passed_s == pytest.approx(8.0 * passed_real_s, abs=0.1)


def test_scaled_clock_refuses_to_stand_still() -> None:
    with pytest.raises(ValueError, match="larger than 0"):
        ScaledClock(0.0)
