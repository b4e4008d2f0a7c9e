"""The virtual operator: physics of the motion, and truth of the record."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.rotation import conjugate, exponential, logarithm, multiply, rotate
from imufield.errors import Reason, UsageError
from imufield.simulate.truth.motion import TrueMotion
from imufield.simulate.truth.operator import DEG, NO_POSITION, BumpKind, Operator, OperatorSettings, StillInterval
from tests.refused import refused

FACES = [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1], [0, -1, 0], [-1, 0, 0]]
BRISK = OperatorSettings(hold_s=3.0, initial_still_s=2.0, turn_s=(0.5, 1.5))
LIVELY = replace(BRISK, bump_probability=0.3, wrong_probability=0.2, pause_probability=0.2, pause_s=(1.0, 2.0))
HELD = replace(LIVELY, style="held")
RATE_HZ = 200.0


def whole_session(operator: Operator, rate_hz: float = RATE_HZ) -> TrueMotion:
    return operator.block(0, int((operator.plan_all() + 1) * rate_hz), 1 / rate_hz)


def inside(still: StillInterval, motion: TrueMotion) -> np.ndarray:
    # Differences reach one sample over the edges.
    margin = 1.5 / RATE_HZ
    return (motion.time_s > still.start_s + margin) & (motion.time_s < still.end_s - margin)


@pytest.mark.parametrize("settings", [BRISK, LIVELY, HELD], ids=["placed", "lively", "held"])
def test_rate_integrates_to_the_attitude(settings: OperatorSettings) -> None:
    operator = Operator(FACES, 5, settings)
    motion = whole_session(operator)
    interval_s = 1 / RATE_HZ
    edges_s = (np.array([0, len(motion)]) - 0.5) * interval_s
    first, last = operator.attitude(edges_s)
    earth = exponential(-operator.site.earth_rate_n * interval_s)
    quaternion = first
    for turn in exponential(motion.angular_rate * interval_s):
        quaternion = multiply(earth, multiply(quaternion, turn))
    assert np.linalg.norm(logarithm(multiply(conjugate(quaternion), last))) < 1e-9


def test_specific_force_integrates_to_rest_after_every_turn() -> None:
    """Lift, travel, wobble and lever arm together start and end without velocity."""
    operator = Operator(FACES, 5, replace(BRISK, put_down_m_s2=0.0, sway_m=0.0))
    motion = whole_session(operator)
    acceleration = rotate(motion.quaternion_nb, motion.specific_force) + operator.site.gravity_n
    for move in operator.moves:
        during = (motion.time_s > move.start_s - 0.1) & (motion.time_s < move.end_s)
        velocity = np.cumsum(acceleration[during], axis=0) / RATE_HZ
        assert np.abs(velocity).max() > 0.05
        np.testing.assert_allclose(velocity[-1], 0.0, atol=5e-4)


@pytest.mark.parametrize("settings", [BRISK, LIVELY], ids=["plain", "lively"])
def test_force_in_stills_is_gravity_along_the_recorded_direction(settings: OperatorSettings) -> None:
    operator = Operator(FACES, 11, settings)
    motion = whole_session(operator)
    for still in operator.stills:
        rows = inside(still, motion)
        expected = np.broadcast_to(operator.site.gravity_m_s2 * still.direction, (int(np.count_nonzero(rows)), 3))
        np.testing.assert_allclose(motion.specific_force[rows], expected, atol=1e-7)
        assert np.linalg.norm(motion.angular_rate[rows], axis=1) == pytest.approx(7.292115e-5, rel=1e-6)


def test_something_moves_in_every_recorded_move() -> None:
    operator = Operator(FACES, 11, LIVELY)
    motion = whole_session(operator)
    for move in operator.moves:
        rows = (motion.time_s > move.start_s) & (motion.time_s < move.end_s)
        assert abs(np.linalg.norm(motion.specific_force[rows], axis=1) - operator.site.gravity_m_s2).max() > 0.02


def test_stills_and_moves_fill_the_session_without_overlap() -> None:
    operator = Operator(FACES, 3, LIVELY)
    operator.plan_all()
    edges = sorted([(s.start_s, s.end_s) for s in operator.stills] + [(m.start_s, m.end_s) for m in operator.moves])
    assert edges[0][0] == 0.0
    assert math.isinf(edges[-1][1])
    for (_, end_s), (start_s, _) in itertools.pairwise(edges):
        assert start_s == pytest.approx(end_s, abs=1e-9)


def test_every_position_is_shown_within_the_placement_error() -> None:
    settings = replace(BRISK, placement_error_rad=15 * DEG)
    operator = Operator(FACES, 3, settings)
    operator.plan_all()
    shown = [still for still in operator.stills if still.position != NO_POSITION]
    assert [still.position for still in shown] == list(range(6))
    tilt = [math.degrees(math.acos(still.direction @ operator.directions[still.position])) for still in shown]
    assert max(tilt) <= 15.0
    assert np.mean(tilt) > 3.0


def test_a_bumped_position_is_repeated_until_it_went_well() -> None:
    operator = Operator(FACES, 8, replace(BRISK, bump_probability=0.5))
    operator.plan_all()
    stills = [still for still in operator.stills if still.position != NO_POSITION]
    assert any(still.bumped for still in stills)
    assert {still.position for still in stills if not still.bumped} == set(range(6))


def test_a_shift_tilts_the_unit_and_a_knock_does_not() -> None:
    settings = replace(BRISK, bump_probability=1.0, repeats_after_bump=False)
    kinds: tuple[BumpKind, ...] = ("knock", "shift")
    for kind, moved in zip(kinds, (False, True), strict=True):
        operator = Operator(FACES, 8, replace(settings, bump_kinds=(kind,)))
        operator.plan_all()
        before, after = (still.direction for still in operator.stills[1:3])
        assert bool(np.linalg.norm(before - after) > 1e-5) is moved


def test_hand_trembles_as_told() -> None:
    settings = replace(BRISK, style="held", hold_s=60.0, tremor_rad=0.1 * DEG, sway_rad=0.0, sway_m=0.0)
    operator = Operator(FACES[:1], 2, settings)
    operator.plan_all()
    still = operator.stills[-1]
    time_s = np.arange(still.start_s + 1, still.start_s + 59, 0.005)
    quaternion = operator.attitude(time_s)
    tremor = logarithm(multiply(conjugate(quaternion[:1]), quaternion))
    tremor -= tremor.mean(axis=0)
    np.testing.assert_allclose(tremor.std(axis=0), 0.1 * DEG, rtol=0.05)
    spectrum = np.abs(np.fft.rfft(tremor, axis=0)) ** 2
    frequency_hz = np.fft.rfftfreq(len(time_s), 0.005)
    in_band = (frequency_hz > 7.5) & (frequency_hz < 12.5)
    assert spectrum[in_band].sum() / spectrum.sum() > 0.98


def test_blocks_of_any_size_give_the_same_motion() -> None:
    whole = whole_session(Operator(FACES, 4, HELD))
    operator = Operator(FACES, 4, HELD)
    cuts = np.unique(np.random.default_rng(1).integers(0, len(whole), 50))
    for first, last in zip([0, *cuts], [*cuts, len(whole)], strict=True):
        if last > first:
            part = operator.block(int(first), int(last - first), 1 / RATE_HZ)
            np.testing.assert_allclose(part.specific_force, whole.specific_force[first:last], atol=1e-9)
            np.testing.assert_allclose(part.angular_rate, whole.angular_rate[first:last], atol=1e-11)


def test_seed_decides() -> None:
    first, again, other = (whole_session(Operator(FACES, seed, LIVELY)) for seed in (1, 1, 2))
    assert np.array_equal(first.specific_force, again.specific_force)
    assert not np.array_equal(first.specific_force[:400], other.specific_force[:400])


def test_no_turn_is_faster_than_the_limit() -> None:
    operator = Operator(
        FACES, 1, replace(BRISK, turn_s=(0.1, 0.1), peak_rate_rad_s=2.0, wobble_rad=0.0, tremor_rad=0.0, sway_rad=0.0)
    )
    motion = whole_session(operator)
    assert np.linalg.norm(motion.angular_rate, axis=1).max() < 2.1


def test_waiting_operator_leaves_when_told_and_goes_where_told() -> None:
    operator = Operator(FACES, 1, replace(BRISK, waits=True))
    count, positions = 0, []
    for told in (None, 4, 2):
        for _ in range(100):
            operator.block(count, 40, 0.01)
            count += 40
        positions.append(operator.stills[-1].position)
        assert math.isinf(operator.stills[-1].end_s)
        now_s = count * 0.01
        operator.accepted(told)
        operator.block(count, 10, 0.01)
        count += 10
        assert now_s + 0.2 < operator.stills[len(positions)].end_s < now_s + 1.1
    operator.block(count, 1000, 0.01)
    assert [*positions, operator.stills[-1].position] == [0, 1, 4, 2]


def test_accepted_means_nothing_to_an_operator_on_the_move() -> None:
    operator = Operator(FACES, 1, replace(BRISK, waits=True))
    operator.block(0, 250, 0.01)
    operator.accepted()
    operator.block(250, 3000, 0.01)
    assert math.isinf(operator.stills[-1].end_s)
    assert operator.stills[-1].position == 0


def test_without_a_plan_it_lies_on_the_table() -> None:
    operator = Operator([], 1)
    assert operator.plan_all() == math.inf
    motion = operator.block(100000, 10, 0.01)
    assert np.linalg.norm(motion.specific_force, axis=1) == pytest.approx(operator.site.gravity_m_s2)


def test_after_the_plan_it_stays() -> None:
    operator = Operator(FACES, 1, BRISK)
    end_s = operator.plan_all()
    assert operator.finished_s == end_s
    motion = operator.block(int(end_s * 100) - 10, 1000, 0.01)
    assert np.ptp(motion.specific_force, axis=0) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("direction", [[0, 0, 0], [math.nan, 0, 1]])
def test_a_direction_must_point_somewhere(direction: list[float]) -> None:
    plan: list[list[float]] = [[0, 0, 1], direction]
    with refused(UsageError, Reason.USAGE, "direction 1", key="operator.direction") as caught:
        Operator(plan, 1)
    assert caught.value.values["row"] == 1
