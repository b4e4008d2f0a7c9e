"""PX4: ``out = R_rot ((raw - OFF) .* SCALE)``, gyroscope offsets only (src/lib/sensor_calibration), file of QGroundControl."""

from __future__ import annotations

from imufield.deliver.exports.flight_stack import ParameterNames, flight_stack, flight_stack_draft, parameter_values
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, number, text_file
from imufield.errors import UsageError

INSTANCES = 4  # MAX_SENSOR_COUNT in src/lib/sensor_calibration/Accelerometer.hpp and Gyroscope.hpp.
# Types of a value in a QGroundControl file: MAV_PARAM_TYPE of MAVLink (common.xml).
_INT32 = 6
_REAL32 = 9


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope."""
    instance = job.options.instance
    if not 0 <= instance < INSTANCES:
        raise UsageError(f"PX4 has {INSTANCES} sensors of a kind, 0 to {INSTANCES - 1}, and instance is {instance}")
    stack = flight_stack(job)
    accelerometer, gyroscope = (
        ParameterNames(f"{prefix}_ID", f"{prefix}_TEMP", f"{prefix}_%sOFF", f"{prefix}_%sSCALE")
        for prefix in (f"CAL_ACC{instance}", f"CAL_GYRO{instance}")
    )
    lines = [
        # Vehicle 1, component 1 (autopilot), name, value, type: the columns of a QGroundControl file.
        f"1\t1\t{name}\t{value}\t{_INT32}" if isinstance(value, int) else f"1\t1\t{name}\t{number(value)}\t{_REAL32}"
        for name, value in parameter_values(job, stack, accelerometer, gyroscope).items()
    ]
    heading = ["Onboard parameters for Vehicle 1", "", *job.heading(), "", "Vehicle-Id Component-Id Name Value Type"]
    notes = [
        "the numbers are in the sensor's own frame, before the rotations CAL_ACCn_ROT and SENS_BOARD_ROT, which stay",
        "PX4 keeps single precision (relative error up to 6e-8)",
    ]
    if job.options.accelerometer_id is None:
        notes.insert(
            0, f"CAL_ACC{instance}_ID is not in the file: PX4 applies a calibration only where it is the sensor's device ID"
        )
    return flight_stack_draft(stack, "px4.params", text_file([*comment(heading), *lines]), notes)
