"""PX4 parameters in a file of QGroundControl.

``out = R_rot ((raw - OFF) .* SCALE)``, gyroscope offsets only (src/lib/sensor_calibration).
"""

from __future__ import annotations

import numpy as np

from imufield.dataclass import replace
from imufield.deliver.exports.conventions import Corrections
from imufield.deliver.exports.flight_stack import (
    Fit,
    FlightStack,
    Values,
    format_value,
    known_values,
    names_without_value,
    triad_values,
)
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import comment, text_file
from imufield.deliver.exports.thermal import ThermalOffsets

# MAX_SENSOR_COUNT in src/lib/sensor_calibration/Accelerometer.hpp and Gyroscope.hpp; min and max of CAL_ACC*_*SCALE in
# src/modules/sensors/module.yaml.
PX4 = FlightStack(name="PX4", instances=4, scale_range=(0.1, 3.0))
STEP = 0.01
"""PX4 takes only what changes the offsets or the scales by more than this, root of the sum of squares; at each start they are 0
and 1 (``set_offset`` and ``set_scale`` in src/lib/sensor_calibration, since PX4#16920; 0.001 before)."""
# Types of a value in a QGroundControl file: MAV_PARAM_TYPE of MAVLink (common.xml).
_INT32 = 6
_REAL32 = 9


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope; raises as ``FlightStack.fit``."""
    fit, options = PX4.fit(job), job.options
    values = triad_values(f"CAL_ACC{options.instance}", options.accelerometer_id, {"_%sOFF": fit.offset, "_%sSCALE": fit.scale})
    if fit.rate_offset is not None:
        values |= triad_values(f"CAL_GYRO{options.instance}", options.gyroscope_id, {"_%sOFF": fit.rate_offset})
    if fit.thermal is not None:
        values |= _over_temperature(fit.thermal, job)
    notes = []
    if names := names_without_value(values):
        notes.append(sentence("px4.no_id", names=names, options=fit.ids_to_set(job)))
    notes += [
        sentence("px4.frame"),
        sentence("flight_stack.single_precision", program=PX4.name),
        sentence("px4.replaces"),
        sentence("px4.learns"),
    ]
    if fit.rate_offset is not None:
        notes.append(sentence("px4.learns_rates"))
    if fit.thermal is not None:
        notes.append(sentence("thermal.px4_order"))
    model, ignored = _as_px4_takes(job, fit)
    lacks = sentence("px4.ignores", ignored=" and ".join(ignored), limit=STEP) if ignored else sentence("flight_stack.lacks")
    # Vehicle 1, component 1 (autopilot), name, value, type: the columns of a QGroundControl file.
    heading = ["Onboard parameters for Vehicle 1", "", *job.heading(), "", "Vehicle-Id Component-Id Name Value Type"]
    types = {name: _INT32 if isinstance(value, int) else _REAL32 for name, value in values.items()}
    lines = [f"1\t1\t{name}\t{format_value(value)}\t{types[name]}" for name, value in known_values(values).items()]
    return replace(fit, model=model).draft({"px4.params": text_file([*comment(heading), *lines])}, lacks, tuple(notes))


def _as_px4_takes(job: Job, fit: Fit) -> tuple[Corrections, list[str]]:
    """Return what PX4 computes, and the names of the vectors it ignores."""
    scale, zero = job.accelerometer_si()
    accelerometer, ignored = fit.model.accelerometer, []
    if np.linalg.norm(fit.offset) <= STEP:
        accelerometer, ignored = replace(accelerometer, offset=zero), ["offsets"]
    if np.linalg.norm(fit.scale - 1) <= STEP:
        accelerometer, ignored = replace(accelerometer, matrix=np.eye(3) / scale), [*ignored, "scales"]
    return replace(fit.model, accelerometer=accelerometer), ignored


def _over_temperature(thermal: ThermalOffsets, job: Job) -> Values:
    """Return the polynomials about the reference."""
    values: Values = {}
    ids = {"accelerometer": ("A", job.options.accelerometer_id), "gyroscope": ("G", job.options.gyroscope_id)}
    for triad, coefficients in thermal.coefficients.items():
        letter, device_id = ids[triad]
        start = f"TC_{letter}{job.options.instance}"
        values[f"TC_{letter}_ENABLE"] = 1
        values |= {f"{start}_ID": device_id, f"{start}_TREF": thermal.reference_degc}
        values |= {f"{start}_TMIN": thermal.range_degc[0], f"{start}_TMAX": thermal.range_degc[1]}
        for power, row in enumerate([np.zeros(3), *coefficients]):
            values |= {f"{start}_X{power}_{axis}": float(value) for axis, value in enumerate(row)}
    return values
