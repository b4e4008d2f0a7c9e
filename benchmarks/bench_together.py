"""Twenty sessions of one instrument solved together, every parameter and second order in temperature; a history judged.

Sessions are simulated, 24 positions by hand and the moves between them, both triads; timed is what follows reading: each
session's accelerometer with quadratic term, its gyroscope with g-sensitivity, their gauge-free numbers, the joint adjustment of
them all, and bias and scale of both triads over temperature. Imports are done before.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.model.result import Calibration
from imufield.calibrate.sessions.changes import DatedNumbers, judge
from imufield.calibrate.sessions.joint import Joint, SessionNumbers, adjust
from imufield.calibrate.temperature.fit import TemperatureData, fit_orders
from imufield.calibrate.temperature.points import accelerometer_points, gyroscope_points
from imufield.deliver.parameters.gauge_free import GaugeFree, gauge_free
from imufield.deliver.parameters.joined import numbers_of, prior_scales
from imufield.guide.positions import scheme
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.operator import OperatorSettings
from imufield.study.answers.recorded import imported_moves

SESSIONS = 20
LIMIT_S = 2.0
GRADE = "tactical"
ROUNDS = 3
ORDER = 2


def make_session(day: int) -> GyroscopeInput:
    """Simulate one day of the instrument."""
    habits = OperatorSettings(hold_s=5.0, initial_still_s=8.0)
    up = scheme("paper24").directions()
    drawn = make_virtual_imu(Emulation(rate_hz=100.0, grade=GRADE, seed=1, day=day, directions=up, operator=habits))
    return imported_moves(drawn.imu, drawn.operator)


def solve(given: GyroscopeInput) -> tuple[Calibration, GaugeFree]:
    """Solve one session with every parameter."""
    observations = given.observations
    accelerometer = calibrate_accelerometer(observations, given.calibration.gravity, model="quadratic", grade=GRADE)
    found = calibrate_gyroscope(replace(given, calibration=accelerometer, grade=GRADE), model="g-sensitive")
    calibration = found.join(accelerometer)
    sigma_raw = np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
    return calibration, gauge_free(calibration, observations.mean_raw, sigma_raw)


def gathered(solved: list[tuple[Calibration, GaugeFree]]) -> list[SessionNumbers]:
    """Return the numbers of all sessions."""
    reference = solved[-1][1]
    return [numbers_of(calibration, found, reference).own for calibration, found in solved]


def over_temperature(solved: list[tuple[Calibration, GaugeFree]]) -> None:
    """Fit bias and scale of both triads, as if each session had been a few degrees warmer than the one before."""
    at_degc = np.linspace(-20.0, 60.0, len(solved)).tolist()
    calibrations = [calibration for calibration, _ in solved]
    gyroscopes = [calibration.gyroscope for calibration in calibrations if calibration.gyroscope is not None]
    base = len(solved) // 2
    points = (
        accelerometer_points(calibrations[base].accelerometer, calibrations, at_degc),
        gyroscope_points(gyroscopes[base].parameters, gyroscopes, at_degc),
    )
    for of_triad in points:
        fit_orders(TemperatureData(reference_degc=at_degc[base], points=of_triad, ramps=[]), ORDER, ORDER)


def together(given: list[GyroscopeInput]) -> Joint:
    """Solve all sessions as one."""
    solved = [solve(session) for session in given]
    over_temperature(solved)
    return adjust(gathered(solved), prior_scales(GRADES[GRADE]))


def dated(numbers: list[SessionNumbers]) -> list[DatedNumbers]:
    """Return the sessions as a history, a month apart."""
    return [
        DatedNumbers(
            day=30.0 * k,
            names=each.names,
            values=each.values,
            covariance=each.covariance,
            freedom=np.full(len(each.names), float(each.freedom)),
            setup="",
            hidden=np.zeros_like(each.covariance),
            site=each.site,
            by_gravity=each.by_gravity,
        )
        for k, each in enumerate(numbers)
    ]


def best_s(action: Callable[[], object]) -> float:
    """Return the best processor time of some rounds, s: what waits for other programs is not counted."""
    times = []
    for _ in range(ROUNDS):
        before = time.process_time()
        action()
        times.append(time.process_time() - before)
    return min(times)


def run() -> list[dict[str, Any]]:
    """Return every figure as a row."""
    given = [make_session(day) for day in range(SESSIONS)]
    solved = [solve(session) for session in given]
    numbers = gathered(solved)
    what = f"{SESSIONS} sessions of 24 positions, {len(numbers[0].names)} numbers each"
    prior = prior_scales(GRADES[GRADE])
    times = {
        f"{what}, together (limit {LIMIT_S:g} s)": best_s(lambda: together(given)),
        "of it the joint adjustment": best_s(lambda: adjust(numbers, prior)),
        "of it over temperature, order 2": best_s(lambda: over_temperature(solved)),
        f"{what}, judged as a history": best_s(lambda: judge(dated(numbers))),
    }
    return [{"name": name, "value": value, "unit": "s"} for name, value in times.items()]


if __name__ == "__main__":
    for line in run():
        print(f"{line['name']:<80} {line['value']:9.3f} {line['unit']}")
