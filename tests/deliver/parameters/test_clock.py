"""How well the time of the samples is known, by what clock it is."""

from __future__ import annotations

import math

import pytest

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.deliver.parameters.clock import HOST_SIGMA, UNCHECKED_SIGMA, best_rate, clock_facts, clock_words

COUNTED = DecoderStatistics(samples=100_000, nominal_rate_hz=2000.0, rate_hz=1990.0, rate_sigma=1e-6)
SHORT = DecoderStatistics(samples=5000, nominal_rate_hz=2000.0, rate_hz=2015.28, rate_sigma=2e-2)


def test_the_part_that_knows_the_rate_best_tells_it() -> None:
    for parts in ([COUNTED, SHORT], [SHORT, COUNTED], [SHORT, COUNTED, DecoderStatistics()]):
        assert best_rate(parts) is COUNTED
    assert best_rate([DecoderStatistics()]) is None


def test_an_instruments_clock_is_wrong_by_what_the_host_shows() -> None:
    found = clock_facts(COUNTED)
    assert (found.source, found.sample_period_s) == ("compared", 1 / 2000)
    assert found.sigma == pytest.approx(math.hypot(2000 / 1990 - 1, HOST_SIGMA), rel=1e-3)


def test_the_hosts_own_time_is_as_good_as_its_quartz() -> None:
    host = DecoderStatistics(samples=10_000, nominal_rate_hz=100.0, rate_hz=101.0, rate_sigma=1e-4, follows_host=True)
    found = clock_facts(host)
    assert (found.source, found.sample_period_s) == ("host", 1 / 101)
    assert found.sigma == pytest.approx(math.hypot(1e-4, HOST_SIGMA))


def test_nothing_checks_a_typed_rate() -> None:
    # The times of a file are no second clock.
    assert clock_facts(COUNTED, is_import=True).source == "unchecked"
    found = clock_facts(DecoderStatistics(samples=1000, nominal_rate_hz=100.0))
    assert (found.source, found.sigma) == ("unchecked", UNCHECKED_SIGMA)
    assert clock_words(found).values == {"period_ms": 10.0, "sigma_ppm": pytest.approx(1e6 * UNCHECKED_SIGMA)}


@pytest.mark.parametrize("part", [COUNTED, SHORT, DecoderStatistics(samples=1000, nominal_rate_hz=100.0)])
def test_what_the_user_states_goes_before(part: DecoderStatistics) -> None:
    assert clock_facts(part, stated_sigma=1e-4).sigma == 1e-4
