"""The sample clock: losses the counter cannot show, restarts, streams without a clock."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.acquire.clock.clock import Arrivals
from imufield.acquire.clock.sample_clock import SampleClock
from imufield.acquire.decode.assembly import RawBlock
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.dataclass import replace
from imufield.samples import NO_COUNTER, Samples, SampleUnits, Status, concatenate

COUNTER = ClockRule(counter_field="counter", counter_modulus=256, counter_ticks_per_s=2000.0, counter_steps=(1, 2, 4, 8, 16))
GAP = np.uint32(Status.AFTER_GAP | Status.GAP_ESTIMATED)


def block(counter: np.ndarray | None = None, ticks: np.ndarray | None = None, n: int = 0) -> RawBlock:
    n = len(counter) if counter is not None else len(ticks) if ticks is not None else n
    return RawBlock(
        accelerometer=np.zeros((n, 3)),
        gyroscope=np.zeros((n, 3)),
        temperature_degc=np.zeros(n),
        counter=np.full(n, NO_COUNTER) if counter is None else counter,
        ticks=np.empty(0) if ticks is None else ticks,
        status=np.zeros(n, dtype=np.uint32),
        lost_before=np.zeros(n, dtype=np.int64),
        skipped_before=np.zeros(n),
        stream_end=np.arange(1, n + 1),
    )


def run(rule: ClockRule, blocks: list[tuple[RawBlock, float]]) -> tuple[Samples, DecoderStatistics]:
    statistics = DecoderStatistics()
    clock = SampleClock(rule, SampleUnits(), statistics)
    done = [clock.push(each, Arrivals(np.array([len(each)]), np.array([arrival_s]))) for each, arrival_s in blocks]
    return concatenate([samples for samples in (*done, clock.flush()) if samples is not None]), statistics


def counter_blocks(numbers: np.ndarray, step: int, arrival_s: np.ndarray, size: int) -> list[tuple[RawBlock, float]]:
    """Return samples of these numbers in blocks of ``size``; a block arrives when its last sample does."""
    return [
        (block(numbers[at : at + size] * step % 256), float(arrival_s[at : at + size][-1]))
        for at in range(0, len(numbers), size)
    ]


@pytest.mark.parametrize("step", [1, 16])
@pytest.mark.parametrize("lost", [300, 256, 512, 5000])
def test_whole_wraps_are_estimated_from_the_host_clock(step: int, lost: int) -> None:
    n = 8000
    numbers = np.concatenate([np.arange(n), np.arange(n) + n + lost])
    rng = np.random.default_rng(lost)
    size = 40 // step if step == 1 else 4
    # Every sample arrives when it was taken, and the system hands blocks over up to 15 ms late.
    arrival_s = 50 + numbers * step / 2000 + rng.uniform(0, 0.015, len(numbers))
    samples, statistics = run(COUNTER, counter_blocks(numbers, step, arrival_s, size))
    assert len(samples) == 2 * n
    np.testing.assert_allclose(samples.time_s, numbers * step / 2000, atol=1e-9)
    assert statistics.samples_lost + statistics.losses_estimated == lost
    assert statistics.gaps == 1
    (place,) = np.flatnonzero(samples.status & GAP)
    assert place == n
    assert samples.status[place] & np.uint32(Status.GAP_ESTIMATED)


@pytest.mark.parametrize("rule", [ClockRule(counter_field="counter", counter_modulus=256), ClockRule()])
def test_a_rate_that_nobody_told_is_that_of_arrival(rule: ClockRule) -> None:
    # A counter tells how many samples, and no time, where its rate is not known: the clock of the host does.
    numbers = np.arange(4000)
    samples, statistics = run(rule, counter_blocks(numbers, 20, 50 + numbers / 100, 4))
    assert statistics.nominal_rate_hz == pytest.approx(100, rel=0.02)
    np.testing.assert_allclose(np.diff(samples.time_s), 0.01, rtol=0.1)
    assert statistics.gaps == 0


@pytest.mark.parametrize(
    ("rate_hz", "has_counter"),
    # A stamp that stands still, or steps by two, tells of losses where no counter says how many samples there are.
    [(101.3, False), (101.3, True), (300.0, False), (300.0, True), (700.0, True), (2000.0, True)],
)
@pytest.mark.parametrize("size", [1, 80, 3000])
def test_the_rate_is_that_of_all_stamps_and_not_of_the_first(rate_hz: float, has_counter: bool, size: int) -> None:
    # Milliseconds, as of many loggers: most steps of 101.3 Hz are 10, and some 9. Some samples are lost, and one pause is long.
    numbers = np.delete(np.arange(9000), [*range(100, 120), 4000])
    ticks = (1e3 * numbers / rate_hz + 5000.0 * (numbers > 6000)).astype(np.int64)
    rule = ClockRule(time_field="time", time_ticks_per_s=1e3)
    if has_counter:
        # What somebody typed is not what the stamps show.
        rule = replace(rule, counter_field="counter", counter_modulus=1 << 16, rate_hz=100.0)
    blocks = [
        (block(numbers[at : at + size], ticks[at : at + size]), float(ticks[at : at + size][-1] / 1e3))
        for at in range(0, len(numbers), size)
    ]
    _, statistics = run(rule, blocks)
    assert statistics.nominal_rate_hz == pytest.approx(rate_hz, rel=2e-4)


WRAPPING = ClockRule(time_field="time", time_modulus=1 << 16, time_ticks_per_s=1e4)  # Every 6.5 s.


@pytest.mark.parametrize("missing", [300, 655, 656, 1399, 1966])
@pytest.mark.parametrize("size", [1, 5])
def test_wraps_of_a_time_stamp_are_estimated_from_the_host_clock(missing: int, size: int) -> None:
    kept = np.concatenate([np.arange(3000), np.arange(3000 + missing, 8000)])
    arrival_s = 50 + kept / 100.0 + np.random.default_rng(missing).exponential(0.0005, len(kept))
    ticks = kept * 100 % (1 << 16)
    ends = np.append(np.arange(size, len(kept), size), len(kept))
    alone, statistics = run(WRAPPING, [(block(ticks=ticks[end - size : end]), float(arrival_s[end - 1])) for end in ends[:-1]])
    rest = len(alone)
    np.testing.assert_allclose(alone.time_s, kept[:rest] * 100 / 1e4, atol=1e-9)
    assert (statistics.lost, statistics.gaps, statistics.clock_resets) == (missing, 1, 0)
    assert bool(alone.status[3000] & np.uint32(Status.GAP_ESTIMATED)) == (missing > 500)
    clock = SampleClock(WRAPPING, SampleUnits(), DecoderStatistics())
    timed = (clock.push(block(ticks=ticks), Arrivals(ends, arrival_s[ends - 1])), clock.flush())
    np.testing.assert_array_equal(concatenate([each for each in timed if each]).time_s[:rest], alone.time_s)


@pytest.mark.parametrize("unknown", [None, 605, 615, 630, 648, 700])
@pytest.mark.parametrize("rule", [COUNTER, WRAPPING])
def test_a_read_without_arrival_behind_a_loss_keeps_the_order_of_time(rule: ClockRule, unknown: int | None) -> None:
    number = np.concatenate([np.arange(600), np.arange(600, 1500) + (5 * 256 if rule is COUNTER else 2000)])
    arrival_s = 50 + number / (2000 if rule is COUNTER else 100)
    if unknown is not None:
        arrival_s[unknown] = np.nan
    counter, ticks = (number % 256, None) if rule is COUNTER else (None, number * 100 % (1 << 16))
    blocks = [
        block(None if counter is None else counter[row : row + 1], None if ticks is None else ticks[row : row + 1])
        for row in range(1500)
    ]
    samples, _ = run(rule, list(zip(blocks, arrival_s.tolist(), strict=True)))
    assert np.diff(samples.time_s).min() >= 0


@pytest.mark.parametrize("pace", [1.5, 10.0])
def test_time_stamps_that_wrapped_while_data_were_late_are_no_loss(pace: float) -> None:
    true_s = np.arange(8000) / 100.0
    # From 30 s to 44 s nothing is read; then what waited comes faster than it is made.
    arrival_s = 50 + np.maximum(true_s, np.where(true_s > 30, 44 + (true_s - 30) / pace, 0))
    ticks = np.arange(8000) * 100 % (1 << 16)
    samples, statistics = run(
        WRAPPING, [(block(ticks=ticks[at : at + 5]), float(arrival_s[at + 4])) for at in range(0, 8000, 5)]
    )
    assert (statistics.lost, statistics.gaps) == (0, 0)
    np.testing.assert_array_equal(samples.time_s, np.arange(8000) * 100 / 1e4)


def test_a_burst_of_late_data_is_no_loss() -> None:
    numbers = np.arange(8000)
    arrival_s = 10 + numbers / 2000
    # The host stops for 1 s and then reads what was buffered in 5 ms steps.
    late = (numbers >= 4000) & (numbers < 6200)
    arrival_s[late] = 10 + 6000 / 2000 + (numbers[late] - 4000) * 0.1 / 2200
    samples, statistics = run(COUNTER, counter_blocks(numbers, 1, arrival_s, 40))
    np.testing.assert_allclose(samples.time_s, numbers / 2000, atol=1e-9)
    assert statistics.losses_estimated == statistics.samples_lost == statistics.gaps == 0
    assert not samples.status.any()


@pytest.mark.parametrize("slow", [0.3, 0.7])
def test_a_slow_emulator_is_no_loss(slow: float) -> None:
    numbers = np.arange(8000)
    samples, statistics = run(COUNTER, counter_blocks(numbers, 1, 10 + numbers / 2000 / slow, 40))
    np.testing.assert_allclose(samples.time_s, numbers / 2000, atol=1e-9)
    assert statistics.losses_estimated == statistics.gaps == 0


def test_damage_whose_bytes_are_accounted_for_is_no_loss_of_wraps() -> None:
    numbers = np.array([i for i in range(8000) if not 3010 <= i < 3015])
    blocks = counter_blocks(numbers, 1, 10 + numbers / 2000 / 0.9, 40)
    blocks[3010 // 40][0].skipped_before[3010 % 40] = 5.0
    samples, statistics = run(COUNTER, blocks)
    np.testing.assert_allclose(samples.time_s, numbers / 2000, atol=1e-9)
    assert statistics.samples_lost == 5
    assert statistics.losses_estimated == 0


def test_wraps_lost_amid_damage_are_put_where_the_damage_is() -> None:
    # 2000 samples are gone with part of a read: 208 by the counter, and the bytes of 3 passed over.
    numbers = np.concatenate([np.arange(3010), np.arange(5010, 9000)])
    blocks = counter_blocks(numbers, 1, 10 + numbers / 2000, 40)
    blocks[3010 // 40][0].skipped_before[3010 % 40] = 3.0
    samples, statistics = run(COUNTER, blocks)
    np.testing.assert_allclose(samples.time_s, numbers / 2000, atol=1e-9)
    assert statistics.samples_lost + statistics.losses_estimated == 2000
    assert np.flatnonzero(samples.status & GAP).tolist() == [3010]


def test_a_late_last_read_is_no_loss() -> None:
    numbers = np.arange(4000)
    arrival_s = 10 + numbers / 2000
    arrival_s[-40:] += 0.2
    samples, statistics = run(COUNTER, counter_blocks(numbers, 1, arrival_s, 40))
    np.testing.assert_allclose(samples.time_s, numbers / 2000, atol=1e-9)
    assert statistics.losses_estimated == 0


def test_without_arrival_times_nothing_is_estimated() -> None:
    numbers = np.arange(2000)
    samples, statistics = run(COUNTER, counter_blocks(numbers, 1, np.full(2000, np.nan), 40))
    assert len(samples) == 2000
    assert statistics.losses_estimated == 0
    assert statistics.rate_hz is None


def test_the_true_rate_is_measured() -> None:
    numbers = np.arange(60 * 1000)
    true_hz = 962.4
    arrival_s = 5 + numbers / true_hz + np.random.default_rng(0).exponential(0.004, len(numbers))
    _, statistics = run(
        ClockRule(counter_field="counter", counter_modulus=128, counter_ticks_per_s=1000.0, counter_steps=(1,)),
        [(block(numbers[at : at + 20] % 128), float(arrival_s[at + 19])) for at in range(0, len(numbers), 20)],
    )
    assert statistics.nominal_rate_hz == 1000
    assert statistics.rate_hz == pytest.approx(true_hz, rel=3e-4)
    assert statistics.losses_estimated == 0


def test_time_stamps_wrap_and_restart() -> None:
    ticks = np.concatenate([np.arange(40) * 100 + 2**32 - 1000, np.arange(20) * 100 + 5000]) % 2**32
    ticks[40:] = np.arange(20) * 100 + 7
    rule = ClockRule(time_field="time", time_modulus=2**32, time_ticks_per_s=1e4)
    for size in (60, 1, 7):
        samples, statistics = run(rule, [(block(ticks=ticks[at : at + size]), 0.0) for at in range(0, 60, size)])
        np.testing.assert_allclose(np.diff(samples.time_s), 0.01, atol=1e-9)
        assert samples.time_s[0] == (2**32 - 1000) / 1e4
        assert np.flatnonzero(samples.status & GAP).tolist() == [40]
        assert statistics.clock_resets == statistics.gaps == 1
        assert statistics.samples_lost == 0


COUNTED = ClockRule(counter_field="counter", counter_modulus=65536, rate_hz=100.0)
STAMPED = ClockRule(time_field="time", time_ticks_per_s=1000.0)
# Nobody told the rate of the counter.
BOTH = ClockRule(counter_field="counter", counter_modulus=2**32, time_field="time", time_ticks_per_s=1000.0)


def counted(
    counter: np.ndarray, arrival_s: np.ndarray, size: int, rule: ClockRule = COUNTED
) -> tuple[Samples, DecoderStatistics]:
    """Run samples at 100 Hz with a counter, a time of ten ticks a count, or both, read by ``size``; a block has two reads."""
    blocks = []
    for at in range(0, len(counter), 2 * size):
        part, counts = arrival_s[at : at + 2 * size], counter[at : at + 2 * size]
        ends = np.array(sorted({min(size, len(part)), len(part)}))
        ticks = counts * 10 if rule.time_field else None
        raw = block(counts % rule.counter_modulus if rule.counter_field else None, ticks)
        blocks.append((raw, Arrivals(ends, part[ends - 1])))
    statistics = DecoderStatistics()
    clock = SampleClock(rule, SampleUnits(), statistics)
    done = [*(clock.push(*each) for each in blocks), clock.flush()]
    return concatenate([samples for samples in done if samples is not None]), statistics


@pytest.mark.parametrize("size", [1, 5, 7])
@pytest.mark.parametrize("rule", [COUNTED, STAMPED, BOTH])
def test_an_instrument_that_begins_anew_is_a_gap_as_long_as_the_silence(rule: ClockRule, size: int) -> None:
    arrival_s = np.concatenate([np.arange(2870), np.arange(3000) + 3870]) / 100 + 50
    samples, statistics = counted(np.concatenate([np.arange(2870), np.arange(3000)]), arrival_s, size, rule)
    assert statistics.samples_lost == pytest.approx(1000, abs=2 * size)
    assert statistics.gaps == 1
    assert statistics.clock_resets == 0
    assert np.ptp(samples.time_s) == pytest.approx(68.69, abs=0.02 * size)
    (gap,) = np.flatnonzero(samples.status & GAP)
    assert gap == 2870
    assert int(samples.status[gap]) == Status.GAP_ESTIMATED


@pytest.mark.parametrize("rule", [COUNTED, STAMPED, BOTH])
def test_a_time_set_back_without_a_silence_is_no_loss(rule: ClockRule) -> None:
    numbers = np.concatenate([np.arange(2870) + 1000, np.arange(3000)])
    samples, statistics = counted(numbers, np.arange(5870) / 100 + 50, 7, rule)
    assert statistics.samples_lost == 0
    assert statistics.clock_resets == 1
    np.testing.assert_allclose(np.diff(samples.time_s), 0.01, atol=1e-9)
    assert np.flatnonzero(samples.status & Status.CLOCK_SET).tolist() == [2870]


@pytest.mark.parametrize("size", [1, 5, 7])
def test_counts_that_noise_has_made_invent_no_loss(size: int) -> None:
    counter = np.arange(6000)
    counter[[700, 2900, 2901, 4444]] += [30000, 500, 41000, 65000]
    samples, statistics = counted(counter, np.arange(6000) / 100 + 50, size)
    assert statistics.samples_lost == statistics.losses_estimated == 0
    np.testing.assert_allclose(np.diff(samples.time_s), 0.01, atol=1e-9)


@pytest.mark.parametrize("size", [1, 5, 7])
def test_a_counter_that_begins_anew_is_no_pause_of_months_where_nobody_noted_arrival(size: int) -> None:
    wide = replace(COUNTED, counter_modulus=1 << 32)
    numbers = np.concatenate([np.arange(2870) + 1000, np.arange(3000)])
    samples, statistics = counted(numbers, np.full(5870, np.nan), size, wide)
    np.testing.assert_allclose(np.diff(samples.time_s), 0.01, atol=1e-9)
    assert (statistics.lost, statistics.clock_resets) == (0, 1)
    assert np.flatnonzero(samples.status & Status.CLOCK_SET).tolist() == [2870]


def test_a_cable_that_was_out_for_longer_is_counted() -> None:
    numbers = np.concatenate([np.arange(3000), np.arange(3000) + 20000])
    samples, statistics = counted(numbers, numbers / 100 + 50, 5)
    assert statistics.samples_lost == 17000
    assert np.ptp(samples.time_s) == pytest.approx(229.99)


def test_a_clock_set_by_gnss_is_no_loss() -> None:
    stamps = np.concatenate([np.arange(30) * 0.01, 345600 + np.arange(30) * 0.01])
    samples, statistics = run(ClockRule(time_field="time"), [(block(ticks=stamps), 0.0)])
    assert statistics.samples_lost == 0
    assert statistics.clock_resets == 1
    assert samples.time_s[-1] < 1


def test_gaps_in_time_stamps_are_counted() -> None:
    numbers = np.array([i for i in range(200) if i not in (50, 51, 52, 120)])
    jitter = np.random.default_rng(4).uniform(-0.001, 0.001, len(numbers))
    samples, statistics = run(ClockRule(time_field="time"), [(block(ticks=numbers * 0.01 + jitter), 0.0)])
    assert statistics.samples_lost == 4
    assert statistics.gaps == 2
    assert np.flatnonzero(samples.status).tolist() == [50, 117]


def test_a_counter_counts_what_a_time_stamp_dates() -> None:
    numbers = np.array([i for i in range(100) if i != 40])
    rule = ClockRule(
        counter_field="counter",
        counter_modulus=65536,
        counter_ticks_per_s=0.0,
        counter_steps=(1,),
        time_field="time",
        time_modulus=0,
        time_ticks_per_s=1.0,
        rate_hz=100.0,
    )
    both = block(numbers + 65500, numbers * 0.5)
    both.counter[:] %= 65536
    samples, statistics = run(rule, [(both, 0.0)])
    np.testing.assert_array_equal(samples.time_s, numbers * 0.5)
    assert statistics.samples_lost == 1
    assert np.flatnonzero(samples.status).tolist() == [40]


@pytest.mark.parametrize("said_hz", [100.0, 50.0])
def test_without_any_clock_samples_follow_the_host(said_hz: float) -> None:
    true_hz, n = 104.0, 6000
    taken_s = 20 + np.arange(n) / true_hz
    rng = np.random.default_rng(8)
    blocks = [(block(n=5), float(taken_s[at + 4] + rng.exponential(0.005))) for at in range(0, n, 5)]
    samples, statistics = run(ClockRule(rate_hz=said_hz), blocks)
    assert len(samples) == n
    assert (np.diff(samples.time_s) > 0).all()
    assert np.abs(samples.time_s - taken_s)[1000:].max() < 0.03
    assert (samples.status & np.uint32(Status.TIME_ESTIMATED)).all()
    assert statistics.losses_estimated == 0
    assert statistics.rate_hz == pytest.approx(true_hz, rel=2e-3)


def test_without_any_clock_a_lasting_lag_is_a_gap() -> None:
    taken_s = np.concatenate([np.arange(1000) / 100, 14 + np.arange(1000) / 100])
    blocks = [(block(n=5), float(taken_s[at + 4])) for at in range(0, 2000, 5)]
    samples, statistics = run(ClockRule(rate_hz=100.0), blocks)
    np.testing.assert_allclose(samples.time_s, taken_s, atol=0.02)
    assert statistics.losses_estimated == pytest.approx(400, abs=3)
    assert np.flatnonzero(samples.status & np.uint32(Status.GAP_ESTIMATED)).tolist() == [1000]


@pytest.mark.parametrize("rule", [ClockRule(rate_hz=110.0), COUNTER], ids=["host", "counter"])
def test_times_behind_a_loss_do_not_depend_on_how_reads_are_joined(rule: ClockRule) -> None:
    numbers = np.concatenate([np.arange(8000), 8000 + 1024 + np.arange(8000)])
    taken_s = numbers / (rule.counter_ticks_per_s or 110.0)
    rng = np.random.default_rng(9)
    arrival_s = taken_s[4::5] + rng.exponential(0.0005, 3200)
    counter = numbers % 256 if rule.counter_field else np.full(16000, NO_COUNTER)
    alone, _ = run(rule, [(block(counter[at : at + 5]), each) for at, each in zip(range(0, 16000, 5), arrival_s, strict=True)])
    clock = SampleClock(rule, SampleUnits(), DecoderStatistics())
    arrivals = Arrivals(np.arange(5, 16001, 5), arrival_s)
    together = [samples for samples in (clock.push(block(counter), arrivals), clock.flush()) if samples is not None]
    assert (alone.status & np.uint32(Status.GAP_ESTIMATED)).any()
    np.testing.assert_array_equal(concatenate(together).time_s, alone.time_s)


def test_few_samples_come_out_at_the_end() -> None:
    for rule, one in (
        (COUNTER, block(np.array([5, 6]))),
        (ClockRule(time_field="t"), block(ticks=np.array([1.0, 2.0]))),
        (ClockRule(rate_hz=10.0), block(n=2)),
    ):
        samples, _ = run(rule, [(one, np.nan)])
        assert len(samples) == 2
        assert np.diff(samples.time_s)[0] > 0


@pytest.mark.parametrize("stamp_s", [np.floor(np.arange(3000) / 10) / 10, np.full(3000, 5.0)], ids=["tenths", "standing"])
def test_a_clock_too_coarse_for_its_samples_gives_way_to_that_of_the_host(stamp_s: np.ndarray) -> None:
    rule = ClockRule(time_field="time", time_ticks_per_s=1.0)
    arrival_s = 50 + np.arange(3000) / 100
    stamped = [(block(ticks=stamp_s[at : at + 10]), float(arrival_s[at + 9])) for at in range(0, 3000, 10)]
    samples, _ = run(rule, stamped)
    steps_s = np.diff(samples.time_s)
    np.testing.assert_allclose(np.median(steps_s), 0.01, rtol=0.02)
    assert steps_s.min() > 0
    # In fours they keep their own.
    fours = np.floor(np.arange(3000) / 4) / 25
    samples, _ = run(rule, [(block(ticks=fours[at : at + 10]), float(arrival_s[at + 9])) for at in range(0, 3000, 10)])
    assert np.array_equal(samples.time_s, fours)
