"""Sessions at several temperatures: how often the stated 95 % of bias and scale hold on a new day, at one never measured."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imufield.calibrate.model.coverage_factors import student_factor
from imufield.calibrate.model.grades import GRADES, Grade
from imufield.calibrate.model.models import at_temperature
from imufield.calibrate.model.result import AccelerometerParameters
from imufield.calibrate.model.uncertainty import rms
from imufield.calibrate.temperature.fit import TemperatureData, fit_temperature
from imufield.calibrate.temperature.points import accelerometer_points
from imufield.earth import MILLI_G_M_S2
from imufield.samples import FloatArray
from imufield.study.answers.tables import Rows, Study, Table
from imufield.study.answers.temperature import REFERENCE_DEGC, cheap_chip, linear_truth, of_day, solved

AT_DEGC = {3: (-10.0, 20.0, 50.0), 5: (-10.0, 5.0, 20.0, 35.0, 50.0)}
"""Sessions over 60 degC; the reference is the one at 20."""
BENT = 0.5
"""Quadratic term 30 degC from the reference, in the straight line's."""
_DAY_PPM_OF_SCALE = 0.2  # Share of what a maker leaves in the scale: the days of no instrument differ by all of that.
_AWAY_DEGC = 30.0


def covered(sessions: int, order: int, grade: Grade, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Calibrate an instrument on days at several temperatures, and hold what is stated for another against that day."""
    truth = linear_truth(grade, rng)
    sizes = np.array([[1.0], [BENT / _AWAY_DEGC]])[:order]
    over = cheap_chip((AT_DEGC[5][0], AT_DEGC[5][-1]), sizes, sizes, rng)
    repeated = grade.accelerometer.turn_on, _DAY_PPM_OF_SCALE * grade.accelerometer.scale_ppm

    def day_at(degc: float) -> AccelerometerParameters:
        return of_day(at_temperature(truth, over, degc), *repeated, rng)

    at_degc = AT_DEGC[sessions]
    found = [solved(day_at(degc), grade, rng) for degc in at_degc]
    reference = at_degc.index(REFERENCE_DEGC)
    base = found[reference]
    points = accelerometer_points(base.accelerometer, found, at_degc, reference)
    model = fit_temperature(TemperatureData(reference_degc=REFERENCE_DEGC, points=points)).temperature
    new_degc = float(rng.uniform(at_degc[0], at_degc[-1]))
    stated, day = (
        at_temperature(base.accelerometer, model, new_degc),
        of_day(at_temperature(truth, over, new_degc), *repeated, rng),
    )
    own = base.accelerometer_sigma
    bias_sigma, scale_sigma = model.sigma_there(new_degc, own.bias_m_s2, own.scale / base.accelerometer.scale)
    if model.new_day is None:
        raise ValueError("three sessions at three temperatures show how days differ")
    bias_off, scale_off = stated.bias_m_s2 - day.bias_m_s2, stated.scale / day.scale - 1
    return {
        "bias": _inside(bias_off, bias_sigma, model.new_day.bias_freedom),
        "scale": _inside(scale_off, scale_sigma, model.new_day.scale_freedom),
        "bias_mg": bias_off / MILLI_G_M_S2,
        "scale_ppm": 1e6 * scale_off,
        "order": model.bias.order == order,
    }


def _inside(off: FloatArray, sigma: FloatArray, freedom: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(off) <= student_factor(freedom) * sigma)


_WAYS = {"five sessions, quadratic": (5, 2), "three sessions, linear": (3, 1)}
_ROWS: Rows = {
    f"{way}, {name}": partial(covered, *numbers, grade) for way, numbers in _WAYS.items() for name, grade in GRADES.items()
}
temperatures = Study(
    Table(
        label="instruments",
        campaign="answers-new-day",
        rows=_ROWS,
        runs=(1000, 1),
        statistics={"bias_mg": rms, "scale_ppm": rms},
    )
)
