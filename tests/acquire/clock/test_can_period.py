"""The period of a bus, by the stamps of its first samples alone."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.acquire.clock.can_period import LEARN_SAMPLES, learned_from, sample_period_s
from imufield.samples import FloatArray

TRUE_S = 0.01


def learned(stamp_s: FloatArray, rate_hz: float) -> float:
    """Return the period that is learned from stamps of even samples, given a nominal rate."""
    count, _ = learned_from(stamp_s, LEARN_SAMPLES)
    assert count > 0
    return sample_period_s(stamp_s[:count], np.arange(float(count)), rate_hz)


def bursts_with_an_outage(first: int) -> FloatArray:
    """Return stamps of a host that looks every 33 ms at a bus that is silent for 0.1 s."""
    sent_s = TRUE_S * np.delete(np.arange(1000), slice(first, first + 10))
    stamp_s = np.ceil(sent_s / 0.033) * 0.033 + np.random.default_rng(first).exponential(1e-3, len(sent_s))
    return np.maximum.accumulate(stamp_s)


def test_what_bursts_miss_by_less_than_a_fifth_is_the_nominal_rate() -> None:
    outages = [bursts_with_an_outage(first) for first in range(30, 90)]
    missed = [abs(learned(stamp_s, 0.0) / TRUE_S - 1) for stamp_s in outages]
    assert 0.1 < max(missed) < 0.2, "too short an outage to be told from a host that sleeps"
    assert [learned(stamp_s, 1 / TRUE_S) for stamp_s in outages] == [TRUE_S] * len(outages)


@pytest.mark.parametrize("rate_hz", [50.0, 70.0, 140.0, 200.0])
def test_a_nominal_rate_that_bursts_are_far_from_is_not_believed(rate_hz: float) -> None:
    stamp_s = np.ceil(TRUE_S * np.arange(1000) / 0.033) * 0.033
    assert learned(stamp_s, rate_hz) == pytest.approx(TRUE_S, rel=0.01)


@pytest.mark.parametrize(("rate_hz", "expected_s"), [(0.0, 0.01), (250.0, 0.004)])
def test_stamps_that_stand_still_show_no_period(rate_hz: float, expected_s: float) -> None:
    assert sample_period_s(np.zeros(20), np.arange(20.0), rate_hz) == expected_s


def test_damaged_stamps_whose_steps_cancel_out_are_survived() -> None:
    stamp_s = np.concatenate([np.zeros(20), np.full(20, 1e17), [1.0]])
    assert sample_period_s(stamp_s, np.arange(41.0), 0.0) > 0
