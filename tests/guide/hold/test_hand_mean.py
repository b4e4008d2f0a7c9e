"""Holds in the hand against the simulator's truth: the vector that the unit would show if it did not move."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imufield.calibrate.model.rotation import exponential, rotate
from imufield.guide.hold.checks import JOLT_SHARE, HoldUnderTest, examine
from imufield.guide.hold.hand_mean import HandMean, mean_in_hand
from imufield.guide.positions import angle_deg
from imufield.guide.refusals import BUMPED
from imufield.guide.stillness.cells import join_cells
from imufield.guide.stillness.limits import noise_limits
from imufield.guide.stillness.noise_floor import measure_floor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import Samples
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion_pieces import Shock
from imufield.simulate.truth.operator import Operator, OperatorSettings
from tests.guide.guided import cells_of, is_said_by

pytestmark = pytest.mark.numerical

MICRO_G = 9.80665e-6
QUIET = np.zeros(6)
SI = RoughScale(accelerometer=1.0, gyroscope=1.0)
GYROSCOPE_BIAS = 0.003


def hold(
    seed: int, *, delay_s: float = 0.0, scale_error: float = 0.0, arm_m: float = 0.1, **habits: Any
) -> tuple[Samples, float]:
    """Ten seconds in the hand, noise-free, and gravity there; the pivot is up to ``arm_m`` away."""
    rng = np.random.default_rng(seed)
    lever = rng.standard_normal(3)
    lever *= rng.uniform(0, arm_m) / np.linalg.norm(lever)
    unit = perfect_instrument(TACTICAL)
    gyroscope = replace(
        unit.gyroscope, scale=unit.gyroscope.scale * (1 + scale_error), bias=unit.gyroscope.bias + GYROSCOPE_BIAS
    )
    settings = OperatorSettings(style="held", lever_arm_m=tuple(lever), hold_s=11.0, turn_s=(1.0, 1.0), **habits)
    operator = Operator([[0, 0, 1], [0, 1, 0]], seed, settings)
    operator.plan_all()
    still = next(one for one in operator.stills if one.kind == "held")
    still_imu = Imu(
        replace(unit, gyroscope=gyroscope, triad_delay_s=delay_s),
        seed,
        ImuSettings(rate_hz=500, noise=False, drift=False, quantise=False),
    )
    first, last = (round(time_s * 500) for time_s in (still.start_s + 0.5, still.end_s - 0.5))
    still_imu.feed(operator.block(0, first, still_imu.interval_s))
    samples = still_imu.feed(operator.block(first, last - first, still_imu.interval_s))
    return samples, operator.site.gravity_m_s2


def error_ug(seed: int, **habits: Any) -> tuple[float, HandMean]:
    samples, gravity = hold(seed, **habits)
    found = mean_in_hand(samples, SI, QUIET)
    assert found is not None
    return (float(np.linalg.norm(found.force_raw)) - gravity) / MICRO_G, found


TREMOR = {"tremor_rad": math.radians(0.1), "sway_rad": 0.0, "sway_m": 0.0}


@pytest.mark.parametrize("seed", range(4))
def test_tremor_of_a_tenth_of_a_degree_adds_less_than_5_ug(seed: int) -> None:
    assert abs(error_ug(seed, **TREMOR)[0]) < 5
    assert abs(error_ug(seed, **TREMOR, delay_s=0.002, scale_error=0.02)[0]) < 5


def test_the_plain_mean_would_be_wrong_by_far_more() -> None:
    samples, gravity = hold(2, **TREMOR)
    plain = (float(np.linalg.norm(samples.accelerometer.mean(axis=0))) - gravity) / MICRO_G
    assert abs(plain) > 10 * abs(error_ug(2, **TREMOR)[0])


def test_sway_of_a_degree_is_turned_back() -> None:
    habits = {"tremor_rad": 0.0, "sway_rad": math.radians(1.0), "sway_m": 0.0}
    errors = [error_ug(seed, **habits)[0] for seed in range(4)]
    assert np.sqrt(np.mean(np.square(errors))) < 10
    assert error_ug(0, **habits)[1].sway_deg == pytest.approx(1.0, rel=0.3)


def test_the_sway_of_the_arm_is_in_the_sigma() -> None:
    habits = {"tremor_rad": math.radians(0.05), "sway_rad": math.radians(0.2), "sway_m": 0.002}
    ratio = []
    for seed in range(8):
        error, found = error_ug(seed, **habits)
        along = found.force_raw / np.linalg.norm(found.force_raw)
        ratio.append(error * MICRO_G / math.sqrt(along @ found.covariance_raw @ along))
    assert 0.1 < np.sqrt(np.mean(np.square(ratio))) < 1.3


def test_the_noise_of_the_instrument_is_in_the_sigma() -> None:
    """A quiet hand and a noisy chip: the scatter of such means is what is stated."""
    samples, gravity = hold(1, tremor_rad=math.radians(0.02), sway_rad=0.0, sway_m=0.0)
    sigma, density = 0.04, 0.04 / math.sqrt(500)
    rng = np.random.default_rng(5)
    ratio = []
    for _ in range(60):
        noisy = replace(samples, accelerometer=samples.accelerometer + sigma * rng.standard_normal(samples.accelerometer.shape))
        found = mean_in_hand(noisy, SI, np.full(6, density))
        assert found is not None
        along = found.force_raw / np.linalg.norm(found.force_raw)
        error = float(np.linalg.norm(found.force_raw)) - gravity
        ratio.append(error / math.sqrt(along @ found.covariance_raw @ along))
    # The Hann taper costs sqrt(1.5) against the plain mean of white noise.
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1.0, abs=0.2)


def test_tremor_and_sway_are_told_apart() -> None:
    found = error_ug(0, tremor_rad=math.radians(0.1), sway_rad=math.radians(0.5), sway_m=0.0)[1]
    assert found.tremor_deg == pytest.approx(0.1, rel=0.15)
    assert found.sway_deg == pytest.approx(0.5, rel=0.3)


def test_the_gyroscopes_bias_is_known_as_far_as_the_turn_is() -> None:
    found = error_ug(1, tremor_rad=math.radians(0.05), sway_rad=math.radians(0.3), sway_m=0.0)[1]
    sigma = np.sqrt(np.diag(found.gyroscope_covariance_raw))
    assert np.all(np.abs(found.gyroscope_raw - GYROSCOPE_BIAS) < 4 * sigma)


@pytest.mark.parametrize("delay_s", [0.0, 0.002])
def test_the_attitude_in_the_middle_is_told(delay_s: float) -> None:
    """Without an arm, the accelerometer shows gravity's direction in each sample."""
    habits = {"tremor_rad": math.radians(0.1), "sway_rad": math.radians(0.5), "sway_m": 0.0}
    samples, _ = hold(2, delay_s=delay_s, arm_m=0.0, **habits)
    found = mean_in_hand(samples, SI, QUIET)
    assert found is not None
    # The outputs of the gyroscope come so much later.
    there = [np.interp(found.middle_s - delay_s, samples.time_s, column) for column in samples.accelerometer.T]
    turned = rotate(exponential(-found.middle_rad), found.force_raw)
    assert angle_deg(turned, np.array(there)) < 0.01 < 0.1 < angle_deg(found.force_raw, np.array(there))


