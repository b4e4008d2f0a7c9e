"""PX4: ``out = R_rot ((raw - OFF) .* SCALE)``, gyroscope offsets only (src/lib/sensor_calibration), file of QGroundControl."""

from __future__ import annotations

from imufield.deliver.exports.flight_stack import LACKS_ACCELEROMETER, LACKS_GYROSCOPE, flight_stack
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, number, text_file
from imufield.errors import UsageError

INSTANCES = 4
# MAV_PARAM_TYPE.
_INT32 = 6
_REAL32 = 9


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope."""
    instance, options = job.options.instance, job.options
    if not 0 <= instance < INSTANCES:
        raise UsageError(f"PX4 has {INSTANCES} sensors of a kind, 0 to {INSTANCES - 1}, and instance is {instance}")
    stack = flight_stack(job)
    lines = _triad(f"CAL_ACC{instance}", options.accelerometer_id, job.temperature_degc())
    lines += _vector(f"CAL_ACC{instance}_", "OFF", stack.offset.tolist())
    lines += _vector(f"CAL_ACC{instance}_", "SCALE", stack.scale.tolist())
    if stack.gyroscope_offset is not None:
        lines += _triad(f"CAL_GYRO{instance}", options.gyroscope_id, job.temperature_degc())
        lines += _vector(f"CAL_GYRO{instance}_", "OFF", stack.gyroscope_offset.tolist())
    heading = ["Onboard parameters for Vehicle 1", "", *job.heading(), "", "Vehicle-Id Component-Id Name Value Type"]
    notes = [
        "the numbers are in the sensor's own frame, before the rotations CAL_ACCn_ROT and SENS_BOARD_ROT, which stay",
        "PX4 keeps single precision (relative error up to 6e-8)",
    ]
    if options.accelerometer_id is None:
        notes.insert(
            0, f"CAL_ACC{instance}_ID is not in the file: PX4 applies a calibration only where it is the sensor's device ID"
        )
    content = text_file([*comment(heading), *lines])
    return Draft(
        files={"px4.params": content},
        held=stack.held,
        accelerometer_lacks=LACKS_ACCELEROMETER,
        gyroscope_lacks=LACKS_GYROSCOPE,
        notes=tuple(notes),
    )


def _triad(prefix: str, device_id: int | None, temperature_degc: float | None) -> list[str]:
    lines = [] if device_id is None else [_line(f"{prefix}_ID", str(device_id), _INT32)]
    if temperature_degc is not None:
        lines.append(_line(f"{prefix}_TEMP", number(temperature_degc), _REAL32))
    return lines


def _vector(prefix: str, name: str, values: list[float]) -> list[str]:
    return [_line(f"{prefix}{axis}{name}", number(value), _REAL32) for axis, value in zip("XYZ", values, strict=True)]


def _line(name: str, value: str, kind: int) -> str:
    return f"1\t1\t{name}\t{value}\t{kind}"
