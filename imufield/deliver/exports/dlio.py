"""Direct LiDAR-Inertial Odometry: ``sm raw - bias`` for the accelerometer, ``raw - bias`` for the gyroscope."""

from __future__ import annotations

from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job
from imufield.deliver.exports.text import comment, row, text_file


def export(job: Job) -> Draft:
    """Return the part of dlio.yaml that concerns the IMU."""
    corrections = job.corrections(job.free_frame)
    si = job.in_si(corrections)
    lines = [
        *comment([*job.heading(), *job.example(si)[:1]]),
        "dlio:",
        "  imu:",
        # dlio.yaml: with true, DLIO averages the biases at the start and ignores the numbers below.
        "    calibration: false",
        "    intrinsics:",
        "      accel:",
        f"        bias: [{row(si.accelerometer.output_offset)}]",
        f"        sm: [{row(si.accelerometer.matrix.ravel())}]",
    ]
    if si.gyroscope is not None:
        lines += ["      gyro:", f"        bias: [{row(si.gyroscope.offset)}]"]
    return Draft(
        files={"dlio.yaml": text_file(lines)},
        target_model=job.gyroscope_bias_only(corrections),
        gyroscope_lacks=BIAS_ONLY,
        notes=("imu/calibration is false, because DLIO takes these numbers only then; it goes on estimating the biases",),
    )
