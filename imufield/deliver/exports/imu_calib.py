"""ROS imu_calib (dpkoch): ``SM raw - bias``, accelerometer only, SM by rows."""

from __future__ import annotations

from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job
from imufield.deliver.exports.text import comment, row, text_file


def export(job: Job) -> Draft:
    """Return the YAML that its node apply_calib reads."""
    corrections = job.corrections(job.free_frame)
    si = job.in_si(corrections)
    lines = [
        *comment([*job.heading(), *job.example(si)[:1]]),
        # accel_calib.cpp of dpkoch/imu_calib: loadCalib reads nine numbers of SM by rows, and applyCalib takes bias off last.
        f"SM: [{row(si.accelerometer.matrix.ravel())}]",
        f"bias: [{row(si.accelerometer.output_offset)}]",
    ]
    # The node averages the gyroscope itself, which makes it a correction by bias alone.
    note = ("imu_calib takes the gyroscope's bias from the first still samples at each start (calibrate_gyros)",)
    return Draft(
        files={"imu_calib.yaml": text_file(lines)},
        target_model=job.gyroscope_bias_only(corrections),
        gyroscope_lacks=BIAS_ONLY,
        notes=note if corrections.gyroscope is not None else (),
    )
