"""ArduPilot: ``accel = (raw - OFFS) .* SCAL`` and ``gyro = raw - OFFS``, then board rotation (AP_InertialSensor_Backend)."""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.flight_stack import ParameterNames, flight_stack, flight_stack_draft, parameter_values
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, number, text_file
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.samples import AXES

INSTANCES = 5  # INS_MAX_INSTANCES, 3, and INS_AUX_INSTANCES, up to 2 (AP_InertialSensor_config.h).
# @Range of ACCOFFS and ACCSCAL in AP_InertialSensor.cpp: values beyond are the sign of a wrong unit.
OFFSET_LIMIT_M_S2 = 3.5
SCALE_LIMITS = (0.8, 1.2)


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope."""
    instance = job.options.instance
    if not 0 <= instance < INSTANCES:
        raise UsageError(f"ArduPilot has {INSTANCES} inertial sensors, 0 to {INSTANCES - 1}, and instance is {instance}")
    stack = flight_stack(job)
    limits = {"offset": (-OFFSET_LIMIT_M_S2, OFFSET_LIMIT_M_S2), "scale": SCALE_LIMITS}
    for what, values in {"offset": stack.offset, "scale": stack.scale}.items():
        low, high = limits[what]
        for axis, value in zip(AXES, values.tolist(), strict=True):
            if not low <= value <= high:
                raise ParameterFileError(
                    f"ArduPilot takes an accelerometer {what} of {low:g} to {high:g} and axis {axis} has {value:.6g}; correct "
                    "the unit or scale in the driver first",
                    Reason.BOUNDS,
                    axis=axis,
                    value=value,
                )
    # The names grew with the program: INS_ACC, INS_ACC2, INS_ACC3, and from the fourth on INS4_ACC, INS5_ACC.
    group = "INS" if instance < 3 else f"INS{instance + 1}"
    digit = str(instance + 1) if instance in (1, 2) else ""
    accelerometer, gyroscope = (
        ParameterNames(f"{prefix}_ID", f"{prefix}_CALTEMP", f"{prefix}OFFS_%s", f"{prefix}SCAL_%s")
        for prefix in (f"{group}_ACC{digit}", f"{group}_GYR{digit}")
    )
    lines = [
        f"{name},{value if isinstance(value, int) else number(value)}"
        for name, value in parameter_values(job, stack, accelerometer, gyroscope).items()
    ]
    notes = [
        "the numbers are in the sensor's own frame, before the board rotation",
        "ArduPilot keeps single precision (relative error up to 6e-8)",
    ]
    if stack.gyroscope_offset is not None:
        notes.append("ArduPilot learns the gyroscope offsets anew at each start unless INS_GYR_CAL is 0")
    if not np.any(stack.offset) and np.all(stack.scale == 1):
        notes.append("offsets of exactly 0 with scales of exactly 1 count as not calibrated in ArduPilot")
    return flight_stack_draft(stack, "ardupilot.param", text_file([*comment(job.heading()), *lines]), notes)
