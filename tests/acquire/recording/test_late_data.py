"""A counter of 8 bits at 2000 Hz behind all kinds of cables and hosts: what is late is not lost, what is lost is counted.

No threads and no clocks: when each byte leaves the instrument, the cable and the buffers is computed, and what the host then
reads goes through the sample clock.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from imufield.acquire.clock.clock import Arrivals
from imufield.acquire.clock.sample_clock import SampleClock
from imufield.acquire.decode.assembly import RawBlock
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.samples import NO_COUNTER, FloatArray, IntArray, Samples, SampleUnits, Status, concatenate

RATE_HZ = 2000.0
WRAP = 256
READ_S = 0.02
GAP = np.uint32(Status.AFTER_GAP | Status.GAP_ESTIMATED)


@dataclass(frozen=True)
class Path:
    """What lies between instrument and program."""

    latency_steps: tuple[tuple[float, float], ...] = ()
    """From when on the cable is so much slower, s."""
    stalls: tuple[tuple[float, float], ...] = ()
    """Begin and length of times in which nothing comes through, s; all of it comes later."""
    drain: float = 10.0
    """How many times faster than it is made the data come through behind a stall."""
    batch_s: float = 0.0
    """The adapter hands over at such intervals, s."""
    jitter_s: float = 0.001
    drift: float = 0.0
    """By how much the instrument runs slow."""
    speed: float = 1.0
    """The host's clock goes as fast, and so do all its delays."""
    seed: int = 1

    def arrivals(self, numbers: IntArray) -> FloatArray:
        """Return when each sample can be read. Shape (n,)."""
        rng = np.random.default_rng(self.seed)
        at_s = 100.0 + numbers / RATE_HZ * (1 + self.drift) + self.speed * rng.exponential(self.jitter_s, len(numbers))
        for begin_s, more_s in self.latency_steps:
            at_s[at_s >= 100.0 + begin_s] += more_s
        at_s = np.maximum.accumulate(at_s)
        for begin_s, long_s in self.stalls:
            first = int(np.searchsorted(at_s, 100.0 + begin_s))
            earliest_s = 100.0 + begin_s + long_s + np.arange(len(at_s) - first) / (RATE_HZ * self.drain)
            at_s[first:] = np.maximum(at_s[first:], earliest_s)
        return np.ceil(at_s / self.batch_s) * self.batch_s if self.batch_s else at_s


def read(numbers: IntArray, path: Path, *, counter: bool = True) -> list[tuple[RawBlock, float]]:
    """Return what a host reads every 20 ms, and when."""
    at_s = path.arrivals(numbers)
    reads = np.ceil(at_s / READ_S).astype(int)
    edges = [0, *(np.flatnonzero(np.diff(reads)) + 1).tolist(), len(numbers)]
    return [
        (made(numbers[begin:end], counter=counter), READ_S * float(reads[begin])) for begin, end in itertools.pairwise(edges)
    ]


def made(numbers: IntArray, *, counter: bool) -> RawBlock:
    n = len(numbers)
    nothing = np.zeros(n)
    return RawBlock(
        accelerometer=np.zeros((n, 3)), gyroscope=np.zeros((n, 3)), temperature_degc=nothing,
        counter=numbers % WRAP if counter else np.full(n, NO_COUNTER), ticks=np.empty(0),
        status=np.zeros(n, dtype=np.uint32),
        lost_before=nothing.astype(int), skipped_before=nothing, stream_end=np.arange(1, n + 1),
    )  # fmt: skip


def run(reads: list[tuple[RawBlock, float]], *, counter: bool = True) -> tuple[Samples, DecoderStatistics]:
    statistics = DecoderStatistics()
    rule = (
        ClockRule(counter_field="counter", counter_modulus=WRAP, counter_ticks_per_s=RATE_HZ, counter_steps=(1,))
        if counter
        else ClockRule(rate_hz=RATE_HZ)
    )
    clock = SampleClock(rule, SampleUnits(), statistics)
    done = [clock.push(block, Arrivals(np.array([len(block)]), np.array([at_s]))) for block, at_s in reads]
    samples = concatenate([part for part in (*done, clock.flush()) if part is not None])
    assert (np.diff(samples.time_s) > 0).all()
    return samples, statistics


