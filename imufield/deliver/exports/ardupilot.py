"""ArduPilot: ``accel = (raw - OFFS) .* SCAL`` and ``gyro = raw - OFFS``, then board rotation (AP_InertialSensor_Backend)."""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.flight_stack import LACKS_ACCELEROMETER, LACKS_GYROSCOPE, FlightStack, flight_stack
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, number, text_file
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.samples import AXES, FloatArray

INSTANCES = 5
OFFSET_LIMIT_M_S2 = 3.5
SCALE_LIMITS = (0.8, 1.2)


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope."""
    options = job.options
    if not 0 <= options.instance < INSTANCES:
        raise UsageError(
            f"ArduPilot has {INSTANCES} inertial sensors, 0 to {INSTANCES - 1}, and instance is {options.instance}"
        )
    stack = flight_stack(job)
    _require_range("offset", stack.offset, -OFFSET_LIMIT_M_S2, OFFSET_LIMIT_M_S2)
    _require_range("scale", stack.scale, *SCALE_LIMITS)
    accelerometer, gyroscope = _prefixes(options.instance)
    temperature_degc = job.temperature_degc()
    lines = _identity(accelerometer, options.accelerometer_id, temperature_degc)
    lines += _vector(f"{accelerometer}OFFS", stack.offset) + _vector(f"{accelerometer}SCAL", stack.scale)
    if stack.gyroscope_offset is not None:
        lines += _identity(gyroscope, options.gyroscope_id, temperature_degc)
        lines += _vector(f"{gyroscope}OFFS", stack.gyroscope_offset)
    content = text_file([*comment(job.heading()), *lines])
    return Draft(
        files={"ardupilot.param": content},
        held=stack.held,
        accelerometer_lacks=LACKS_ACCELEROMETER,
        gyroscope_lacks=LACKS_GYROSCOPE,
        notes=_notes(stack),
    )


def _notes(stack: FlightStack) -> tuple[str, ...]:
    notes = [
        "the numbers are in the sensor's own frame, before the board rotation",
        "ArduPilot keeps single precision (relative error up to 6e-8)",
    ]
    if stack.gyroscope_offset is not None:
        notes.append("ArduPilot learns the gyroscope offsets anew at each start unless INS_GYR_CAL is 0")
    if not np.any(stack.offset) and np.all(stack.scale == 1):
        notes.append("offsets of exactly 0 with scales of exactly 1 count as not calibrated in ArduPilot")
    return tuple(notes)


def _prefixes(instance: int) -> tuple[str, str]:
    """Return the start of the names: INS_ACC, INS_ACC2, INS_ACC3, INS4_ACC, INS5_ACC."""
    group = "INS" if instance < 3 else f"INS{instance + 1}"
    digit = str(instance + 1) if instance in (1, 2) else ""
    return f"{group}_ACC{digit}", f"{group}_GYR{digit}"


def _identity(prefix: str, device_id: int | None, temperature_degc: float | None) -> list[str]:
    lines = [] if device_id is None else [f"{prefix}_ID,{device_id}"]
    if temperature_degc is not None:
        lines.append(f"{prefix}_CALTEMP,{number(temperature_degc)}")
    return lines


def _vector(prefix: str, values: FloatArray) -> list[str]:
    return [f"{prefix}_{axis.upper()},{number(value)}" for axis, value in zip(AXES, values.tolist(), strict=True)]


def _require_range(what: str, values: FloatArray, low: float, high: float) -> None:
    for axis, value in zip(AXES, values.tolist(), strict=True):
        if not low <= value <= high:
            raise ParameterFileError(
                f"ArduPilot takes an accelerometer {what} of {low:g} to {high:g} and axis {axis} has {value:.6g}; correct the "
                "unit or scale in the driver first",
                Reason.BOUNDS,
                axis=axis,
                value=value,
            )
