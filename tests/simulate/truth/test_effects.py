"""Effects of an instrument beside its error model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.simulate.truth.effects import NO_EFFECTS, Effects
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.motion import TrueMotion

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
