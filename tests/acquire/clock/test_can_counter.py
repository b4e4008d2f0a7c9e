"""The counter of a bus against time stamps: where it restarts is learned, losses are none of that, and what is no counter."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imufield.acquire.decode.statistics import remarks
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.samples import NO_COUNTER, IntArray, Status
from tests.acquire.clock.test_can_clock import bursty, jitter, run
from tests.told import told


@pytest.mark.parametrize(
    ("first", "last", "bits"),
    [(0, 14, 4), (1, 15, 4), (5, 12, 4), (0, 199, 8), (1, 255, 8), (20, 59, 8), (100, 199, 8), (0, 2, 2)],
)
def test_a_counter_that_begins_anew_where_no_file_says_is_learned(first: int, last: int, bits: int) -> None:
    count = last - first + 1
    kept = np.delete(np.arange(8000), [1700, 5100, 5101])
    _, statistics = run(kept / 100.0, counter=first + kept % count, modulus=1 << bits, block=8000)
    assert statistics.lost == 3
    # Live, from the fifth round on.
    _, statistics = run(kept / 100.0, counter=first + kept % count, modulus=1 << bits, block=7)
    assert 3 <= statistics.lost <= 3 + 4 * ((1 << bits) - count)


@pytest.mark.parametrize(
    "counter",
    [
        pytest.param(np.full(8000, 7), id="stands"),
        pytest.param(-np.arange(8000) % 16, id="runs back"),
        pytest.param(10 * np.arange(8000) % 256, id="counts something else"),
        pytest.param(np.random.default_rng(1).integers(0, 256, 8000), id="is none"),
        pytest.param(np.arange(8000) // 2 % 256, id="counts every second"),
        pytest.param(np.arange(8000) // 3 % 256, id="counts every third"),
    ],
)
@pytest.mark.parametrize("block", [7, 8000])
def test_a_counter_that_counts_no_samples_is_not_used_and_told(counter: IntArray, block: int) -> None:
    kept = np.delete(np.arange(8000), range(4000, 4010))
    samples, statistics = run(kept / 100.0, counter=counter[kept], modulus=16 if counter.max() < 16 else 256, block=block)
    assert (statistics.samples_lost, statistics.losses_estimated) == (0, 10)
    assert samples.time_s[-1] - samples.time_s[0] == pytest.approx(79.99, abs=0.02)
    assert told(remarks([statistics]), "statistics.no_count")


@pytest.mark.parametrize("block", [1, 9, 4000])
def test_a_counter_that_begins_at_one_loses_nothing_where_it_does(block: int) -> None:
    kept = np.delete(np.arange(3000), [1700, 2100, 2101])
    _, statistics = run(kept / 100.0, counter=1 + kept % 15, modulus=15, block=block)
    assert (statistics.samples_lost, statistics.losses_estimated) == (3, 0)


def lost_at(name: str) -> NDArray[np.bool_]:
    """Return which of 12,000 samples are lost, by the place of their count in a round of 15."""
    count, at = np.arange(12_000) % 15, np.arange(12_000)
    return {
        "the last of eight rounds": (count == 14) & (at > 3000) & (at < 3120),
        "the last for a minute": (count == 14) & (at > 3000) & (at < 9000),
        "each fourth": at % 4 == 3,
        "one of five": np.random.default_rng(3).random(12_000) < 0.2,
    }[name]


@pytest.mark.parametrize("name", ["the last of eight rounds", "the last for a minute", "each fourth", "one of five"])
@pytest.mark.parametrize("modulus", [15, 16])
@pytest.mark.parametrize("block", [7, 12_000])
def test_losses_at_one_place_are_no_restart(name: str, modulus: int, block: int) -> None:
    kept = np.flatnonzero(~lost_at(name))
    _, statistics = run(kept / 100.0 + jitter(len(kept), 2e-4), counter=kept % modulus, modulus=modulus, block=block)
    assert statistics.lost == (np.diff(kept) - 1).sum()
    assert statistics.rate_hz == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(("name", "burst_s"), [("none", 0.016), ("one of five", 0.0), ("one of five", 0.016)])
@pytest.mark.parametrize("block", [7, 12_000])
def test_bursts_and_losses_hide_no_restart_that_seems_to_lose_much_more(name: str, burst_s: float, block: int) -> None:
    kept = np.arange(12_000) if name == "none" else np.flatnonzero(~lost_at(name))
    stamp_s = bursty(kept / 100.0, burst_s) if burst_s else kept / 100.0 + jitter(len(kept), 5e-4)
    samples, statistics = run(stamp_s, counter=kept % 200, modulus=256, block=block)
    # Live, of the rounds before it is learned 56 each are invented: six without losses, of bursts, of eight.
    invented = statistics.lost - int((np.diff(kept) - 1).sum())
    assert invented == 0 if block == 12_000 else 0 <= invented <= 20 * 56
    late = len(samples.time_s) // 2
    error_s = samples.time_s[late:] - kept[late:] / 100.0
    assert np.ptp(error_s) < max(2 * burst_s, 0.005)


@pytest.mark.parametrize("block", [7, 10_000])
def test_a_restart_of_the_instrument_does_not_widen_what_is_learned(block: int) -> None:
    # From 20 to 59 in 8 bits; once the instrument begins with 0.
    counter = np.concatenate([np.arange(20, 60), np.arange(20, 45), np.arange(60), 20 + np.arange(8000) % 40])
    _, statistics = run(np.arange(len(counter)) / 100.0, counter=counter, modulus=256, block=block)
    assert statistics.lost <= (0 if block == 10_000 else 4 * (256 - 40))


@pytest.mark.parametrize(("rate_hz", "late_s"), [(100.0, 1.5e-3), (200.0, 8e-4), (500.0, 3e-4)])
def test_delays_of_a_busy_host_hide_no_restart(rate_hz: float, late_s: float) -> None:
    delay_s = np.random.default_rng(5).exponential(late_s, 20_000)
    stamp_s = np.sort(np.arange(20_000) / rate_hz + delay_s)
    _, statistics = run(stamp_s, counter=np.arange(20_000) % 15, modulus=16, block=20_000)
    assert statistics.lost == 0
    assert statistics.rate_hz == pytest.approx(rate_hz, rel=1e-3)


@pytest.mark.parametrize(
    ("rate_hz", "burst_s", "lost", "modulus"), [(1000.0, 0.06, 4, 256), (200.0, 0.016, 4, 16), (50.0, 0.06, 8, 256)]
)
@pytest.mark.parametrize("block", [50, 20_000])
def test_losses_at_each_wrap_in_bursts_are_no_restart(
    rate_hz: float, burst_s: float, lost: int, modulus: int, block: int
) -> None:
    count = np.arange(20_000)
    kept = count[count % modulus < modulus - lost]
    _, statistics = run(bursty(kept / rate_hz, burst_s), counter=kept % modulus, modulus=modulus, block=block)
    assert statistics.lost == (np.diff(kept) - 1).sum()


@pytest.mark.parametrize("modulus", [16, 256])
def test_a_step_of_two_is_no_loss_at_the_restart(modulus: int) -> None:
    _, statistics = run(np.arange(4000) / 100.0, counter=2 * np.arange(4000) % modulus, modulus=modulus, steps=(1, 2))
    assert statistics.lost == 0
    assert statistics.rate_hz == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_copies_of_frames_do_not_switch_the_counter_off(share: float) -> None:
    twice = 1 + (np.random.default_rng(2).random(4000) < share)
    number = np.repeat(np.arange(4000), twice)
    stamp_s = number / 100.0 + 2e-4 * np.concatenate([[0], np.diff(number) == 0])
    _, statistics = run(stamp_s, counter=number % 256, modulus=256, block=4000)
    assert not told(remarks([statistics]), "statistics.no_count")
    assert statistics.rate_hz == pytest.approx(100.0, rel=1e-3)


def test_of_stamps_in_bursts_no_restart_that_loses_one_count_is_learned() -> None:
    kept = np.flatnonzero(~lost_at("the last for a minute"))
    _, statistics = run(bursty(kept / 100.0, 0.05), counter=kept % 15, modulus=15)
    assert statistics.lost == (np.diff(kept) - 1).sum()


@pytest.mark.parametrize(
    ("bits", "stood", "behind", "silent"),
    [(16, 2999, 0, 1000), (16, 60000, 0, 1000), (16, 60000, 0, 0), (16, 100, 20000, 0), (8, 200, 0, 0)],
)
@pytest.mark.parametrize("block", [7, 8000])
def test_an_instrument_that_begins_anew_lacks_what_the_stamps_show(
    bits: int, stood: int, behind: int, silent: int, block: int
) -> None:
    n, number = 3000, np.arange(3000)
    counter = np.concatenate([stood - n + 1 + number, behind + number]) % (1 << bits)
    true_s = np.concatenate([number, n + silent + number]) / 100.0
    samples, statistics = run(true_s + jitter(2 * n, 2e-4), counter=counter, modulus=1 << bits, block=block)
    assert (statistics.samples_lost, statistics.losses_estimated) == (0, silent)
    assert np.flatnonzero(samples.status & np.uint32(Status.GAP_ESTIMATED)).tolist() == [n] * bool(silent)
    np.testing.assert_allclose(samples.time_s, true_s, atol=1e-3)
    # As many samples passed.
    assert statistics.rate_hz == pytest.approx(100.0, rel=1e-5)


@pytest.mark.parametrize("block", [7, 8000])
def test_a_frame_that_another_has_overtaken_is_no_restart(block: int) -> None:
    counter = np.arange(3000)
    counter[[500, 501, 900, 902]] = counter[[501, 500, 902, 900]]
    samples, statistics = run(np.arange(3000) / 100.0, counter=counter, modulus=1 << 16, block=block)
    assert statistics.losses_estimated == 0
    np.testing.assert_allclose(samples.time_s, np.arange(3000) / 100.0, atol=0.05)


@pytest.mark.parametrize(("bits", "lost"), [(4, 15), (4, 31), (8, 255), (2, 3)])
def test_a_rate_has_in_it_what_a_loss_of_a_round_but_one_hides(bits: int, lost: int) -> None:
    number = np.arange(6000)
    number += lost * (number // 500)
    _, statistics = run(number / 100.0, counter=number % (1 << bits), modulus=1 << bits)
    assert (statistics.samples_lost, statistics.losses_estimated) == (0, 11 * lost)
    assert statistics.rate_hz == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("block", [7, 8000])
def test_a_counter_of_every_second_sample_tells_no_loss(seed: int, block: int) -> None:
    rng = np.random.default_rng(seed)
    number = np.flatnonzero(rng.random(2400) > 0.03)
    counter = np.where((number % 2 == 0) & (rng.random(len(number)) > 0.03), number // 2 % 256, NO_COUNTER)
    _, statistics = run(number / 200.0, counter=counter, modulus=256, block=block)
    assert statistics.samples_lost == 0
    assert statistics.losses_estimated == pytest.approx(number[-1] + 1 - len(number), abs=3)
    assert told(remarks([statistics]), "statistics.no_count")


@pytest.mark.parametrize("block", [7, 8000])
@pytest.mark.parametrize(
    ("lost", "burst_s", "rate_hz"),
    [pytest.param(30_000, 0.0, 0.0, id="late stamps"), pytest.param(3_000, 0.02, 99.0, id="a nominal rate and bursts")],
)
def test_an_outage_of_a_bus_whose_period_is_not_quite_known_is_no_restart(
    lost: int, burst_s: float, rate_hz: float, block: int
) -> None:
    number = np.arange(3000)
    number[1500:] += lost
    stamp_s = bursty(number / 100.0, burst_s) if burst_s else number / 100.0 + jitter(3000, 1e-3)
    rule = ClockRule(counter_modulus=1 << 16, rate_hz=rate_hz)
    _, statistics = run(stamp_s, counter=number % (1 << 16), rule=rule, block=block)
    assert (statistics.samples_lost, statistics.losses_estimated) == (lost, 0)
    assert statistics.rate_hz == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize("block", [5, 30, 8000])
@pytest.mark.parametrize("quiet_s", [0.0, 0.3, 1.0])
def test_what_is_lost_behind_frames_that_a_host_handed_over_late_is_counted(quiet_s: float, block: int) -> None:
    number = np.arange(3000)
    lost = (number >= 1100) & (number < 1300 + 100 * quiet_s)
    stamp_s = np.where((number >= 1000) & (number < 1100), 13.0, number / 100.0)
    _, statistics = run(stamp_s[~lost], counter=number[~lost], modulus=1 << 16, block=block)
    assert (statistics.samples_lost, statistics.losses_estimated) == (int(lost.sum()), 0)
