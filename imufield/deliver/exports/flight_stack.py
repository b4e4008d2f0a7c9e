"""PX4 and ArduPilot: scale and bias of the accelerometer, bias of the gyroscope, nothing else.

PX4: ``out = R_rot ((raw - OFF) .* SCALE)``, gyroscope offsets only (src/lib/sensor_calibration), file of QGroundControl.
ArduPilot: ``accel = (raw - OFFS) .* SCAL`` and ``gyro = raw - OFFS``, then board rotation (AP_InertialSensor_Backend).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.deliver.exports.conventions import Correction, diagonal_corrections
from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job, sentence
from imufield.deliver.exports.text import comment, number, text_file
from imufield.deliver.exports.thermal import ThermalOffsets
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.samples import AXES, FloatArray

INSTANCES = {
    "px4": 4,  # MAX_SENSOR_COUNT in src/lib/sensor_calibration/Accelerometer.hpp and Gyroscope.hpp.
    "ardupilot": 5,  # INS_MAX_INSTANCES, 3, and INS_AUX_INSTANCES, up to 2 (AP_InertialSensor_config.h).
}
# @Range of ACCOFFS and ACCSCAL in AP_InertialSensor.cpp: values beyond are the sign of a wrong unit.
ARDUPILOT_LIMITS = {"offset": (-3.5, 3.5), "scale": (0.8, 1.2)}
# Types of a value in a QGroundControl file: MAV_PARAM_TYPE of MAVLink (common.xml).
_INT32 = 6
_REAL32 = 9


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope.

    Raises
    ------
    ParameterFileError
        If an axis is reversed: these programs know positive scales only.
    """
    is_px4, instance, most = job.target.name == "px4", job.options.instance, INSTANCES[job.target.name]
    program = "PX4" if is_px4 else "ArduPilot"
    if not 0 <= instance < most:
        raise UsageError(sentence("flight_stack.instance", program=program, most=most, last=most - 1, instance=instance))
    corrections = diagonal_corrections(job.parameters.calibration)
    si = job.in_si(corrections)
    offset, scale = si.accelerometer.offset, np.diag(si.accelerometer.matrix)
    job.require_positive("accelerometer", scale)
    target_model = job.gyroscope_bias_only(corrections)
    single_precision = sentence("flight_stack.single_precision", program=program)
    values = _values(job, offset, scale, si.gyroscope)
    thermal = ThermalOffsets(job) if job.parameters.temperature_models else None
    if thermal is not None:
        values |= thermal.px4() if is_px4 else thermal.ardupilot()
    if is_px4:
        # Vehicle 1, component 1 (autopilot), name, value, type: the columns of a QGroundControl file.
        heading = ["Onboard parameters for Vehicle 1", "", *job.heading(), "", "Vehicle-Id Component-Id Name Value Type"]
        types = {name: _INT32 if isinstance(value, int) else _REAL32 for name, value in values.items()}
        lines = [f"1\t1\t{name}\t{_shown(value)}\t{types[name]}" for name, value in values.items()]
        notes = [sentence("flight_stack.px4_frame"), single_precision]
        if job.options.accelerometer_id is None:
            notes.insert(0, sentence("flight_stack.px4_no_id", name=f"CAL_ACC{instance}_ID"))
    else:
        _check_ranges({"offset": offset, "scale": scale})
        heading = job.heading()
        lines = [f"{name},{_shown(value)}" for name, value in values.items()]
        notes = [sentence("flight_stack.ardupilot_frame"), single_precision]
        if si.gyroscope is not None:
            notes.append(sentence("flight_stack.learns"))
        if not np.any(offset) and np.all(scale == 1):
            notes.append(sentence("flight_stack.not_calibrated"))
    if thermal is not None:
        notes.append(sentence("thermal.px4_order" if is_px4 else "thermal.ardupilot_order"))
    draft = Draft(
        files={"px4.params" if is_px4 else "ardupilot.param": text_file([*comment(heading), *lines])},
        target_model=target_model,
        accelerometer_lacks=sentence("flight_stack.lacks"),
        gyroscope_lacks=BIAS_ONLY,
        notes=tuple(notes),
    )
    return draft if thermal is None else replace(draft, losses=thermal.loss(draft))


def _values(job: Job, offset: FloatArray, scale: FloatArray, gyroscope: Correction | None) -> dict[str, int | float]:
    """Return the value of each parameter by its name: an int for a device ID, a float for all others."""
    instance, options = job.options.instance, job.options
    if job.target.name == "px4":
        names = (f"CAL_ACC{instance}", f"CAL_GYRO{instance}")
        temperatures, places = [f"{name}_TEMP" for name in names], ("_%sOFF", "_%sSCALE")
    else:
        # The names grew with the program: INS_ACC, INS_ACC2, INS_ACC3, and from the fourth on INS4_ACC, INS5_ACC.
        group = "INS" if instance < 3 else f"INS{instance + 1}"
        digit = str(instance + 1) if instance in (1, 2) else ""
        names = (f"{group}_ACC{digit}", f"{group}_GYR{digit}")
        # Of the first, these alone have its number (AP_InertialSensor.cpp, ``_ACC1_CALTEMP``).
        own = "1" if instance == 0 else digit
        temperatures = [f"{group}_{triad}{own}_CALTEMP" for triad in ("ACC", "GYR")]
        places = ("OFFS_%s", "SCAL_%s")
    triads = [(names[0], temperatures[0], options.accelerometer_id, [offset, scale])]
    if gyroscope is not None:
        triads.append((names[1], temperatures[1], options.gyroscope_id, [gyroscope.offset]))
    low, high = job.parameters.context.session.temperature_degc
    if models := job.parameters.temperature_models:
        # Exactly there the offset over temperature is zero.
        low = high = models[0].reference_degc
    values: dict[str, int | float] = {}
    for name, temperature, device_id, vectors in triads:
        if device_id is not None:
            values[f"{name}_ID"] = device_id
        if not np.isnan(low + high):
            values[temperature] = (low + high) / 2
        for place, vector in zip(places, vectors, strict=False):
            values |= {name + place % axis: float(value) for axis, value in zip("XYZ", vector, strict=True)}
    return values


def _check_ranges(vectors: dict[str, FloatArray]) -> None:
    for what, values in vectors.items():
        low, high = ARDUPILOT_LIMITS[what]
        for axis, value in zip(AXES, values.tolist(), strict=True):
            if not low <= value <= high:
                refused = sentence("flight_stack.range", what=what, low=low, high=high, axis=axis, value=value)
                raise ParameterFileError(refused, Reason.BOUNDS)


def _shown(value: float) -> str:
    return str(value) if isinstance(value, int) else number(value)
