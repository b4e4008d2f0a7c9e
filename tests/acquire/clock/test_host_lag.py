"""Which lag is a loss."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.acquire.clock.host_lag import LossWatch, TimedBlock
from imufield.acquire.decode.assembly import RawBlock

WRAP_S = 0.128


def timed(first_s: float, arrival_s: float, *, fault: bool = False) -> TimedBlock:
    """Return a block of 20 ms."""
    n = 40
    nothing = np.zeros(n)
    block = RawBlock(
        accelerometer=np.zeros((n, 3)), gyroscope=np.zeros((n, 3)), temperature_degc=nothing, counter=nothing.astype(int),
        ticks=np.empty(0), status=np.zeros(n, dtype=np.uint32),
        lost_before=nothing.astype(int), skipped_before=nothing, stream_end=nothing.astype(int),
    )  # fmt: skip
    faults = np.zeros(n, dtype=np.bool_)
    faults[7] = fault
    return TimedBlock(
        block=block, time_s=first_s + np.arange(n) / 2000, flags=np.zeros(n, dtype=np.uint32), fault=faults, arrival_s=arrival_s
    )


@pytest.fixture
def watch() -> LossWatch:
    watch = LossWatch(WRAP_S, WRAP_S / 2)
    for number in range(100):
        assert len(watch.push(timed(number * 0.02, 5.02 + number * 0.02))) == 1
    return watch


def late(watch: LossWatch, lag_s: float, *, fault: bool, silence_s: float, reads: int = 300) -> int:
    """Feed blocks behind ``silence_s`` without any, all late by ``lag_s``; return how many were held before one came out."""
    for number in range(reads):
        taken_s = 2 + silence_s - lag_s + number * 0.02
        if watch.push(timed(taken_s, 5.02 + taken_s + lag_s, fault=fault and number == 0)):
            return number
    return reads


def test_with_a_fault_loss_is_settled_after_a_second(watch: LossWatch) -> None:
    blocks = [timed(2 + n * 0.02, 7.02 + n * 0.02 + 2 * WRAP_S, fault=n == 1) for n in range(60)]
    held = [len(watch.push(block)) for block in blocks]
    assert held.index(max(held)) == 51
    assert held[51] == 52
    assert watch.lost_units == 2
    assert blocks[0].time_s[-1] == pytest.approx(2 + 39 / 2000)
    assert blocks[1].time_s[6] == pytest.approx(2.02 + 6 / 2000)
    assert blocks[1].time_s[7] == pytest.approx(2.02 + 7 / 2000 + 2 * WRAP_S)
    assert watch.gaps == 1


def test_with_a_silence_it_takes_three_seconds(watch: LossWatch) -> None:
    assert late(watch, WRAP_S, fault=False, silence_s=WRAP_S) == 150
    assert watch.lost_units == 1


@pytest.mark.parametrize("lag_s", [0.07, 0.1, 0.15, 0.2, 0.3, 0.5])
def test_a_slower_cable_is_no_loss(watch: LossWatch, lag_s: float) -> None:
    assert late(watch, lag_s, fault=False, silence_s=lag_s) in (200, 201)
    assert watch.lost_units == watch.gaps == 0
    # From now on this is how late it must be.
    assert watch.passes(20.0 + lag_s, 14.98)


def test_without_a_silence_nothing_is_missing(watch: LossWatch) -> None:
    assert late(watch, WRAP_S, fault=False, silence_s=0.02) == 200
    assert watch.lost_units == 0


def test_a_slow_clock_is_no_loss(watch: LossWatch) -> None:
    for number in range(1000):
        watch.push(timed(2 + number * 0.02, 7.02 + number * 0.03))
    assert watch.lost_units == watch.gaps == 0


def test_a_restart_is_as_long_as_the_silence(watch: LossWatch) -> None:
    late(watch, 1.0, fault=True, silence_s=1.0)
    assert watch.lost_units == 8


def test_late_data_come_out_when_the_lag_is_gone_however_long_that_takes(watch: LossWatch) -> None:
    lags_s = np.linspace(4.0, 0.01, 1000)
    out = [len(watch.push(timed(2 + n * 0.02, 7.02 + n * 0.02 + lag_s))) for n, lag_s in enumerate(lags_s.tolist())]
    assert np.flatnonzero(out)[0] == np.flatnonzero(lags_s <= WRAP_S / 2)[0]
    assert sum(out) == 1000
    assert watch.lost_units == 0


def test_an_arrival_that_is_too_early_disproves_a_loss(watch: LossWatch) -> None:
    late(watch, 2 * WRAP_S, fault=False, silence_s=2 * WRAP_S)
    assert watch.lost_units == 2
    # The cable was slow by just two wraps, and is no longer: with the loss in the time, bytes come before they were sent.
    assert not watch.passes(20.0, 15.0 - 0.02 + 2 * WRAP_S)
    assert len(watch.push(timed(14.96 + 2 * WRAP_S, 20.0))) == 1
    assert watch.units_taken_back == 2


def test_at_the_end_a_fault_needs_a_quarter_second(watch: LossWatch) -> None:
    assert watch.push(timed(2, 7.02 + WRAP_S, fault=True)) == []
    assert len(watch.finish()) == 1
    assert watch.lost_units == 0
    for number in range(20):
        assert watch.push(timed(2.02 + number * 0.02, 7.04 + number * 0.02 + WRAP_S, fault=number == 0)) == []
    assert len(watch.finish()) == 20
    assert watch.lost_units == 1


def test_blocks_without_arrival_pass(watch: LossWatch) -> None:
    assert watch.push(timed(2, 7.3)) == []
    assert len(watch.push(timed(2.02, math.nan))) == 2
    assert watch.passes(math.nan, 3.0)
