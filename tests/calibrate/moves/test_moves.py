"""Moves as compact sums: exact against integrating every sample, and honest about what is missing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from gyroscope_sessions import collect_moves

from imufield.calibrate.gyroscope.move_integration import centre, integrate, rough_inverse
from imufield.calibrate.model.rotation import exponential, matrix, multiply, right_jacobian
from imufield.calibrate.moves.moves import MoveCollector, Moves, cut_moves, stretch_stills
from imufield.calibrate.moves.slots import join_slots
from imufield.dataclass import replace
from imufield.samples import FloatArray, Samples, SampleUnits, Status, make_samples

pytestmark = pytest.mark.numerical

RATE_HZ = 1000.0
STILLS = np.array([[0.0, 2.0], [4.0, 2.0], [8.0, 2.0]])
"""Start and duration of three stills; moves from 2 to 4 s and from 6 to 8 s."""
START_S, DURATION_S = STILLS.T
A = np.array([[2e-4, 1e-6, 2e-6], [-1e-6, 2.1e-4, 3e-6], [2e-6, 1e-6, 1.9e-4]])
REST = np.array([32770.0, 32450.0, 32510.0])


def rates(time_s: FloatArray) -> FloatArray:
    """A hand that turns about changing axes, rad/s; zero in the stills."""
    u = np.mod(time_s - 2.0, 4.0) / 2.0
    bell = np.where((u < 1) & (time_s > 2), (u * (1 - u)) ** 2 * 16, 0.0)
    axes = np.stack([3 * np.cos(3 * time_s), 2 * np.sin(5 * time_s), 1 + np.sin(2 * time_s)], axis=1)
    return bell[:, None] * axes


def session(change: Callable[[Samples], Samples] | None = None) -> Samples:
    time_s = np.arange(0, 10.0, 1 / RATE_HZ)
    raw = rates(time_s) @ np.linalg.inv(A).T + REST
    noise = np.random.default_rng(0).standard_normal((len(time_s), 3))
    force = np.array([0.1, 0.2, 9.8]) + 0.001 * noise
    samples = make_samples(time_s, force, raw + 0.5 * noise, units=SampleUnits(accelerometer="m/s^2", gyroscope="count"))
    return samples if change is None else change(samples)


def turn_of(moves: Moves, k: int) -> FloatArray:
    centred = centre(moves, REST, moves.slots.force / moves.slots.duration_s[:, None])
    return integrate(np.concatenate([A.ravel(), np.zeros(12)]), centred, np.ones(3)).quaternion[k]


def between(a: FloatArray, b: FloatArray) -> float:
    """Return the angle between two attitudes, rad."""
    return float(2 * np.linalg.norm(multiply(a * [1, -1, -1, -1], b)[1:]))


def test_compact_sums_integrate_like_every_sample() -> None:
    samples = session()
    moves = collect_moves([samples], START_S, DURATION_S)
    assert len(moves) == 2
    assert moves.before.tolist() == [0, 1]
    assert np.add.reduceat(moves.slots.duration_s, moves.first) == pytest.approx([2.0, 2.0], abs=0.01)
    for k in range(2):
        inside = (samples.time_s >= moves.start_s[k]) & (samples.time_s < moves.end_s[k])
        product = np.array([1.0, 0, 0, 0])
        for rate in (samples.gyroscope[inside] - REST) @ A.T:
            product = multiply(product, exponential(rate / RATE_HZ))
        assert between(turn_of(moves, k), product) < 2e-5


def test_result_does_not_depend_on_blocks() -> None:
    samples = session()
    whole = collect_moves([samples], START_S, DURATION_S)
    rng = np.random.default_rng(3)
    cuts = np.sort(rng.choice(len(samples), 300, replace=False))
    blocks = [samples[slice(a, b)] for a, b in zip([0, *cuts], [*cuts, len(samples)], strict=True)]
    cut = collect_moves(blocks, START_S, DURATION_S)
    assert cut.slots.turn == pytest.approx(whole.slots.turn, abs=1e-9)
    assert cut.slots.area == pytest.approx(whole.slots.area, rel=1e-9, abs=1e-6)
    assert np.array_equal(cut.first, whole.first)


def test_joined_slots_turn_alike() -> None:
    moves = collect_moves([session()], START_S, DURATION_S)
    starts = np.concatenate(
        [np.arange(first, first + length, 2) for first, length in zip(moves.first, moves.length, strict=True)]
    )
    joined = join_slots(moves.slots, starts)
    first = np.searchsorted(starts, moves.first)
    merged = Moves(before=moves.before, after=moves.after, start_s=moves.start_s, end_s=moves.end_s, first=first, slots=joined)
    for k in range(2):
        assert between(turn_of(moves, k), turn_of(merged, k)) < 2e-5


def test_sensitivity_is_the_derivative() -> None:
    moves = collect_moves([session()], START_S, DURATION_S)
    centred = centre(moves, REST, moves.slots.force / moves.slots.duration_s[:, None])
    x = np.concatenate([A.ravel(), [1e-3, -2e-3, 1e-3], 1e-4 * np.arange(9)])
    turns = integrate(x, centred, np.ones(3))
    rng = np.random.default_rng(1)
    for _ in range(3):
        step = np.concatenate([1e-9 * rng.standard_normal(9), 1e-6 * rng.standard_normal(12)])
        inverse = turns.quaternion * [1, -1, -1, -1]
        change = multiply(inverse, integrate(x + step, centred, np.ones(3)).quaternion)
        assert 2 * change[:, 1:] == pytest.approx((turns.jacobian @ step[:, None])[:, :, 0], rel=2e-3, abs=1e-8)


def test_sums_over_slots_are_those_of_one_slot_after_the_other() -> None:
    moves = collect_moves([session(lose(3.0, 3.01))], START_S, DURATION_S)
    centred = centre(moves, REST, moves.slots.force / moves.slots.duration_s[:, None])
    x, density = np.concatenate([A.ravel(), [1e-3, -2e-3, 1e-3], 1e-4 * np.arange(9)]), np.array([1.0, 2.0, 3.0])
    turns, slots = integrate(x, centred, density), centred.slots
    rate = slots.turn / slots.duration_s[:, None]
    coning = slots.area + np.cross(slots.duration_s[:, None] * slots.turn - 2 * slots.moment, np.linalg.solve(A, x[9:12]))
    vectors = slots.turn @ A.T - x[9:12] * slots.duration_s[:, None] - slots.force @ x[12:].reshape(3, 3).T
    vectors += 0.5 * coning @ (np.linalg.det(A) * np.linalg.inv(A))
    assert slots.bridge.any()
    for k in range(2):
        own = range(centred.first[k], centred.first[k] + centred.length[k])
        to_end, spread, net, by_rate = np.eye(3), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 6))
        for slot in reversed(own):
            W = to_end @ right_jacobian(vectors[slot])
            spread += W @ A @ np.diag(density**2 * slots.duration_s[slot] + slots.bridge[slot] / 3) @ A.T @ W.T
            net += to_end @ vectors[slot]
            by_rate += np.hstack([W @ A @ np.diag(f * slots.turn[slot]) for f in (np.sign(rate[slot]), rate[slot] ** 2)])
            to_end = to_end @ matrix(exponential(vectors[slot])).T
        assert matrix(turns.quaternion[k]) == pytest.approx(to_end.T, abs=1e-12)
        assert turns.spread[k] == pytest.approx(spread, rel=1e-9, abs=1e-9 * spread.max())
        assert turns.net_rad[k] == pytest.approx(net, abs=1e-12)
        assert turns.by_rate[k] == pytest.approx(by_rate, rel=1e-9, abs=1e-9 * np.abs(by_rate).max())


def test_a_scale_is_found_from_nothing() -> None:
    time_s = np.arange(0, 10.0, 1 / RATE_HZ)
    w = rates(time_s)
    q = np.array([1.0, 0, 0, 0])
    up = np.empty((len(time_s), 3))
    for k, rate in enumerate(w):
        up[k] = multiply(multiply(q * [1, -1, -1, -1], np.array([0, 0, 0, 9.8])), q)[1:]
        q = multiply(q, exponential(rate / RATE_HZ))
    samples = make_samples(
        time_s, up, w @ np.linalg.inv(A).T + REST, units=SampleUnits(accelerometer="m/s^2", gyroscope="count")
    )
    moves = collect_moves([samples], START_S, DURATION_S)
    centred = centre(moves, REST, moves.slots.force / moves.slots.duration_s[:, None])
    assert rough_inverse(centred) == pytest.approx(A, abs=0.05 * 2e-4)


def lose(first_s: float, last_s: float) -> Callable[[Samples], Samples]:
    return lambda samples: samples[(samples.time_s < first_s) | (samples.time_s > last_s)]


def keys(moves: Moves) -> list[str]:
    """Return why each dropped move cannot be used."""
    return [why.key for why in moves.dropped]


def test_short_losses_are_bridged() -> None:
    whole, lossy = session(), session(lose(2.9, 2.92))
    moves = collect_moves([lossy], START_S, DURATION_S)
    assert len(moves) == 2
    reference = turn_of(collect_moves([whole], START_S, DURATION_S), 0)
    assert between(turn_of(moves, 0), reference) < 1e-3
    assert moves.slots.bridge.max() > 0


def test_long_losses_drop_the_move_and_name_it() -> None:
    moves = collect_moves([session(lose(2.9, 3.1))], START_S, DURATION_S)
    assert moves.before.tolist() == [1]
    assert keys(moves) == ["moves.lost_samples"]
    assert moves.dropped[0].values["missing_s"] == pytest.approx(0.2, abs=0.01)


def test_an_interruption_is_not_called_a_loss() -> None:
    moves = collect_moves([session(lose(2.4, 3.6))], START_S, DURATION_S)
    assert keys(moves) == ["moves.interrupted"]
    assert "1.2 s" in moves.dropped[0]


@pytest.mark.parametrize(("resumed_s", "key"), [(2.4, "moves.resumed"), (9.0, "moves.interrupted")])
def test_where_the_operator_had_stopped_there_is_nothing_to_check(resumed_s: float, key: str) -> None:
    collector = MoveCollector(session().units)
    collector.feed(session(lose(2.4, 3.6)))
    assert keys(cut_moves(collector.slots(), START_S, DURATION_S, np.nan, np.array([resumed_s]))) == [key]


def test_two_stills_of_one_rest_are_not_stretched_over_one_another() -> None:
    """All ten seconds are calm."""
    sums = np.column_stack([np.full(100, 0.1), 0.1 * np.random.default_rng(1).standard_normal((100, 6))])
    stills = np.array([[0.5, 2.5], [6.5, 8.5]])
    found = stretch_stills(np.arange(100) / 10, sums, stills=stills, in_hand=np.zeros(2, dtype=np.bool_))
    assert found[0, 1] <= found[1, 0]
    assert found[1, 1] > 8.5
    # A hand sways all the time.
    found = stretch_stills(np.arange(100) / 10, sums, stills=stills, in_hand=np.array([True, False]))
    assert found[0].tolist() == stills[0].tolist()
    assert found[1, 1] > 8.5


def saturate(samples: Samples) -> Samples:
    limit = 9000.0
    clipped = np.clip(samples.gyroscope, REST - limit, REST + limit)
    return make_samples(samples.time_s, samples.accelerometer, clipped, units=samples.units)


def coarse(samples: Samples) -> Samples:
    stepped = 600 * np.rint(samples.gyroscope / 600)
    return make_samples(samples.time_s, samples.accelerometer, stepped, units=samples.units)


def test_the_top_of_a_turn_in_coarse_steps_is_no_limit() -> None:
    rate = session(coarse).gyroscope
    top = np.flatnonzero(np.any(rate == rate.max(axis=0), axis=1))
    assert np.any(np.diff(top, n=3) == 0)
    assert len(collect_moves([session(coarse)], START_S, DURATION_S)) == 2


def in_steps(samples: Samples, step: float, low: float, high: float) -> Samples:
    """Clipped at so many steps from rest, which each take some samples."""
    codes = np.clip(np.rint((samples.gyroscope - REST) / step), low, high)
    return make_samples(samples.time_s, samples.accelerometer, REST + step * codes, units=samples.units)


def test_a_limit_that_is_reached_step_by_step_is_seen() -> None:
    samples = in_steps(session(), 200.0, -40, 40)
    assert np.abs(np.diff(samples.gyroscope, axis=0)).max() == 200
    assert set(keys(collect_moves([samples], START_S, DURATION_S))) == {"moves.saturated"}


def test_a_limit_with_which_a_stream_begins_is_seen() -> None:
    samples = in_steps(session(), 1.0, -9000, 9000)
    collector = MoveCollector(samples.units)
    for first in range(3000, 3600, 60):
        collector.feed(samples[slice(first, first + 60)])
    assert samples.gyroscope[3000, 0] == collector.ends[0, 0] == REST[0] - 9000
    assert np.isnan(collector.ends[1, 0])


def test_an_axis_that_is_turned_one_way_only_does_not_end_at_rest() -> None:
    samples = session()
    one_way = replace(samples, gyroscope=REST + np.abs(samples.gyroscope - REST))
    moves = collect_moves([in_steps(one_way, 200.0, 0, 1e9)], START_S, DURATION_S)
    assert keys(moves) == []


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1, 0.5])
@pytest.mark.parametrize("shift", [0.0, 0.2, -0.2])
@pytest.mark.parametrize("steps", [20, 40, 100])
def test_the_rate_of_a_table_is_no_limit(noise: float, shift: float, steps: int) -> None:
    """Codes of 0.01 rad/s and a table that turns by so many of them for 9 s, and back."""
    time_s = np.arange(0, 30.0, 0.01)
    speed = np.clip(np.interp(time_s, [3, 4, 13, 14, 16, 17, 26, 27], [0, 1, 1, 0, 0, -1, -1, 0]), -1, 1)
    codes = steps * np.stack([0.02 * speed, -0.01 * speed, speed], axis=1) + np.array([0.5, 0.2, shift])
    rng = np.random.default_rng(6)
    rate = 0.01 * np.rint(codes + noise * rng.standard_normal(codes.shape))
    force = np.array([0.1, 0.2, 9.8]) + 0.001 * rng.standard_normal(codes.shape)
    samples = make_samples(time_s, force, rate, units=SampleUnits())
    assert keys(collect_moves([samples], np.array([0.0, 14.5, 27.5]), np.array([2.5, 1.0, 2.0]))) == []


@pytest.mark.parametrize("later", [0.8, 1.4])
def test_a_turn_that_saturates_for_long_is_no_rate_of_a_table(later: float) -> None:
    """Turns of 10 s by hand up to 2.5 rad/s, and of 3 s, of which codes of 0.01 rad/s show 1 rad/s."""
    time_s = np.arange(0, 24.0, 0.01)
    long, short = (np.sin(np.pi * np.clip((time_s - begin) / span, 0, 1)) ** 2 for begin, span in ((3, 10), (17, 3)))
    rate = np.outer(2.5 * long + later * short, [0.02, -0.01, 1.0])
    rate[:, 2] = np.minimum(rate[:, 2], 1.0)
    force = np.array([0.1, 0.2, 9.8]) + 0.001 * np.random.default_rng(6).standard_normal(rate.shape)
    samples = make_samples(time_s, force, 0.01 * np.rint(100 * rate), units=SampleUnits())
    moves = collect_moves([samples], np.array([0.0, 14.0, 21.0]), np.array([2.5, 2.0, 2.0]))
    assert keys(moves) == ["moves.saturated"] * (1 + (later > 1))


def test_saturation_is_seen_with_and_without_a_flag() -> None:
    moves = collect_moves([session(saturate)], START_S, DURATION_S)
    assert set(keys(moves)) == {"moves.saturated"}
    samples = session()
    samples.status[2500] |= np.uint32(Status.GYROSCOPE_SATURATED)
    moves = collect_moves([samples], START_S, DURATION_S)
    assert keys(moves) == ["moves.saturated"]
    assert moves.before.tolist() == [1]


def test_clock_jumps_drop_the_move() -> None:
    samples = session()
    samples.time_s[2500:] -= 0.05
    moves = collect_moves([samples], START_S, DURATION_S)
    assert keys(moves) == ["moves.clock_jump"]


@pytest.mark.parametrize(("stood", "frozen"), [(2, False), (50, False), (50, True)])
def test_a_clock_that_stands_in_a_turn_drops_the_move(stood: int, frozen: bool) -> None:
    samples = session()
    lost_s = samples.time_s[2500 + stood] - samples.time_s[2500]
    samples.time_s[2500 : 2501 + stood] = samples.time_s[2500]
    samples.time_s[2501 + stood :] -= lost_s
    if frozen:
        samples.gyroscope[2500 : 2501 + stood], samples.accelerometer[2500 : 2501 + stood] = REST, 1.0
    assert keys(collect_moves([samples], START_S, DURATION_S)) == ["moves.clock_jump"]


def test_a_sample_that_is_sent_twice_changes_no_turn() -> None:
    exact, twice = (
        collect_moves([session(change)], START_S, DURATION_S)
        for change in (None, lambda samples: samples[np.sort(np.append(np.arange(len(samples)), [2500, 2501, 6900]))])
    )
    assert keys(twice) == []
    for k in range(2):
        assert between(turn_of(exact, k), turn_of(twice, k)) < 1e-9


@pytest.mark.parametrize("flags", [Status.GAP_ESTIMATED, Status.GAP_ESTIMATED | Status.CLOCK_SET])
def test_a_clock_that_is_set_drops_the_move(flags: Status) -> None:
    """Whether the unit turned meanwhile, nobody knows; an estimated loss shows in the time."""
    samples = session()
    samples.status[2500] |= np.uint32(flags)
    moves = collect_moves([samples], START_S, DURATION_S)
    assert keys(moves) == (["moves.clock_jump"] if Status.CLOCK_SET in flags else [])


def test_invalid_and_missing_samples() -> None:
    samples = session()
    samples.gyroscope[2500:2900] = np.nan
    samples.status[6500] |= np.uint32(Status.INSTRUMENT_FAULT)
    moves = collect_moves([samples], START_S, DURATION_S)
    assert keys(moves) == ["moves.lost_samples", "moves.invalid_samples"]
    assert len(moves) == 0


@pytest.mark.parametrize("nothing", [1e300, np.nan])
def test_a_specific_force_that_nothing_has_sent_is_a_lost_sample(nothing: float) -> None:
    samples = session()
    samples.accelerometer[2500] = [0.1, nothing, 9.8]
    moves = collect_moves([samples], START_S, DURATION_S)
    assert len(moves) == 2
    assert np.abs(moves.slots.force / moves.slots.duration_s[:, None]).max() < 10
    assert between(turn_of(moves, 0), turn_of(collect_moves([session()], START_S, DURATION_S), 0)) < 1e-3


def test_no_still_after_or_none_at_all() -> None:
    assert len(collect_moves([session()], START_S[:1], DURATION_S[:1])) == 0
    assert len(collect_moves([], START_S, DURATION_S)) == 0
    outside = collect_moves([session()], START_S + 100, DURATION_S)
    assert set(keys(outside)) == {"moves.no_samples"}


def test_long_recordings_are_kept_in_less() -> None:
    units = SampleUnits(accelerometer="m/s^2", gyroscope="count")
    small, large = MoveCollector(units), MoveCollector(units)
    large._compact_at = 1200
    samples = session()
    for first in range(0, len(samples), 500):
        small.feed(samples[slice(first, first + 500)])
        large.feed(samples[slice(first, first + 500)])
    assert large._count < 0.75 * small._count
    a, b = small.finish(START_S, DURATION_S), large.finish(START_S, DURATION_S)
    for k in range(2):
        assert between(turn_of(a, k), turn_of(b, k)) < 1e-4


def test_slots_joined_inside_stills_leave_the_moves_alone() -> None:
    samples = session()
    collector = MoveCollector(samples.units)
    # Parts that end in the middle of a cell.
    for first in range(0, len(samples), 730):
        collector.feed(samples[slice(first, first + 730)])
    whole, joined = collector.slots(), collector.joined_slots(START_S, DURATION_S)
    assert len(joined) < 0.6 * len(whole)
    assert joined.duration_s.sum() == pytest.approx(whole.duration_s.sum(), rel=1e-12)
    a, b = (cut_moves(slots, START_S, DURATION_S, collector.ends) for slots in (whole, joined))
    assert a.start_s.tolist() == b.start_s.tolist()
    assert len(a.slots) == len(b.slots)
    for name in ("turn", "moment", "area", "force"):
        assert getattr(a.slots, name) == pytest.approx(getattr(b.slots, name), rel=1e-12)


def test_stills_are_stretched_to_where_they_end() -> None:
    # The stills are told as half a second each; the rest of the 2 s is not integrated.
    moves = collect_moves([session()], START_S + 0.5, np.full(3, 0.6))
    assert moves.start_s[1] > 5.1 + 0.05 or moves.slots.duration_s[moves.first[1] :].sum() < 3.4
