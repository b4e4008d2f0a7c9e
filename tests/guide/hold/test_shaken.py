"""Holds that shake are refused by name; what a person does between holds is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imufield.guide.events import RefusalCode
from imufield.guide.positions import scheme
from imufield.samples import Samples, make_samples
from imufield.simulate.truth.grades import draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.simulate.truth.virtual_imu import VirtualImu
from tests.guide.guided import find_still_intervals

RATE_HZ = 100.0
SHAKES_M_S2 = 1.0
FIRST_S, HOLD_S, TURN_S = 8.0, 8.0, 2.0


def visits(make_path: Callable[[float], Any]) -> Samples:
    """Return the six faces, each held for 8 s from 10 s after the face before."""
    path = make_path(RATE_HZ).hold([0, 0, 1], FIRST_S)
    for up in ([1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1]):
        path.turn(up, TURN_S).hold(up, HOLD_S)
    samples: Samples = path.samples()
    return samples


def shaken(samples: Samples, holds: set[int]) -> Samples:
    """Shake some of the holds at 7 Hz, counted from 0."""
    number, into_s = np.divmod(samples.time_s + TURN_S, HOLD_S + TURN_S)
    shakes = np.isin(number, list(holds)) & (into_s >= TURN_S)
    wave = np.sin(2 * np.pi * 7 * samples.time_s)[:, np.newaxis] * np.array([1.0, 0.6, 0.7]) * SHAKES_M_S2
    return replace(samples, accelerometer=samples.accelerometer + np.where(shakes[:, np.newaxis], wave, 0.0))


@pytest.mark.parametrize("holds", [set[int](), {2}, {1, 2, 3, 4, 5}], ids=str)
def test_holds_that_shake_are_refused_with_time_value_and_limit(make_path: Callable[[float], Any], holds: set[int]) -> None:
    found = find_still_intervals([shaken(visits(make_path), holds)])
    assert len(found.observations) == 6 - len(holds)
    starts_s = [time_s for time_s, _ in found.refused]
    assert starts_s == pytest.approx([number * (HOLD_S + TURN_S) for number in sorted(holds)], abs=1.1)
    for _, refusal in found.refused:
        assert (refusal.reason, refusal.axis) == (RefusalCode.NOT_STILL, "x")
        assert refusal.limit == pytest.approx(0.05)
        # Rms over the axes of a sine of these amplitudes.
        assert refusal.measured == pytest.approx(SHAKES_M_S2 * np.sqrt((1 + 0.6**2 + 0.7**2) / 6), rel=0.15)


def test_who_shakes_before_the_unit_lies_still_lost_nothing(make_path: Callable[[float], Any]) -> None:
    samples = visits(make_path)
    half = shaken(samples, {1, 2, 3})
    into_s = np.mod(samples.time_s + TURN_S, HOLD_S + TURN_S) - TURN_S
    force = np.where((into_s < 4.5)[:, np.newaxis], half.accelerometer, samples.accelerometer)
    found = find_still_intervals([replace(samples, accelerometer=force)])
    assert (len(found.observations), found.refused) == (6, ())


def test_a_turn_about_the_vertical_is_no_hold(make_path: Callable[[float], Any]) -> None:
    samples = shaken(visits(make_path), {2})
    turns = (samples.time_s >= 20) & (samples.time_s < 28)
    rate = samples.gyroscope + np.where(turns[:, np.newaxis], [0.0, np.radians(20), 0.0], 0.0)
    found = find_still_intervals([make_samples(samples.time_s, samples.accelerometer, rate, units=samples.units)])
    assert (len(found.observations), found.refused) == (5, ())


@pytest.mark.parametrize("in_hand", [False, True])
def test_moves_between_holds_are_none(in_hand: bool) -> None:
    grade = find_grade("mems")
    habits = OperatorSettings(turn_s=(2.0, 8.0), style="held" if in_hand else "placed")
    operator = Operator(scheme("corners24").directions(), 4, habits)
    source = VirtualImu(Imu(draw_truth(grade, np.random.default_rng(4)), 4, ImuSettings(rate_hz=RATE_HZ)), operator)
    found = find_still_intervals([source.next_block(int(operator.plan_all() * RATE_HZ))])
    assert not [refusal for _, refusal in found.refused if refusal.reason is RefusalCode.NOT_STILL]
    assert len(found.observations) > 20
