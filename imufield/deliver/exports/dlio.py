"""Direct LiDAR-Inertial Odometry: ``sm raw - bias`` for the accelerometer, ``raw - bias`` for the gyroscope."""

from __future__ import annotations

from imufield.deliver.exports.flight_stack import LACKS_GYROSCOPE, bias_only_gyroscope
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, row, text_file


def export(job: Job) -> Draft:
    """Return the part of dlio.yaml that concerns the IMU."""
    full = job.corrections(job.free_frame)
    si = job.in_si(full)
    lines = [
        *comment([*job.heading(), *job.example(si)[:1]]),
        "dlio:",
        "  imu:",
        "    calibration: false",
        "    intrinsics:",
        "      accel:",
        f"        bias: [{row(si.accelerometer.output_offset.tolist())}]",
        f"        sm: [{row(si.accelerometer.matrix.ravel().tolist())}]",
    ]
    if si.gyroscope is not None:
        lines += ["      gyro:", f"        bias: [{row(si.gyroscope.offset.tolist())}]"]
    notes = ("imu/calibration is false, because DLIO takes these numbers only then; it goes on estimating the biases",)
    held = bias_only_gyroscope(job, full)
    return Draft(files={"dlio.yaml": text_file(lines)}, held=held, gyroscope_lacks=LACKS_GYROSCOPE, notes=notes)