def assert_nothing_is_missing(path: Path, seconds: float = 20.0) -> None:
    # What the clock remembers of arrivals is 4 s long: it has forgotten its beginning before anything happens, and it has
    # time to change its mind behind.
    numbers = np.arange(int(seconds * RATE_HZ))
    samples, statistics = run(read(numbers, path))
    np.testing.assert_allclose(samples.time_s, numbers / RATE_HZ, atol=1e-9)
    assert (statistics.losses_estimated, statistics.samples_lost, statistics.gaps) == (0, 0, 0)
    assert not samples.status.any()


@pytest.mark.parametrize("step_s", [0.05, 0.1, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("back_after_s", [0.6, 2.0, 8.0, 100.0])
def test_a_cable_that_becomes_slower_loses_nothing(step_s: float, back_after_s: float) -> None:
    # Bytes stay in order, so a cable that is fast again first has to give out what it holds.
    assert_nothing_is_missing(Path(latency_steps=((6.0, step_s), (6.0 + back_after_s, -step_s))))


@pytest.mark.parametrize("drain", [1.02, 1.2, 10.0, 1e6])
@pytest.mark.parametrize("long_s", [0.1, 0.128, 0.5, 1.0, 5.0])
def test_a_stall_loses_nothing_however_slowly_the_rest_comes(long_s: float, drain: float) -> None:
    assert_nothing_is_missing(Path(stalls=((6.0, long_s), (13.3, long_s / 2)), drain=drain))


@pytest.mark.parametrize("batch_s", [0.016, 0.1, 0.13, 0.3])
@pytest.mark.parametrize("drift", [0.0, 1e-4, -1e-4, 0.038, -0.03])
def test_batches_and_drifting_clocks_lose_nothing(batch_s: float, drift: float) -> None:
    assert_nothing_is_missing(Path(batch_s=batch_s, drift=drift, latency_steps=((10.0, 0.1),)))


@pytest.mark.parametrize("seed", range(6))
def test_a_fast_clock_on_a_loaded_machine_loses_nothing(seed: int) -> None:
    # Eight times as fast: a delay of 30 ms is one of 0.24 s. The machine is slow for a while, again and again.
    rng = np.random.default_rng(seed)
    stalls = tuple((float(at_s), float(8 * rng.exponential(0.06))) for at_s in np.sort(rng.uniform(3, 27, 28)))
    assert_nothing_is_missing(Path(stalls=stalls, drain=1.3, speed=8.0, jitter_s=0.004, seed=seed), 30.0)


CLEAN = Path()
ROUGH = Path(batch_s=0.016, jitter_s=0.003, drift=1e-4, stalls=((4.0, 0.4), (13.0, 1.0)))


@pytest.mark.parametrize("wraps", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("rest", [0, 1, 100, 255])
@pytest.mark.parametrize("path", [CLEAN, ROUGH], ids=["clean", "rough"])
def test_every_loss_is_counted(wraps: int, rest: int, path: Path) -> None:
    lost = wraps * WRAP + rest
    numbers = np.concatenate([np.arange(16_000), np.arange(16_000 + lost, 36_000)])
    samples, statistics = run(read(numbers, path))
    np.testing.assert_allclose(samples.time_s, numbers / RATE_HZ, atol=1e-9)
    assert statistics.losses_estimated == wraps * WRAP
    assert statistics.samples_lost == rest
    assert np.flatnonzero(samples.status & GAP).tolist() == [16_000]


def test_two_losses_are_counted_apart() -> None:
    numbers = np.concatenate([np.arange(20_000), np.arange(20_500, 30_000), np.arange(31_111, 60_000)])
    samples, statistics = run(read(numbers, CLEAN))
    np.testing.assert_allclose(samples.time_s, numbers / RATE_HZ, atol=1e-9)
    assert statistics.losses_estimated + statistics.samples_lost == 500 + 1111
    assert statistics.gaps == 2


@pytest.mark.parametrize("long_s", [1.0, 2.0, 5.0])
def test_a_buffer_that_overflows_while_the_host_stands_still_loses_what_is_over(long_s: float) -> None:
    # The system keeps 0.86 s of it; what comes then is dropped until the host reads again.
    first, until = 24_000, 24_000 + int(long_s * RATE_HZ)
    kept = first + 1720
    numbers = np.concatenate([np.arange(kept), np.arange(until, 80_000)])
    # The host's first read is of everything that was kept.
    samples, statistics = run(read(numbers, Path(stalls=((first / RATE_HZ, long_s),), drain=1e6)))
    np.testing.assert_allclose(samples.time_s, numbers / RATE_HZ, atol=1e-9)
    assert statistics.losses_estimated + statistics.samples_lost == until - kept
    assert np.flatnonzero(samples.status & GAP).tolist() == [kept]


def test_a_cable_slower_by_just_a_wrap_is_taken_for_a_loss_until_it_is_fast_again() -> None:
    numbers = np.arange(80_000)
    slow = ((10.0, WRAP / RATE_HZ),)
    samples, statistics = run(read(numbers, Path(latency_steps=slow)))
    assert statistics.losses_estimated == WRAP
    assert np.count_nonzero(samples.status & np.uint32(Status.GAP_ESTIMATED)) == 1
    _, statistics = run(read(numbers, Path(latency_steps=(*slow, (25.0, -WRAP / RATE_HZ)))))
    assert statistics.losses_estimated == 0


@pytest.mark.parametrize("path", [CLEAN, ROUGH], ids=["clean", "rough"])
def test_reads_that_are_cut_change_nothing(path: Path) -> None:
    numbers = np.concatenate([np.arange(24_000), np.arange(24_700, 60_000)])
    reads = read(numbers, path)
    whole, statistics = run(reads)
    rng = np.random.default_rng(5)
    pieces = [
        (block[begin:end], at_s)
        for block, at_s in reads
        for begin, end in itertools.pairwise([0, *sorted({*rng.integers(1, len(block) + 1, 2).tolist(), len(block)})])
    ]
    cut, again = run(pieces)
    np.testing.assert_allclose(cut.time_s, whole.time_s, rtol=1e-14)
    np.testing.assert_array_equal(cut.status, whole.status)
    assert (again.losses_estimated, again.samples_lost, again.gaps) == (
        statistics.losses_estimated, statistics.samples_lost, statistics.gaps,
    )  # fmt: skip


@pytest.mark.parametrize("path", [Path(stalls=((10.0, 3.0),), drain=1.2), Path(latency_steps=((10.0, 0.4),)), ROUGH])
def test_without_a_counter_late_data_are_no_loss_either(path: Path) -> None:
    numbers = np.arange(60_000)
    samples, statistics = run(read(numbers, path, counter=False), counter=False)
    assert (statistics.losses_estimated, statistics.gaps) == (0, 0)
    assert np.abs(np.diff(samples.time_s) * RATE_HZ - 1).max() < 0.2


def test_without_a_counter_a_long_silence_is_a_loss() -> None:
    numbers = np.concatenate([np.arange(20_000), np.arange(24_000, 60_000)])
    samples, statistics = run(read(numbers, ROUGH, counter=False), counter=False)
    assert statistics.losses_estimated == pytest.approx(4000, abs=60)
    np.testing.assert_allclose(np.diff(samples.time_s[[1000, -1000]]), np.diff(numbers[[1000, -1000]]) / RATE_HZ, atol=0.05)
