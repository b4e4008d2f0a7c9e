"""Effects beside the error model, against their equations worked out on known motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from imufield.calibrate.model.rotation import conjugate, multiply
from imufield.samples import Samples, Status
from imufield.simulate.truth.effects import NO_EFFECTS, Effects
from imufield.simulate.truth.grades import TACTICAL, find_grade, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion import TrueMotion
from imufield.simulate.truth.operator import Operator, OperatorSettings

RATE_HZ = 100.0
GRADE = find_grade("mems")
STEP = GRADE.accelerometer.lsb_si


def fed(effects: Effects, blocks: int = 1, **settings: bool) -> tuple[Samples, ...]:
    """Return the samples of a slow sweep of all axes, in a number of blocks."""
    n = 2000
    time_s = np.arange(n) / RATE_HZ
    force = np.linspace(-15, 15, n)[:, None] * [1.0, -0.5, 0.7]
    imu = Imu(replace(perfect_instrument(GRADE), effects=effects), 3, ImuSettings(rate_hz=RATE_HZ, **settings))
    parts = np.array_split(np.arange(n), blocks)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return tuple(imu.feed(TrueMotion(time_s[rows], still[rows], np.zeros((len(rows), 3)), force[rows])) for rows in parts)


def test_a_silent_range_clips_and_says_nothing() -> None:
    (plain,), (clipped,) = fed(Effects()), fed(Effects(silent_range_m_s2=9.0))
    np.testing.assert_allclose(clipped.accelerometer, np.clip(plain.accelerometer, -9, 9), atol=STEP)
    assert (clipped.accelerometer[plain.accelerometer > 9 + STEP] == clipped.accelerometer.max()).all()
    assert (clipped.status == Status.GOOD).all()
    np.testing.assert_array_equal(clipped.gyroscope, plain.gyroscope)


def test_a_gyroscope_may_differ_by_sense_and_size_of_the_rate() -> None:
    effects = Effects(gyroscope_asymmetry=(1e-3, 0.0, -2e-3), gyroscope_cubic=(0.0, 1e-4, 0.0))
    rate = np.array([[2.0, -3.0, -1.0], [-2.0, 3.0, 1.0], [0.0, 0.0, 0.0]])
    # c |w| and c w^3, worked out by hand.
    expected = [[2.002, -3.0027, -1.002], [-1.998, 3.0027, 0.998], [0.0, 0.0, 0.0]]
    np.testing.assert_allclose(effects.distorted_rate(rate), expected, rtol=1e-12)
    assert NO_EFFECTS.distorted_rate(rate) is rate


def test_codes_that_stick_read_as_the_lowest_of_them() -> None:
    (plain,), (stuck,) = fed(Effects()), fed(Effects(sticking_period=256, sticking_width=32))
    codes, read = (np.rint(samples.accelerometer / STEP).astype(int) for samples in (plain, stuck))
    for code, shown in zip(codes.ravel()[::7].tolist(), read.ravel()[::7].tolist(), strict=True):
        assert shown == (code - code % 256 if code % 256 < 32 else code)
    assert len(np.unique(read % 256)) == 256 - 31


def test_frozen_outputs_repeat_the_last_value_across_blocks() -> None:
    effects = Effects(frozen_s=(4.0, 9.0), frozen_outputs=(0, 1, 5))
    (plain,) = fed(Effects())
    for blocks in (1, 7, 40):
        parts = fed(effects, blocks)
        force, rate = (np.concatenate([getattr(part, name) for part in parts]) for name in ("accelerometer", "gyroscope"))
        assert (force[400:900, :2] == plain.accelerometer[399, :2]).all()
        assert (rate[400:900, 2] == plain.gyroscope[399, 2]).all()
        np.testing.assert_array_equal(force[:, 2], plain.accelerometer[:, 2])
        np.testing.assert_array_equal(force[900:], plain.accelerometer[900:])


def test_a_soft_support_gives_way_as_a_voigt_element_does() -> None:
    """Two degrees with a time constant of 3 s: 1 - 1/e of it after 3 s, and the next turn begins where it ended."""
    habits = OperatorSettings(hold_s=12.0, settling_rad=math.radians(2.0), settling_s=3.0, tremor_rad=0.0)
    operator = Operator([[0, 0, 1], [1, 0, 0], [0, 1, 0]], 2, habits)
    operator.plan_all()
    for still in operator.stills[1:-1]:
        time_s = still.start_s + np.array([0.0, 3.0, 11.9999])
        attitude = operator.attitude(time_s)
        turned = multiply(conjugate(attitude[:1]), attitude[1:])
        angle_deg = np.degrees(2 * np.arcsin(np.linalg.norm(turned[:, 1:], axis=1)))
        np.testing.assert_allclose(angle_deg, 2.0 * (1 - np.exp([-1.0, -4.0])), rtol=1e-4)
        next_deg = operator.attitude(still.end_s + np.array([1e-6]))
        turned = multiply(conjugate(attitude[:1]), next_deg)
        np.testing.assert_allclose(np.degrees(2 * np.arcsin(np.linalg.norm(turned[:, 1:], axis=1))), angle_deg[1:], atol=1e-3)


QUIET = ImuSettings(noise=False, drift=False, quantise=False)


def output(seed: int, effects: Effects) -> np.ndarray:
    level = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    rest = TrueMotion(np.arange(4) / 500.0, level, np.zeros((4, 3)), np.tile([0.0, 0.0, 9.8], (4, 1)))
    samples = Imu(replace(perfect_instrument(TACTICAL), effects=effects), seed, QUIET).feed(rest)
    return np.hstack([samples.accelerometer, samples.gyroscope])


def test_a_turn_on_is_one_constant_of_a_power_on_with_its_sigma() -> None:
    plain = output(0, NO_EFFECTS)
    added = np.array([output(seed, Effects(turn_on_m_s2=0.01, turn_on_rad_s=0.002)) for seed in range(200)]) - plain
    assert np.ptp(added, axis=1).max() < 1e-12
    # 200 power-ons and three axes know a sigma to 3 %.
    assert np.isclose(added[:, 0, :3].std(), 0.01, rtol=0.12)
    assert np.isclose(added[:, 0, 3:].std(), 0.002, rtol=0.12)
