"""Kalibr imu.yaml, scale-misalignment: error direction, M lower triangular.

``raw = M a + b`` and ``raw_g = M_g C_gyro_i w + A C_gyro_i a + b_g`` (IccSensors.py); biases are no part of the file.
"""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.conventions import rotation_times_triangle
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import comment, text_file, yaml_lines
from imufield.deliver.exports.vio import bias_lines, bias_loss, imu_lines


def export(job: Job) -> Draft:
    """Return imu.yaml."""
    corrections = job.corrections(job.fixed_frame("lower"))
    si = job.in_si(corrections)
    imu, unknown = imu_lines(job)
    lines = [
        *comment([*job.heading(), *bias_lines(si), *job.example(si)]),
        *imu,
        "  model: scale-misalignment",
        "  rostopic: /imu0",
        "  time_offset: 0.0",
        *yaml_lines({"accelerometers": {"M": np.tril(si.accelerometer.error_matrix)}}, 2),
    ]
    if si.gyroscope is not None:
        # raw_g = M_g (C w) + A (C a): the gyroscope's own frame, in which its matrix is triangular too.
        turn, triangle = rotation_times_triangle(si.gyroscope.matrix, "lower")
        M = np.tril(np.asarray(np.linalg.inv(np.tril(triangle)), dtype=np.float64))
        lines += yaml_lines({"gyroscopes": {"M": M, "A": si.g_sensitivity @ turn, "C_gyro_i": turn.T}}, 2)
    return Draft(
        files={"imu.yaml": text_file(lines)},
        target_model=corrections,
        losses=bias_loss(si),
        notes=(sentence("kalibr.results"), *unknown),
    )