@pytest.mark.parametrize("lost_s", [0.004, 0.012, 0.03, 0.05, 0.07])
@pytest.mark.parametrize("seed", range(2))
def test_a_hole_is_no_bump(seed: int, lost_s: float) -> None:
    """Every 2 ms a sample with the noise of a tactical instrument: bridged or not, a hole adds little, and is no jolt."""
    samples, _ = hold(seed, tremor_rad=math.radians(0.1), sway_rad=math.radians(0.3), sway_m=0.0)
    noise = np.random.default_rng(seed).standard_normal((2, len(samples), 3)) * [[[0.02]], [[0.002]]]
    samples = replace(samples, accelerometer=samples.accelerometer + noise[0], gyroscope=samples.gyroscope + noise[1])
    elapsed_s = samples.time_s - samples.time_s[0]
    whole = mean_in_hand(samples, SI, QUIET)
    for begin_s in (0.01, 3.3, 6.1, 9.7):
        found = mean_in_hand(samples[np.flatnonzero((elapsed_s < begin_s) | (elapsed_s >= begin_s + lost_s))], SI, QUIET)
        assert found is not None
        assert whole is not None
        assert found.jolt_m_s2 < 0.7 * JOLT_SHARE * found.usual_jolt_m_s2
        if lost_s <= 0.04:
            assert np.linalg.norm(found.force_raw - whole.force_raw) < 60 * MICRO_G


