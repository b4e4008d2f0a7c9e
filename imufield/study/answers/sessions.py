"""Sessions to study, as the numbers that are compared: position means alone, or motion, stillness and guide as in use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.gyroscope.moves import MoveCollector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration, ModelChoice
from imufield.deliver.parameters.gauge_free import GaugeFree, gauge_free
from imufield.deliver.parameters.numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2, Gravity, choose_gravity
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.unguided import StillIntervalFinder
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.imu import Imu
from imufield.simulate.truth.operator import Operator, OperatorSettings
from imufield.study.answers.means import MeanSession

LATITUDE_DEG = 48.1
RATE_HZ = 100.0
_BLOCK = 2000


def mean_numbers(session: MeanSession, gravity: Gravity, rng: np.random.Generator, model: ModelChoice = "auto") -> GaugeFree:
    """Return the gauge-free numbers of a session of means with the gravity that its person believes in."""
    observations = session.observe(rng).observations
    return _gauge_free(calibrate_accelerometer(observations, gravity, model=model), observations)


def guided_numbers(grade: str, seed: int, day: int) -> GaugeFree:
    """Return the gauge-free numbers of both triads from a session on one day of an instrument, taken by the guide.

    What slow drift added to the biases on average over the session is a change of the instrument, and is taken off.
    """
    positions = scheme("paper24")
    habits = OperatorSettings(hold_s=5.5, initial_still_s=6.0, begins_in_first_position=True)
    options = Emulation(
        device="text", rate_hz=RATE_HZ, grade=grade, seed=seed, day=day, directions=positions.directions(), operator=habits
    )
    source = make_virtual_imu(options)
    units, end_s = source.imu.instrument.grade.units, source.operator.plan_all() + 2.0
    guide, collector = Guide(positions, units, settings=GuideSettings(hold_s=2.5)), MoveCollector(units)
    while not guide.done and source.time_s < end_s:
        block = source.next_block(_BLOCK)
        guide.feed(block)
        collector.feed(block)
    observations = guide.observations()
    calibration = calibrate_accelerometer(observations, choose_gravity(options.site.gravity_m_s2))
    given = GyroscopeInput(
        observations=observations,
        moves=collector.finish(observations.start_s, observations.duration_s),
        calibration=calibration,
        latitude_deg=options.site.latitude_deg,
        nominal_scale=source.imu.instrument.grade.gyroscope_scale,
    )
    found = _gauge_free(calibrate_gyroscope(given).join(calibration), observations)
    drift = source.imu.mean_drift / np.repeat([MILLI_G_M_S2, DEG_PER_HOUR_RAD_S], 3)
    added = dict(zip((*(f"bias {axis}" for axis in AXES), *(f"gyroscope bias {axis}" for axis in AXES)), drift, strict=True))
    numbers = tuple(replace(number, value=number.value - added.get(number.name, 0.0)) for number in found.numbers)
    return replace(found, numbers=numbers)


def imported_moves(imu: Imu, operator: Operator) -> GyroscopeInput:
    """Return what an import makes of a whole session: stills, moves between them, and the accelerometer calibrated."""
    units, site = imu.instrument.grade.units, operator.site
    finder, collector = StillIntervalFinder(units, RoughScale.of_units(units)), MoveCollector(units)
    count = int(operator.plan_all() / imu.interval_s)
    for first in range(0, count, _BLOCK):
        block = imu.feed(operator.block(first, min(_BLOCK, count - first), imu.interval_s))
        finder.feed(block)
        collector.feed(block)
    observations = finder.finish().observations
    gravity = Gravity(gravity_m_s2=site.gravity_m_s2, sigma_m_s2=1e-5, source="measured", latitude_deg=site.latitude_deg)
    return GyroscopeInput(
        observations=observations,
        moves=collector.finish(observations.start_s, observations.duration_s),
        calibration=calibrate_accelerometer(observations, gravity),
        latitude_deg=site.latitude_deg,
    )


def _gauge_free(calibration: Calibration, observations: Observations) -> GaugeFree:
    sigma_raw = np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
    return gauge_free(calibration, observations.mean_raw, sigma_raw)


def site_gravity() -> Gravity:
    """Return the gravity that a person takes from the latitude."""
    return choose_gravity(latitude_deg=LATITUDE_DEG)
