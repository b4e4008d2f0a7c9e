"""Which lag is a loss."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.acquire.assembly import RawBlock
from imufield.acquire.loss_watch import LossWatch, TimedBlock

WRAP_S = 0.128


def timed(first_s: float, arrival_s: float, *, fault: bool = False) -> TimedBlock:
    """Return a block of 20 ms."""
    n = 40
    nothing = np.zeros(n)
    block = RawBlock(
        np.zeros((n, 3)), np.zeros((n, 3)), nothing, nothing.astype(int), np.empty(0), np.zeros(n, dtype=np.uint32),
        nothing.astype(int), nothing, nothing.astype(int),
    )  # fmt: skip
    faults = np.zeros(n, dtype=np.bool_)
    faults[7] = fault
    return TimedBlock(block, first_s + np.arange(n) / 2000, np.zeros(n, dtype=np.uint32), faults, arrival_s)


@pytest.fixture
def watch() -> LossWatch:
    watch = LossWatch(WRAP_S, WRAP_S / 2)
    for number in range(100):
        assert len(watch.push(timed(number * 0.02, 5.02 + number * 0.02))) == 1
    return watch


def settle(watch: LossWatch, lag_s: float, *, fault: bool, silence_s: float = 0.02, reads: int = 40) -> int:
    """Feed late blocks; return how many came out before the first decision."""
    out = 0
    for number in range(reads):
        arrival_s = 7.0 + silence_s + number * 0.02
        out += len(
            watch.push(timed(2 + number * 0.02, max(arrival_s, 7.02 + number * 0.02 + lag_s), fault=fault and number == 0))
        )
    return out


def test_with_a_fault_loss_is_settled_after_a_quarter_second(watch: LossWatch) -> None:
    blocks = [timed(2 + n * 0.02, 7.02 + n * 0.02 + 0.26, fault=n == 1) for n in range(14)]
    held = [watch.push(block) for block in blocks]
    assert [len(out) for out in held] == [0] * 13 + [14]
    assert watch.lost_units == 2
    assert blocks[0].time_s[-1] == pytest.approx(2 + 39 / 2000)
    assert blocks[1].time_s[6] == pytest.approx(2.02 + 6 / 2000)
    assert blocks[1].time_s[7] == pytest.approx(2.02 + 7 / 2000 + 2 * WRAP_S)
    assert watch.gaps == 1


def test_with_a_silence_it_takes_half_a_second(watch: LossWatch) -> None:
    assert settle(watch, 0.13, fault=False, silence_s=0.13 + 0.02, reads=25) == 0
    assert settle(watch, 0.13, fault=False, silence_s=0.13 + 0.02 + 0.5, reads=1) == 26
    assert watch.lost_units == 1


def test_with_neither_it_is_a_slow_clock(watch: LossWatch) -> None:
    settle(watch, 0.0, fault=False)
    for number in range(200):
        watch.push(timed(2.8 + number * 0.02, 7.82 + number * 0.03))
    assert watch.lost_units == watch.gaps == 0


def test_at_the_end_only_a_fault_or_a_long_lag_counts(watch: LossWatch) -> None:
    assert watch.push(timed(2, 7.02 + 0.2)) == []
    assert len(watch.finish()) == 1
    assert watch.lost_units == 0
    assert watch.push(timed(2.02, 7.04 + 0.2, fault=True)) == []
    assert len(watch.finish()) == 1
    assert watch.lost_units == 2


def test_blocks_without_arrival_pass(watch: LossWatch) -> None:
    assert watch.push(timed(2, 7.3)) == []
    assert len(watch.push(timed(2.02, math.nan))) == 2
    assert watch.passes(math.nan, 3.0)
