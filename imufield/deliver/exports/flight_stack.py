"""PX4 and ArduPilot: scale and bias of the accelerometer, bias of the gyroscope, nothing else.

PX4: ``out = R_rot ((raw - OFF) .* SCALE)``, gyroscope offsets only (src/lib/sensor_calibration), file of QGroundControl.
ArduPilot: ``accel = (raw - OFFS) .* SCAL`` and ``gyro = raw - OFFS``, then board rotation (AP_InertialSensor_Backend).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.deliver.exports.conventions import Correction, Corrections, diagonal_corrections
from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job, sentence
from imufield.deliver.exports.text import comment, number, text_file
from imufield.deliver.exports.thermal import ThermalOffsets
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.samples import AXES, FloatArray

INSTANCES = {
    "px4": 4,  # MAX_SENSOR_COUNT in src/lib/sensor_calibration/Accelerometer.hpp and Gyroscope.hpp.
    "ardupilot": 5,  # INS_MAX_INSTANCES, 3, and INS_AUX_INSTANCES, up to 2 (AP_InertialSensor_config.h).
}
# Values beyond are the sign of a wrong unit. ArduPilot: @Range of ACCOFFS and ACCSCAL in AP_InertialSensor.cpp; PX4: min and
# max of CAL_ACC*_*SCALE in src/modules/sensors/module.yaml.
LIMITS = {"px4": {"scale": (0.1, 3.0)}, "ardupilot": {"offset": (-3.5, 3.5), "scale": (0.8, 1.2)}}
PX4_STEP = 0.01
"""PX4 takes only what changes the offsets or the scales by more than this, root of the sum of squares; at each start they are 0
and 1 (``set_offset`` and ``set_scale`` in src/lib/sensor_calibration, since PX4#16920; 0.001 before)."""
# Types of a value in a QGroundControl file: MAV_PARAM_TYPE of MAVLink (common.xml).
_INT32 = 6
_REAL32 = 9


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope.

    Raises
    ------
    ParameterFileError
        If an axis is reversed, as these programs know positive scales only, or a value is outside their range.
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
    _check_ranges(program, LIMITS[job.target.name], {"offset": offset, "scale": scale})
    known = _values(job, offset, scale, si.gyroscope)
    thermal = ThermalOffsets(job) if job.parameters.temperature_models else None
    if thermal is not None:
        known |= thermal.px4() if is_px4 else thermal.ardupilot()
    values = {name: value for name, value in known.items() if value is not None}
    notes = []
    if without_id := [name for name, value in known.items() if value is None]:
        options = " ".join(f"--set {triad}_id=N" for triad in si.triads if getattr(job.options, f"{triad}_id") is None)
        told = {"names": without_id, "options": options}
        notes.append(sentence("flight_stack.px4_no_id" if is_px4 else "flight_stack.ardupilot_no_id", **told))
    lacks = sentence("flight_stack.lacks")
    if is_px4:
        target_model, ignored = _as_px4_takes(job, target_model, si)
        if ignored:
            lacks = sentence("flight_stack.px4_ignores", ignored=" and ".join(ignored), limit=PX4_STEP)
        # Vehicle 1, component 1 (autopilot), name, value, type: the columns of a QGroundControl file.
        heading = ["Onboard parameters for Vehicle 1", "", *job.heading(), "", "Vehicle-Id Component-Id Name Value Type"]
        types = {name: _INT32 if isinstance(value, int) else _REAL32 for name, value in values.items()}
        lines = [f"1\t1\t{name}\t{_shown(value)}\t{types[name]}" for name, value in values.items()]
        notes += [sentence("flight_stack.px4_frame"), single_precision, sentence("flight_stack.px4_learns")]
        if si.gyroscope is not None:
            notes.append(sentence("flight_stack.px4_learns_rates"))
    else:
        heading = job.heading()
        lines = [f"{name},{_shown(value)}" for name, value in values.items()]
        notes += [sentence("flight_stack.ardupilot_frame"), single_precision]
        if si.gyroscope is not None:
            notes.append(sentence("flight_stack.learns"))
        if not np.any(offset):
            notes.append(sentence("flight_stack.not_calibrated"))
    if thermal is not None:
        notes.append(sentence("thermal.px4_order" if is_px4 else "thermal.ardupilot_order"))
    draft = Draft(
        files={"px4.params" if is_px4 else "ardupilot.param": text_file([*comment(heading), *lines])},
        target_model=target_model,
        accelerometer_lacks=lacks,
        gyroscope_lacks=BIAS_ONLY,
        notes=tuple(notes),
    )
    return draft if thermal is None else replace(draft, losses=thermal.loss(draft))


def _as_px4_takes(job: Job, model: Corrections, si: Corrections) -> tuple[Corrections, list[str]]:
    """Return what PX4 computes, and the names of the vectors it ignores."""
    scale, zero = job.accelerometer_si()
    accelerometer, ignored = model.accelerometer, []
    if np.linalg.norm(si.accelerometer.offset) <= PX4_STEP:
        accelerometer, ignored = replace(accelerometer, offset=zero), ["offsets"]
    if np.linalg.norm(np.diag(si.accelerometer.matrix) - 1) <= PX4_STEP:
        accelerometer, ignored = replace(accelerometer, matrix=np.eye(3) / scale), [*ignored, "scales"]
    return replace(model, accelerometer=accelerometer), ignored


def _values(job: Job, offset: FloatArray, scale: FloatArray, gyroscope: Correction | None) -> dict[str, int | float | None]:
    """Return the value of each parameter by its name: an int for a device ID, None where it is not known, else a float."""
    instance, options = job.options.instance, job.options
    temperatures: list[str | None] = [None, None]
    if job.target.name == "px4":
        names = (f"CAL_ACC{instance}", f"CAL_GYRO{instance}")
        places = ("_%sOFF", "_%sSCALE")
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
    values: dict[str, int | float | None] = {}
    for name, temperature, device_id, vectors in triads:
        values[f"{name}_ID"] = device_id
        if temperature is not None and not np.isnan(low + high):
            values[temperature] = (low + high) / 2
        for place, vector in zip(places, vectors, strict=False):
            values |= {name + place % axis: float(value) for axis, value in zip("XYZ", vector, strict=True)}
    return values


def _check_ranges(program: str, limits: dict[str, tuple[float, float]], vectors: dict[str, FloatArray]) -> None:
    for what, (low, high) in limits.items():
        for axis, value in zip(AXES, vectors[what].tolist(), strict=True):
            if not low <= value <= high:
                values = {"what": what, "low": low, "high": high, "axis": axis, "value": value}
                refused = sentence("flight_stack.range", program=program, **values)
                raise ParameterFileError(refused, Reason.BOUNDS)


def _shown(value: float) -> str:
    return str(value) if isinstance(value, int) else number(value)
