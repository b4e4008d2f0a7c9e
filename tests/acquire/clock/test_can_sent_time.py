"""Time of samples from time stamps that the instrument sends on a bus: wraps, silences and stamps that are no times."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.acquire.decode.statistics import remarks
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.samples import FloatArray, Status
from tests.acquire.clock.test_can_clock import jitter, run


def test_stamps_of_the_instrument() -> None:
    kept = np.delete(np.arange(6000), [2000, 2001, 2002])
    ticks = ((kept * 5000.0 + (1 << 32) - 10_000_000) % (1 << 32)).astype(np.float64)
    ticks[[100, 3000]] = np.nan
    rule = ClockRule(time_modulus=1 << 32, time_ticks_per_s=1e6)
    samples, statistics = run(np.zeros(len(kept)), ticks=ticks, rule=rule)
    np.testing.assert_allclose(samples.time_s - samples.time_s[0], kept * 0.005, atol=1e-6)
    assert (statistics.samples_lost, statistics.gaps) == (3, 1)
    assert statistics.nominal_rate_hz == pytest.approx(200)
    assert not (samples.status & Status.TIME_ESTIMATED).any()


@pytest.mark.parametrize("block", [7, 50, 4000])
def test_an_instrument_that_begins_anew_is_a_gap_as_long_as_the_silence(block: int) -> None:
    numbers = np.concatenate([np.arange(1234), np.arange(2000)])
    rule = ClockRule(time_ticks_per_s=1e6)
    stamp_s = np.arange(3234) / 100.0
    stamp_s[1234:] += 3.0
    samples, statistics = run(stamp_s, ticks=numbers * 1e4, rule=rule, block=block)
    np.testing.assert_allclose(samples.time_s, stamp_s, atol=0.011)
    assert (statistics.samples_lost, statistics.gaps, statistics.clock_resets) == (300, 1, 0)
    assert np.flatnonzero(samples.status).tolist() == [1234]
    assert int(samples.status[1234]) == Status.GAP_ESTIMATED
    # A log without time tells of no silence.
    samples, statistics = run(np.zeros(3234), ticks=numbers * 1e4, rule=rule, block=block)
    assert (statistics.samples_lost, statistics.clock_resets) == (0, 1)
    assert np.flatnonzero(samples.status & Status.CLOCK_SET).tolist() == [1234]


@pytest.mark.parametrize(
    "ticks",
    [2.0**63 + 1e4 * np.arange(3000), np.full(3000, np.nan), np.full(3000, 7.0)],
    ids=["too large", "missing", "standing still"],
)
@pytest.mark.parametrize("block", [1, 7, 4000])
def test_a_time_stamp_that_is_no_time_gives_way_to_that_of_the_frames(ticks: FloatArray, block: int) -> None:
    kept = np.delete(np.arange(3001), 2000)
    true_s = kept / 100.0
    samples, statistics = run(true_s + jitter(3000, 2e-4), ticks=ticks, rule=ClockRule(time_ticks_per_s=1e6), block=block)
    np.testing.assert_allclose(samples.time_s, true_s, atol=2e-3)
    assert statistics.lost == 1
    assert [remark.key for remark in remarks([statistics])] == ["statistics.no_time"]


WRAPPING = ClockRule(time_modulus=1 << 16, time_ticks_per_s=1e4)  # Every 6.5 s.


@pytest.mark.parametrize("missing", [10, 300, 399, 655, 656, 1399, 1966])
@pytest.mark.parametrize("block", [1, 7, 10_000])
def test_wraps_of_a_time_stamp_are_told_by_the_silence_of_the_bus(missing: int, block: int) -> None:
    kept = np.concatenate([np.arange(3000), np.arange(3000 + missing, 8000)])
    true_s = kept / 100.0
    rng = np.random.default_rng(missing)
    samples, statistics = run(
        true_s + rng.uniform(0, 0.02, len(kept)), ticks=kept * 100.0 % 65536.0, rule=WRAPPING, block=block
    )
    np.testing.assert_array_equal(samples.time_s, kept * 100 / 1e4)
    assert (statistics.lost, statistics.gaps, statistics.clock_resets) == (missing, 1, 0)
    assert np.flatnonzero(samples.status).tolist() == [3000]
    assert bool(samples.status[3000] & Status.GAP_ESTIMATED) == (missing > 327)


@pytest.mark.parametrize("long_s", [1.0, 6.5, 14.0])
@pytest.mark.parametrize("block", [1, 7, 10_000])
def test_time_stamps_that_wrapped_while_the_host_stood_still_are_no_loss(long_s: float, block: int) -> None:
    true_s = 1.0 + np.arange(8000) / 100.0
    late = (true_s > 30.0) & (true_s < 30.0 + long_s)
    stamp_s = np.where(late, 30.0 + long_s + np.arange(8000) * 1e-5, true_s)
    samples, statistics = run(np.sort(stamp_s), ticks=np.arange(0.0, 8e5, 100.0) % 65536.0, rule=WRAPPING, block=block)
    assert (statistics.lost, statistics.gaps) == (0, 0)
    np.testing.assert_array_equal(samples.time_s, np.arange(8000) * 100 / 1e4)


@pytest.mark.parametrize("step_s", [5.0, 1800.0, 1.7e9, -1.7e9])
@pytest.mark.parametrize("rule", [WRAPPING, ClockRule(time_modulus=1 << 32, time_ticks_per_s=1e6)])
@pytest.mark.parametrize("block", [1, 7, 10_000])
def test_a_clock_of_the_host_that_is_set_is_no_silence_of_the_bus(step_s: float, rule: ClockRule, block: int) -> None:
    number = np.arange(4000)
    stamp_s = number / 100.0 + np.where(number < 3000, 0.0, step_s)
    ticks = np.asarray(number * (rule.time_ticks_per_s / 100) % rule.time_modulus, dtype=np.float64)
    samples, statistics = run(stamp_s, ticks=ticks, rule=rule, block=block)
    np.testing.assert_allclose(samples.time_s, number / 100.0, atol=1e-9)
    assert (statistics.lost, statistics.gaps, statistics.clock_resets) == (0, 0, 0)
    assert not samples.status.any()


@pytest.mark.parametrize("begin", [-20_000, -1, 0, 20_000])
def test_a_time_stamp_with_a_sign_begins_anywhere(begin: int) -> None:
    number = np.arange(2000)
    ticks = np.asarray((begin + number * 100.0 + (1 << 15)) % (1 << 16) - (1 << 15), dtype=np.float64)
    samples, statistics = run(number / 100.0, ticks=ticks, rule=WRAPPING)
    np.testing.assert_allclose(samples.time_s - samples.time_s[0], number / 100.0, atol=1e-9)
    assert (statistics.lost, statistics.gaps, statistics.clock_resets) == (0, 0, 0)


@pytest.mark.parametrize(
    ("stated", "modulus"), [(60_000, 60_000), (1000, 1000), (1001, 1 << 16), (60_000, 1 << 16), (100, 1 << 12)]
)
@pytest.mark.parametrize("begin", [0, 59_000, 65_000])
@pytest.mark.parametrize("block", [1, 7, 10_000])
def test_a_time_stamp_begins_anew_where_its_range_ends_unless_it_goes_on(
    stated: int, modulus: int, begin: int, block: int
) -> None:
    kept = np.delete(np.arange(9000), [500, 501, 6543])
    rule = ClockRule(time_modulus=stated, time_ticks_per_s=1e3)
    samples, statistics = run(
        kept / 100.0, ticks=np.asarray((begin + kept * 10.0) % modulus, dtype=np.float64), rule=rule, block=block
    )
    assert (statistics.lost, statistics.gaps, statistics.clock_resets) == (3, 2, 0)
    np.testing.assert_allclose(samples.time_s - samples.time_s[0], kept / 100.0, atol=1e-9)


@pytest.mark.parametrize("block", [1, 7, 10_000])
def test_a_single_number_beyond_the_end_of_a_time_stamp_is_no_time(block: int) -> None:
    number = np.arange(9000)
    ticks = np.asarray(number * 10.0 % 60_000, dtype=np.float64)
    ticks[[3, 700, 5999, 6000, 7000]] = 65_535
    ticks[[2500, 2501]] = 65_534, 65_535
    rule = ClockRule(time_modulus=60_000, time_ticks_per_s=1e3)
    samples, statistics = run(number / 100.0, ticks=ticks, rule=rule, block=block)
    np.testing.assert_allclose(samples.time_s, number / 100.0, atol=1e-9)
    assert (statistics.lost, statistics.gaps, statistics.clock_resets) == (0, 0, 0)


@pytest.mark.parametrize("wrap_s", [0.256, 0.512, 1.024])
@pytest.mark.parametrize("step_s", [1.0, 1.024, 7.3, 59.7])
def test_wraps_shorter_than_usual_delays_are_not_counted_by_silence(wrap_s: float, step_s: float) -> None:
    number = np.arange(600)
    rule = ClockRule(time_modulus=round(wrap_s * 1e3), time_ticks_per_s=1e3)
    ticks = np.asarray(number * 10.0 % rule.time_modulus, dtype=np.float64)
    samples, statistics = run(number / 100.0 + (number >= 300) * step_s, ticks=ticks, rule=rule)
    np.testing.assert_allclose(samples.time_s - samples.time_s[0], number / 100.0, atol=1e-9)
    assert (statistics.lost, statistics.gaps, statistics.clock_resets) == (0, 1, 1)


@pytest.mark.parametrize("block", [1, 50, 600])
@pytest.mark.parametrize("silence_s", [1.1, 4.3, 20.45])
def test_a_silence_that_short_wraps_do_not_show_is_no_exact_loss(silence_s: float, block: int) -> None:
    number = np.arange(600)
    true_s = number / 100.0 + (number >= 300) * silence_s
    rule = ClockRule(time_modulus=1000, time_ticks_per_s=1e3)
    samples, statistics = run(true_s, ticks=np.rint(true_s * 1e3) % 1000.0, rule=rule, block=block)
    assert np.flatnonzero(samples.status & Status.CLOCK_SET).tolist() == [300]
    assert (statistics.samples_lost, statistics.gaps, statistics.clock_resets) == (0, 1, 1)


@pytest.mark.parametrize("rate_hz", [2.0, 10.0, 20.0])
def test_a_time_stamp_that_begins_anew_faster_than_samples_come_gives_way_to_that_of_the_frames(rate_hz: float) -> None:
    true_s = np.arange(400) / rate_hz
    rule = ClockRule(time_modulus=1 << 16, time_ticks_per_s=1e6)
    samples, statistics = run(true_s, ticks=np.rint(true_s * 1e6) % 65536.0, rule=rule)
    np.testing.assert_allclose(samples.time_s, true_s, atol=1e-6)
    assert (statistics.lost, statistics.gaps) == (0, 0)
    assert [remark.key for remark in remarks([statistics])] == ["statistics.no_time"]


def test_a_log_without_any_time_is_not_told_that_its_frames_have_one() -> None:
    _, statistics = run(np.zeros(100), ticks=np.full(100, np.nan), rule=ClockRule(rate_hz=50.0))
    assert "statistics.no_time" not in [remark.key for remark in remarks([statistics])]


def test_a_silence_at_the_end_keeps_nothing_back() -> None:
    kept = np.append(np.arange(3000), 4399)
    samples, statistics = run(kept / 100.0, ticks=kept * 100.0 % 65536.0, rule=WRAPPING)
    assert (len(samples), statistics.lost) == (3001, 1399)
