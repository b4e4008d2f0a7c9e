"""DLIO and ROS imu_calib (dpkoch): ``SM raw - bias`` for the accelerometer, at most a bias for the gyroscope, in YAML."""

from __future__ import annotations

from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job, sentence
from imufield.deliver.exports.text import comment, text_file, yaml_lines


def export(job: Job) -> Draft:
    """Return the part of dlio.yaml that concerns the IMU, or the YAML that the node apply_calib of imu_calib reads."""
    corrections = job.corrections(job.free_frame)
    si = job.in_si(corrections)
    matrix, bias = si.accelerometer.matrix.ravel(), si.accelerometer.output_offset
    lines = comment([*job.heading(), *job.example(si)[:1]])
    if job.target.name == "dlio":
        notes = [sentence("ros_yaml.dlio"), sentence("ros_yaml.dlio_frame"), sentence("ros_yaml.dlio_level")]
        # dlio.yaml: with calibration true, DLIO averages the biases at the start and ignores the numbers below.
        gyroscope = {} if si.gyroscope is None else {"gyro": {"bias": si.gyroscope.offset}}
        intrinsics = {"accel": {"bias": bias, "sm": matrix}, **gyroscope}
        lines += yaml_lines({"dlio": {"imu": {"calibration": False, "intrinsics": intrinsics}}})
    else:
        # accel_calib.cpp of dpkoch/imu_calib: loadCalib reads nine numbers of SM by rows, and applyCalib takes bias off last.
        lines += yaml_lines({"SM": matrix, "bias": bias})
        # The node averages the gyroscope itself, which makes it a correction by bias alone.
        notes = [sentence("ros_yaml.imu_calib_raw")]
        notes += [sentence("ros_yaml.imu_calib")] if corrections.gyroscope is not None else []
    return Draft(
        files={f"{job.target.name}.yaml": text_file(lines)},
        target_model=job.gyroscope_bias_only(corrections),
        gyroscope_lacks=BIAS_ONLY,
        notes=tuple(notes),
    )
