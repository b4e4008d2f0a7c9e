"""Lag behind the host clock."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.acquire.clock.host_lag import HostBaseline


def test_nothing_known_means_no_lag() -> None:
    baseline = HostBaseline()
    assert baseline.lag_s(5.0, 1.0) == 0
    assert baseline.slope is None


def test_late_arrivals_do_not_lift_the_line() -> None:
    baseline = HostBaseline()
    rng = np.random.default_rng(0)
    for sample_s in np.arange(0, 10, 0.02):
        baseline.add(100 + sample_s + 0.003 + rng.exponential(0.01), sample_s)
    assert baseline.lag_s(110.103, 10.0) == pytest.approx(0.1, abs=2e-3)


@pytest.mark.parametrize("error", [-0.02, 100e-6, 0.038])
def test_a_wrong_nominal_rate_is_a_slope_and_no_lag(error: float) -> None:
    baseline = HostBaseline()
    rng = np.random.default_rng(1)
    worst = 0.0
    for arrival_s in np.arange(0, 60, 0.02):
        sample_s = arrival_s * (1 - error)
        late_s = arrival_s + rng.exponential(0.004)
        worst = max(worst, baseline.lag_s(late_s, sample_s))
        baseline.add(late_s, sample_s)
    assert baseline.slope == pytest.approx(error, abs=2e-4)
    assert worst < 0.12


@pytest.mark.parametrize("error", [0.0, 5e-3])
@pytest.mark.parametrize("waited_s", [0.005, 0.05, 0.5])
def test_data_that_had_waited_before_the_first_read_do_not_change_the_rate(error: float, waited_s: float) -> None:
    """After a port was opened again a few seconds were enough to print 2007.6 Hz for 2000 Hz."""
    baseline = HostBaseline()
    rng = np.random.default_rng(2)
    for sample_s in np.arange(0, 6, 0.01):
        late_s = max(waited_s - sample_s, 0.0) + rng.exponential(0.001)
        baseline.add(7.0 + sample_s / (1 - error) + late_s, sample_s)
    assert baseline.slope == pytest.approx(error, abs=3e-5)
    assert 0 < baseline.slope_sigma < 1e-4
    assert abs((baseline.slope or 0.0) - error) < 3 * baseline.slope_sigma


def test_a_host_clock_that_starts_anew_is_taken_as_it_comes() -> None:
    baseline = HostBaseline()
    for sample_s in np.arange(0, 3, 0.1):
        baseline.add(1000 + sample_s, sample_s)
    baseline.add(2.0, 3.1)
    assert baseline.lag_s(2.1, 3.2) == pytest.approx(0, abs=1e-9)


def test_the_line_lies_below_the_last_4_s() -> None:
    baseline = HostBaseline()
    rng = np.random.default_rng(4)
    arrivals_s = 1e5 + np.arange(0, 20, 0.02)
    # Fast by 2 %: the line falls by itself, no slope lifts it.
    samples_s = arrivals_s * 1.02
    late_s = arrivals_s + rng.exponential(0.05, len(arrivals_s))
    for row in range(1, len(arrivals_s)):
        baseline.add(late_s[row - 1], samples_s[row - 1])
        window = [late_s[at] - samples_s[at] for at in range(row) if late_s[at] > late_s[row - 1] - 3.5]
        assert baseline.slope is None or baseline.slope < 0
        assert baseline.offset_at(late_s[row]) == pytest.approx(min(window), abs=1e-7)
