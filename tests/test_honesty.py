"""Are the stated sigmas true? 8 simulated sessions, 120 in full, from motion through stillness and guide to the fit.

The instrument's noise, bias instability, quantisation and quadratic terms are those of its grade; the truth is what the
simulator drew, plus the mean of its drift over the session, which a calibration sees as bias.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.earth import choose_gravity
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.samples import FloatArray
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.operator import OperatorSettings
from tests.torture.conftest import FULL

SEEDS = 120 if FULL else 8
RATE_HZ = 100.0
BLOCK = 2000


def error_in_sigma(grade: str, seed: int) -> FloatArray:
    """Return the gauge-free errors of one session in units of their sigma, shape (12,)."""
    positions = scheme("paper24")
    habits = OperatorSettings(hold_s=5.5, initial_still_s=6.0, begins_in_first_position=True)
    options = Emulation(
        device="text", rate_hz=RATE_HZ, grade=grade, seed=seed, directions=positions.directions(), operator=habits
    )
    source = make_virtual_imu(options)
    end_s = source.operator.plan_all()
    guide = Guide(positions, source.imu.instrument.grade.units, settings=GuideSettings(hold_s=2.5))
    while not guide.done and source.time_s < end_s + 2.0:
        guide.feed(source.next_block(BLOCK))
    observations = guide.observations()
    assert len(observations) == len(positions)
    gravity = choose_gravity(options.site.gravity_m_s2)
    found = calibrate_accelerometer(observations, gravity, model="quadratic").intrinsic
    truth = source.imu.instrument.accelerometer
    truth = replace(truth, bias_m_s2=truth.bias_m_s2 + source.imu.mean_drift[:3])
    true, _ = intrinsic(to_vector(truth))
    values = np.concatenate([found.scale, found.bias_raw, found.angle_rad, found.quadratic])
    sigma = np.concatenate([found.scale_sigma, found.bias_raw_sigma, found.angle_sigma_rad, found.quadratic_sigma])
    error: FloatArray = (values - true) / sigma
    return error


@pytest.mark.parametrize("grade", ["tactical"])
def test_stated_sigmas_are_true_for_every_gauge_free_parameter(grade: str) -> None:
    errors = np.array([error_in_sigma(grade, seed) for seed in range(SEEDS)])
    rms = np.sqrt(np.mean(errors**2, axis=0))
    # n seeds know an RMS to 1 / sqrt(2 n): 6.5 % of 120, 25 % of 8. Of twelve, the largest is three of these off.
    known = 1 / np.sqrt(2 * SEEDS)
    assert np.all(rms > 1 - 3.2 * known), rms
    assert np.all(rms < 1 + 3.8 * known), rms
    # All twelve together are known better by sqrt(12).
    assert abs(np.sqrt(np.mean(errors**2)) - 1) < 4 * known / np.sqrt(12)
