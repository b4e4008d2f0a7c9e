"""Time of samples from time stamps of frames: losses found and not invented, bursts smoothed, wraps counted."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from imufield.acquire.clock.can_clock import CanClock, _minimum_ahead, _Phase
from imufield.acquire.clock.can_sent_time import CanSentTime
from imufield.acquire.clock.clock import Arrivals
from imufield.acquire.decode.assembly import RawBlock
from imufield.acquire.decode.statistics import DecoderStatistics, remarks
from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.protocol.samples_and_clock import ClockRule
from imufield.samples import NO_COUNTER, FloatArray, IntArray, Samples, SampleUnits, Status, concatenate
from imufield.simulate.wire.can_frames import CanEncoder
from tests.acquire.plain_frames import pack_frames
from tests.simulate.accounting import random_samples

NEVER = Arrivals(np.array([0]), np.array([np.nan]))


def run(
    stamp_s: FloatArray,
    *,
    counter: IntArray | None = None,
    modulus: int = 0,
    ticks: FloatArray | None = None,
    rule: ClockRule | None = None,
    block: int = 50,
    steps: tuple[int, ...] = (1,),
) -> tuple[Samples, DecoderStatistics]:
    n = len(stamp_s)
    statistics = DecoderStatistics()
    rule = rule or ClockRule(counter_modulus=modulus, counter_steps=steps)
    clock = (CanClock if ticks is None else CanSentTime)(rule, SampleUnits(), statistics)
    values = np.zeros((n, 7))
    values[:, 0] = np.arange(n)
    whole = RawBlock(
        accelerometer=values[:, :3],
        gyroscope=values[:, 3:6],
        temperature_degc=values[:, 6],
        status=np.zeros(n, dtype=np.uint32),
        counter=np.full(n, NO_COUNTER) if counter is None else counter,
        ticks=np.empty(0) if ticks is None else ticks,
        stamp_s=stamp_s,
    )
    parts = [clock.push(whole[at : at + block], NEVER) for at in range(0, n, block)]
    samples = concatenate([part for part in (*parts, clock.flush()) if part is not None])
    assert samples.accelerometer[:, 0].tolist() == list(range(n)), "every sample comes out once, in order"
    return samples, statistics


def bursty(true_s: FloatArray, burst_s: float, phase_s: float = 0.0) -> FloatArray:
    """Return when a host that looks every ``burst_s`` sees what happened before."""
    return np.ceil((true_s + phase_s) / burst_s) * burst_s - phase_s


def jitter(n: int, scale_s: float, seed: int = 1) -> NDArray[np.float64]:
    return np.random.default_rng(seed).exponential(scale_s, n)


@pytest.mark.parametrize("rate_hz", [10.0, 97.3, 1000.0])
def test_regular_stamps(rate_hz: float) -> None:
    true_s = 5.0 + np.arange(int(6 * rate_hz)) / rate_hz
    samples, statistics = run(true_s + jitter(len(true_s), 0.02 / rate_hz))
    np.testing.assert_allclose(samples.time_s, true_s, atol=0.1 / rate_hz)
    assert (statistics.gaps, statistics.losses_estimated, statistics.samples_lost) == (0, 0, 0)
    assert statistics.rate_hz == pytest.approx(rate_hz, rel=1e-3)
    assert (samples.status == Status.TIME_ESTIMATED).all()


@pytest.mark.parametrize("block", [1, 7, 50, 100_000])
def test_single_losses_are_counted_where_stamps_are_good(block: int) -> None:
    rng = np.random.default_rng(3)
    kept = np.sort(rng.permutation(5000)[: 5000 - 60])
    kept = kept[kept > 200] if block == 1 else kept
    true_s = kept / 100.0
    samples, statistics = run(true_s + jitter(len(true_s), 2e-4), block=block)
    missing = np.diff(kept, prepend=kept[0] - 1) - 1
    missing[0] = 0
    assert statistics.losses_estimated == missing.sum()
    assert ((samples.status & Status.GAP_ESTIMATED) != 0).tolist() == (missing > 0).tolist()
    np.testing.assert_allclose(samples.time_s, true_s, atol=2e-3)


def test_bursts_are_no_losses() -> None:
    true_s = 1.0 + np.arange(20_000) / 1000.0
    samples, statistics = run(bursty(true_s, 0.020) + jitter(len(true_s), 1e-4), block=40)
    assert (statistics.gaps, statistics.losses_estimated) == (0, 0)
    assert np.diff(samples.time_s).min() > 0
    # Even steps, at most one period behind the truth.
    late_s = samples.time_s - true_s
    assert late_s.max() - late_s.min() < 0.003


def test_a_host_that_sleeps_for_a_tenth_of_a_second_loses_nothing() -> None:
    true_s = 1.0 + np.arange(8000) / 1000.0
    stamp_s = true_s.copy()
    for begin in (2500, 4000, 6100):
        stamp_s[begin : begin + 100] = true_s[begin + 100]
    samples, statistics = run(stamp_s, block=20)
    assert statistics.losses_estimated == 0
    np.testing.assert_allclose(samples.time_s, true_s, atol=1e-3)


def fast_host(true_s: FloatArray, seed: int, speed: float = 8.0) -> FloatArray:
    """Return what a host stamps that counts its own time ``speed`` times fast, and sleeps in every twentieth look."""
    rng = np.random.default_rng(seed)
    looks = round((true_s[-1] + 5.0) / (speed * 0.008))
    sleeps_s = np.where(rng.random(looks) < 0.05, rng.uniform(0.02, 0.12, looks), 0.0)
    edges_s = np.cumsum(speed * (0.008 + rng.exponential(0.002, looks) + sleeps_s))
    place = np.searchsorted(edges_s, true_s)
    # Frames of one look are stamped one behind another.
    return np.asarray(edges_s[place] + speed * 3e-5 * (np.arange(len(true_s)) - np.searchsorted(place, place)))


@pytest.mark.parametrize("begin_s", [0.4, 0.9, 1.7, 2.3])
@pytest.mark.parametrize("seed", range(3))
def test_an_outage_while_the_rate_is_learned_does_not_teach_a_slower_one(begin_s: float, seed: int) -> None:
    even_s = np.arange(2000) / 100.0
    true_s = even_s[(even_s < begin_s) | (even_s >= begin_s + 1.0)]
    stamp_s = bursty(true_s, 0.021, 0.003 * seed) + jitter(len(true_s), 1e-3, seed)
    samples, statistics = run(np.maximum.accumulate(stamp_s), block=10)
    assert statistics.nominal_rate_hz == pytest.approx(100.0, rel=0.04)
    assert statistics.losses_estimated == pytest.approx(100, abs=3)
    assert np.flatnonzero(samples.status & Status.GAP_ESTIMATED).tolist() == [round(begin_s * 100)]
    np.testing.assert_allclose(samples.time_s - true_s, 0.0, atol=0.06)


@pytest.mark.parametrize("length_s", [0.5, 1.0, 2.0, 2.5, 3.0, 5.0, 10.0])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0, 1000.0])
def test_an_outage_among_the_first_samples_spoils_no_time(rate_hz: float, length_s: float) -> None:
    lost = round(length_s * rate_hz)
    even_s = 1000.0 + np.arange(lost + round(5 * rate_hz)) / rate_hz
    for begin in range(1, 16):
        true_s = np.delete(even_s, slice(begin, begin + lost))
        samples, statistics = run(true_s)
        np.testing.assert_allclose(samples.time_s, true_s, atol=1e-6, err_msg=f"silent from sample {begin} on")
        assert statistics.losses_estimated == lost
        assert np.flatnonzero(samples.status & Status.GAP_ESTIMATED).tolist() == [begin]


@pytest.mark.parametrize("length_s", [3.0, 10.0])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0, 1000.0])
def test_two_outages_soon_after_each_other_spoil_no_time(rate_hz: float, length_s: float) -> None:
    lost = round(length_s * rate_hz)
    even_s = 1000.0 + np.arange(2 * lost + round(6 * rate_hz)) / rate_hz
    for begin, between in itertools.product((1, 3, 8, 15), (3, 10, round(0.7 * rate_hz))):
        second = begin + lost + between
        true_s = np.delete(even_s, np.r_[begin : begin + lost, second : second + lost])
        samples, statistics = run(true_s)
        np.testing.assert_allclose(samples.time_s, true_s, atol=1e-6, err_msg=f"silent from {begin} and {second} on")
        assert statistics.losses_estimated == 2 * lost


@pytest.mark.parametrize("length_s", [3.0, 10.0])
def test_a_host_that_sleeps_among_the_first_samples_loses_nothing(length_s: float) -> None:
    for rate_hz in (50.0, 200.0, 1000.0):
        true_s = 1000.0 + np.arange(round((length_s + 5) * rate_hz)) / rate_hz
        for begin in range(1, 16):
            woke_s = true_s[begin] + length_s
            samples, statistics = run(np.where(true_s < true_s[begin], true_s, np.maximum(true_s, woke_s)))
            assert statistics.losses_estimated == 0
            np.testing.assert_allclose(samples.time_s, true_s, atol=2 / rate_hz)


@pytest.mark.parametrize("block", [1, 13, 500, 100_000])
def test_a_rate_does_not_depend_on_how_the_stream_is_cut(block: int) -> None:
    true_s = np.delete(np.arange(3000) / 100.0, slice(700, 760))
    stamp_s = np.maximum.accumulate(bursty(true_s, 0.033) + jitter(len(true_s), 2e-3))
    samples, statistics = run(stamp_s, block=block)
    expected, of_one = run(stamp_s, block=50)
    np.testing.assert_array_equal(samples.time_s, expected.time_s)
    assert statistics == of_one


@pytest.mark.parametrize("rate_hz", [100.0, 400.0])
def test_a_host_whose_clock_runs_fast_learns_the_rate(rate_hz: float) -> None:
    for seed in range(12):
        true_s = np.arange(round(20 * rate_hz)) / rate_hz
        samples, statistics = run(fast_host(true_s, seed), block=40)
        assert statistics.nominal_rate_hz == pytest.approx(rate_hz, rel=0.15)
        assert statistics.losses_estimated <= rate_hz, "a sleep of a second may pass for one loss, not for thousands"
        np.testing.assert_allclose(np.diff(samples.time_s[[0, -1]]), true_s[-1], atol=1.2)


def held_up(true_s: FloatArray, seed: int) -> FloatArray:
    """Return what a sender makes of even times that wakes every 8.6 ms, or somewhat later, and never sends two at once."""
    rng = np.random.default_rng(seed)
    sent_s, now_s = np.empty(len(true_s)), float(true_s[0])
    for place, due_s in enumerate(true_s.tolist()):
        while now_s < due_s or not place:
            now_s += 0.0086 + float(rng.exponential(0.0006))
            if not place:
                break
        sent_s[place] = now_s
        now_s += 1e-5
    return sent_s


@pytest.mark.parametrize("lost", [0.0, 0.01])
@pytest.mark.parametrize("block", [20, 10_000])
def test_a_sender_that_its_host_holds_up_loses_nothing_by_it(lost: float, block: int) -> None:
    for seed in range(8):
        kept = np.random.default_rng(seed).random(2600) >= lost
        true_s = np.arange(2600)[kept] / 100.0
        stamp_s = held_up(np.arange(2600) / 100.0, seed)[kept]
        assert np.median(np.diff(stamp_s)) < 0.0095, "most steps are shorter than the period"
        samples, statistics = run(stamp_s, block=block)
        assert statistics.nominal_rate_hz == pytest.approx(100.0, rel=0.02)
        assert statistics.losses_estimated <= 2600 - len(true_s)
        np.testing.assert_allclose(np.diff(samples.time_s[[0, -1]]), true_s[-1] - true_s[0], atol=0.03)


def test_what_uneven_stamps_cannot_show_is_said() -> None:
    kept = np.flatnonzero(np.random.default_rng(2).random(3000) >= 0.012)
    uneven = np.random.default_rng(2).uniform(0, 0.009, len(kept))
    _, statistics = run(kept / 100.0 + uneven)
    assert 0.015 < statistics.least_loss_s < 0.03
    (sentence,) = remarks([statistics])
    assert f"{1e3 * statistics.least_loss_s:.0f} ms" in sentence
    _, statistics = run(kept / 100.0 + uneven / 50)
    assert (statistics.least_loss_s, remarks([statistics])) == (0.0, [])
    _, statistics = run(kept / 100.0 + uneven, counter=kept % 256, modulus=256)
    assert statistics.least_loss_s == 0.0, "a counter shows each"


@pytest.mark.parametrize("lost", [0.08, 0.15])
def test_many_independent_losses_are_no_hold_ups(lost: float) -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        kept = np.flatnonzero(rng.random(2600) >= lost)
        _, statistics = run(kept / 100.0 + rng.uniform(0, 7e-4, len(kept)), block=20)
        assert statistics.nominal_rate_hz == pytest.approx(100.0, rel=0.01)
        assert statistics.losses_estimated == pytest.approx(int(np.diff(kept).sum()) - len(kept) + 1, abs=3)


def test_a_large_loss_shows_through_bursts() -> None:
    true_s = np.concatenate([np.arange(4000), np.arange(4300, 8000)]) / 1000.0
    samples, statistics = run(bursty(true_s, 0.010, 0.003), block=20)
    assert statistics.losses_estimated == pytest.approx(300, abs=2)
    assert statistics.gaps == 1
    assert np.flatnonzero(samples.status & Status.GAP_ESTIMATED)[0] == pytest.approx(4000, abs=12)


@pytest.mark.parametrize("modulus", [15, 16, 100, 256, 65536])
@pytest.mark.parametrize("block", [9, 4000])
def test_a_counter_counts_exactly(modulus: int, block: int) -> None:
    rng = np.random.default_rng(modulus)
    kept = np.sort(rng.permutation(6000)[: 6000 - 300])
    stamp_s = bursty(kept / 400.0, 0.020)
    samples, statistics = run(stamp_s, counter=kept % modulus, modulus=modulus, block=block)
    missing = np.diff(kept) - 1
    assert statistics.samples_lost == missing.sum()
    assert statistics.losses_estimated == 0
    assert ((samples.status[1:] & Status.AFTER_GAP) != 0).tolist() == (missing > 0).tolist()


@pytest.mark.parametrize("begin", [0, 3000, 60_000])
@pytest.mark.parametrize("block", [9, 100_000])
def test_a_counter_beyond_its_stated_end_has_another(begin: int, block: int) -> None:
    kept = np.delete(np.arange(70_000), [200, 254, 255, 256, 6000, 65_535, 65_536])
    _, statistics = run(kept / 400.0, counter=(begin + kept) % 65_536, modulus=255, block=block)
    assert statistics.samples_lost == 7
    assert statistics.losses_estimated == 0


@pytest.mark.parametrize("places", [[1014], [1015], [1020], [*range(900, 3000, 97)], [1500, 1501, 1502]])
@pytest.mark.parametrize("block", [1, 9, 4000])
def test_a_number_beyond_the_end_that_stands_for_none_is_no_count(places: list[int], block: int) -> None:
    counter = np.arange(3000) % 15
    counter[places] = 15
    samples, statistics = run(np.arange(3000) / 100.0, counter=counter, modulus=15, block=block)
    assert (statistics.lost, statistics.gaps) == (0, 0)
    np.testing.assert_allclose(samples.time_s, np.arange(3000) / 100.0, atol=1e-3)
    assert samples.counter.tolist() == counter.tolist(), "as sent"


@pytest.mark.parametrize("block", [1, 9, 4000])
@pytest.mark.parametrize(("stated", "modulus"), [(15, 16), (255, 256), (255, 65_536), (100, 128)])
def test_a_counter_that_goes_on_beyond_its_stated_end_loses_nothing_there(stated: int, modulus: int, block: int) -> None:
    kept = np.delete(np.arange(3000), [1700, 2100, 2101])
    _, statistics = run(kept / 100.0, counter=kept % modulus, modulus=stated, block=block)
    assert (statistics.samples_lost, statistics.losses_estimated) == (3, 0)


def test_a_longer_round_of_the_counter_is_longer_than_a_burst() -> None:
    clock = CanClock(ClockRule(counter_modulus=2), SampleUnits(), DecoderStatistics())
    phase = _Phase(period_s=0.01, window_s=0.25, delay_s=0.02)
    clock._set_unit(phase)
    assert phase.burst == 2
    phase.delay_s = 0.001
    clock._set_unit(phase)
    assert phase.burst == 0


def test_a_counter_that_has_another_end_tells_its_losses_from_those_that_only_time_shows() -> None:
    kept = np.concatenate([np.arange(1000), np.arange(1000 + 150, 4000)])
    stamp_s = kept / 400.0
    # As late for good as the stated period would be.
    stamp_s[2000:] += 100 / 400.0
    _, statistics = run(stamp_s, counter=kept, modulus=100)
    assert (statistics.samples_lost, statistics.losses_estimated) == (150, 0)


@pytest.mark.parametrize(
    ("modulus", "missing"),
    [(15, 7), (15, 8), (15, 14), (15, 100), (16, 8), (16, 9), (16, 15), (16, 140), (256, 128), (256, 140), (256, 255), (2, 1)],
)
@pytest.mark.parametrize("block", [1, 9, 4000])
def test_losses_of_more_than_half_a_round_are_told_by_counter_and_time(modulus: int, missing: int, block: int) -> None:
    kept = np.concatenate([np.arange(1000), np.arange(1000 + missing, 4000)])
    stamp_s = kept / 400.0 + jitter(len(kept), 1e-4)
    samples, statistics = run(stamp_s, counter=kept % modulus, modulus=modulus, block=block)
    assert (statistics.lost, statistics.losses_estimated, statistics.gaps) == (missing, missing, 1)
    assert np.flatnonzero(samples.status & Status.GAP_ESTIMATED).tolist() == [1000]


def test_whole_wraps_are_estimated() -> None:
    kept = np.concatenate([np.arange(1000), np.arange(1000 + 2 * 256 + 5, 4000)])
    _, statistics = run(kept / 400.0, counter=kept % 256, modulus=256)
    assert statistics.samples_lost == 5
    assert statistics.losses_estimated == 512


def test_a_counter_of_another_step_and_lost_counter_messages() -> None:
    kept = np.delete(np.arange(2000), [700, 701])
    counter = kept * 4 % 256
    counter[[50, 900, 901]] = NO_COUNTER
    _, statistics = run(kept / 100.0, counter=counter, modulus=256, steps=(1, 2, 4))
    assert statistics.samples_lost == 2
    assert statistics.losses_estimated == 0


@pytest.mark.parametrize("modulus", [256, 65536])
@pytest.mark.parametrize("silence", [100, 200, 300, 1000])
@pytest.mark.parametrize("block", [1, 50, 4000])
def test_a_counter_that_begins_anew_behind_a_silence_loses_what_the_stamps_show(modulus: int, silence: int, block: int) -> None:
    """A power cycle: the counter begins at 0, as if a part of a round, or of another, had been lost."""
    there = np.concatenate([np.arange(1500), np.arange(1500 + silence, 4000)])
    counter = np.concatenate([np.arange(1500), np.arange(2500 - silence)]) % modulus
    samples, statistics = run(there / 100.0 + jitter(len(there), 1e-4), counter=counter, modulus=modulus, block=block)
    assert statistics.lost == silence
    assert statistics.rate_hz == pytest.approx(100.0, rel=1e-5)
    assert np.abs(samples.time_s - there / 100.0).max() < 1e-3


@pytest.mark.parametrize("modulus", [16, 256])
@pytest.mark.parametrize("paused_s", [0.5, 1.5])
@pytest.mark.parametrize("block", [1, 50, 4000])
def test_a_host_that_hands_over_late_restarts_no_counter(modulus: int, paused_s: float, block: int) -> None:
    """Three samples are lost just before the counter begins its round again, while the host pauses."""
    begin = 1536
    kept = np.delete(np.arange(4000), [begin, begin + 1, begin + 2])
    drained_s = begin / 100 + paused_s + 5e-4 * np.arange(-begin, len(kept) - begin)
    late = (np.arange(len(kept)) >= begin) & (kept / 100.0 < drained_s)
    stamp_s = np.where(late, drained_s, kept / 100.0) + jitter(len(kept), 1e-4)
    _, statistics = run(np.maximum.accumulate(stamp_s), counter=kept % modulus, modulus=modulus, block=block)
    assert (statistics.samples_lost, statistics.losses_estimated) == (3, 0)


def test_a_counter_that_jumps_back_is_no_loss_of_a_round() -> None:
    counter = np.arange(2000)
    counter[1000:] -= 900
    samples, statistics = run(np.arange(2000) / 100.0, counter=counter, modulus=65536)
    assert statistics.samples_lost == 0
    assert np.diff(samples.time_s).min() > 0


def test_stamps_that_wrap_or_step_back() -> None:
    stamp_s = np.arange(9000) / 100.0 % 60.0
    samples, statistics = run(stamp_s)
    assert statistics.clock_resets == 1
    assert np.flatnonzero(samples.status & Status.CLOCK_SET).tolist() == [6000]
    np.testing.assert_allclose(np.diff(samples.time_s), 0.01, atol=1e-4)


@pytest.mark.parametrize("block", [7, 100, 4000])
def test_a_pause_of_an_hour_is_flagged_in_any_pieces(block: int) -> None:
    # Two logs in one: no move goes across the flag.
    stamp_s = np.arange(4000) / 100.0
    stamp_s[1234:] += 4000.0
    samples, statistics = run(stamp_s, block=block)
    assert statistics.clock_resets == 1
    assert np.flatnonzero(samples.status & Status.CLOCK_SET).tolist() == [1234]


@pytest.mark.parametrize("place", [0, 49, 50, 1234])
def test_a_stamp_that_is_no_number_is_no_clock_that_was_set(place: int) -> None:
    stamp_s = np.arange(4000) / 100.0
    stamp_s[place] = np.nan
    samples, statistics = run(stamp_s)
    assert statistics.clock_resets == 0
    assert not (samples.status & Status.CLOCK_SET).any()


def test_a_new_rate_is_learned() -> None:
    stamp_s = np.concatenate([np.arange(1000) / 100.0, 10.0 + np.arange(4000) / 400.0])
    samples, statistics = run(stamp_s, block=20)
    np.testing.assert_allclose(samples.time_s[2000:], stamp_s[2000:], atol=1e-3)
    assert statistics.nominal_rate_hz == pytest.approx(400, rel=0.01)
    assert np.diff(samples.time_s).min() > 0


def test_without_any_time_the_nominal_rate_is_all_there_is() -> None:
    samples, _ = run(np.zeros(100), rule=ClockRule(rate_hz=50.0))
    np.testing.assert_allclose(np.diff(samples.time_s), 0.02)


def test_few_samples_come_out_at_the_end() -> None:
    for count in (1, 2, 5):
        samples, _ = run(np.arange(count) / 100.0)
        assert len(samples) == count


@pytest.mark.parametrize("seed", range(3))
def test_cuts_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kept = np.sort(rng.permutation(3000)[:2900])
    stamp_s = kept / 100.0 + jitter(len(kept), 3e-4, seed)
    one, first = run(stamp_s, block=10_000)
    two, second = run(stamp_s, block=int(rng.integers(1, 30)))
    # Blocks that come while the period is learned make it a little different.
    np.testing.assert_allclose(one.time_s, two.time_s, atol=1e-3)
    assert first.losses_estimated == second.losses_estimated
    assert one.status.tolist() == two.status.tolist()


@pytest.mark.parametrize("long_s", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("counter", [False, True])
def test_a_host_that_stands_still_and_then_hands_over_everything_loses_nothing(long_s: float, counter: bool) -> None:
    number = np.arange(8000)
    true_s = 1.0 + number / 400.0
    stamp_s = np.where((true_s > 8.0) & (true_s < 8.0 + long_s), 8.0 + long_s, true_s) + np.arange(8000) * 1e-9
    given = {"counter": number % 16, "modulus": 16} if counter else {}
    for block in (20, 8000):
        samples, statistics = run(stamp_s, block=block, **given)  # type: ignore[arg-type]
        assert (statistics.losses_estimated, statistics.samples_lost) == (0, 0)
        np.testing.assert_allclose(samples.time_s, true_s, atol=1e-3)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("rate_hz", [100.0, 400.0])
def test_time_runs_forward_whatever_the_stamps(rate_hz: float, seed: int) -> None:
    # A sender of changing rate on a loaded machine: the period is learned again and again.
    rng = np.random.default_rng(seed)
    rates_hz = rate_hz * np.repeat(rng.choice([0.7, 1.0, 1.0, 1.3], 12), 400)
    sent_s = np.cumsum(1 / rates_hz)
    late_s = rng.exponential(0.3 / rate_hz, len(sent_s))
    for begin in rng.integers(0, len(sent_s) - 1, 25).tolist():
        late_s[begin] += rng.exponential(0.1)
    stamp_s = np.maximum.accumulate(sent_s + late_s)
    swapped = rng.integers(1, len(sent_s), 20)
    stamp_s[swapped], stamp_s[swapped - 1] = stamp_s[swapped - 1], stamp_s[swapped]
    for block in (7, 40, 5000):
        samples, _ = run(stamp_s, block=block)
        assert np.diff(samples.time_s).min() > 0


def test_a_counter_that_stands_still_numbers_nothing_and_time_runs_on() -> None:
    protocol = load_protocol("xsens_can")
    sent = random_samples(protocol, 100.0, 0, 300)
    sent.counter[:] = 7
    decoder = Decoder(protocol)
    got = concatenate([decoder.feed(pack_frames(CanEncoder(protocol).encode(sent))), decoder.flush()])
    assert len(got) == 300
    assert np.diff(got.time_s).min() > 0
    assert got.time_s[-1] - got.time_s[0] == pytest.approx(2.99, abs=0.05)


@pytest.mark.parametrize("window_s", [0.003, 0.2, 5.0])
@pytest.mark.parametrize("count", [1, 40, 300])
def test_the_least_value_ahead_is_that_of_each_window(window_s: float, count: int) -> None:
    rng = np.random.default_rng(count)
    values, stamp_s = rng.normal(size=300), np.cumsum(rng.exponential(0.001, 300))
    wanted = [values[at:][stamp_s[at:] <= stamp_s[at] + window_s].min() for at in range(count)]
    assert _minimum_ahead(values, stamp_s, window_s, count).tolist() == wanted