def test_knocks_are_left_out() -> None:
    samples, gravity = hold(3, **TREMOR)
    knocked = (samples.time_s > samples.time_s[0] + 4) & (samples.time_s < samples.time_s[0] + 4.1)
    samples.accelerometer[knocked] += 0.5
    knock_s = samples.time_s[knocked][[0, -1]][None, :]
    with_knock, without = mean_in_hand(samples, SI, QUIET), mean_in_hand(samples, SI, QUIET, knock_s)
    assert with_knock is not None
    assert without is not None
    assert abs(np.linalg.norm(with_knock.force_raw) - gravity) > 500 * MICRO_G
    # Some tremor leaks through the hole.
    assert abs(np.linalg.norm(without.force_raw) - gravity) < 20 * MICRO_G


def test_mid_scale_and_counts() -> None:
    raw_zero = 500.0
    samples, _ = hold(1, **TREMOR)
    plain = mean_in_hand(samples, SI, QUIET)
    counts = replace(samples, accelerometer=samples.accelerometer * 100 + raw_zero, gyroscope=samples.gyroscope * 50)
    found = mean_in_hand(counts, RoughScale(accelerometer=100.0, gyroscope=50.0, raw_zero=np.full(3, raw_zero)), QUIET)
    assert plain is not None
    assert found is not None
    np.testing.assert_allclose(found.force_raw, plain.force_raw * 100 + raw_zero, rtol=1e-12)


def test_without_scale_or_samples_there_is_none() -> None:
    samples, _ = hold(1, **TREMOR)
    assert mean_in_hand(samples, RoughScale(accelerometer=1.0, gyroscope=None), QUIET) is None
    assert mean_in_hand(samples[:10], SI, QUIET) is None


@pytest.mark.parametrize("seed", range(3))
def test_a_hand_alone_makes_no_jolt(seed: int) -> None:
    samples, _ = hold(seed, tremor_rad=math.radians(0.1), sway_rad=math.radians(1.0))
    found = mean_in_hand(samples, SI, QUIET)
    assert found is not None
    assert found.jolt_m_s2 < 0.6 * JOLT_SHARE * found.usual_jolt_m_s2


@pytest.mark.parametrize("frequency_hz", [15.0, 25.0, 40.0])
def test_a_bump_is_a_jolt_and_is_refused(frequency_hz: float) -> None:
    """Cut out, it would leave a hole through which the sway comes in; so the hold is measured again."""
    samples, _ = hold(2, tremor_rad=math.radians(0.05), sway_rad=math.radians(0.5))
    begin_s = float(samples.time_s[0]) + 4.0
    shock = Shock(
        start_s=begin_s,
        acceleration=np.array([3.0, 0.0, 0.0]),
        rotation_rad=np.zeros(3),
        frequency_hz=frequency_hz,
        decay_s=0.02,
    )
    bumped = replace(samples, accelerometer=samples.accelerometer + shock.shape(samples.time_s)[:, None] * shock.acceleration)
    found = mean_in_hand(bumped, SI, QUIET)
    assert found is not None
    assert found.jolt_after_s == pytest.approx(4.0, abs=0.1)
    cells = join_cells(list(cells_of([bumped])))
    floor = measure_floor(cells)
    limits = noise_limits(floor, SI)
    refusal = examine(HoldUnderTest(cells=cells, floor=floor, limits=limits, scale=SI, hand_mean=found))
    assert refusal is not None
    assert is_said_by(BUMPED, refusal)
    assert refusal.measured > refusal.limit > 0
    assert f"{found.jolt_after_s:.1f} s" in refusal.words
