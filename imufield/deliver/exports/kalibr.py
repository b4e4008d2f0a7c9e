"""Kalibr imu.yaml, scale-misalignment: error direction, M lower triangular.

``raw = M a + b`` and ``raw_g = M_g C_gyro_i w + A C_gyro_i a + b_g`` (IccSensors.py); biases are no part of the file.
"""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.conventions import Corrections, rotation_times_triangle
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, text_file, yaml_matrix
from imufield.deliver.exports.vio import bias_lines, bias_loss, noise_lines


def export(job: Job) -> Draft:
    """Return imu.yaml."""
    held = job.corrections(job.fixed_frame("lower"))
    si = job.in_si(held)
    noise, unknown = noise_lines(job, 2)
    lines = [
        *comment([*job.heading(), *bias_lines(si), *job.example(si)]),
        "imu0:",
        "  T_i_b:",
        *yaml_matrix(np.eye(4), 4),
        *noise,
        "  model: scale-misalignment",
        "  rostopic: /imu0",
        "  time_offset: 0.0",
        "  accelerometers:",
        "    M:",
        *yaml_matrix(np.tril(si.accelerometer.error_matrix), 6),
        *_gyroscopes(si),
    ]
    return Draft(files={"imu.yaml": text_file(lines)}, held=held, losses=bias_loss(si), notes=unknown)


def _gyroscopes(si: Corrections) -> list[str]:
    if si.gyroscope is None:
        return []
    turn, triangle = rotation_times_triangle(si.gyroscope.matrix, "lower")
    M = np.tril(np.asarray(np.linalg.inv(np.tril(triangle)), dtype=np.float64))
    return [
        "  gyroscopes:",
        "    M:",
        *yaml_matrix(M, 6),
        "    A:",
        *yaml_matrix(si.g_sensitivity @ turn, 6),
        "    C_gyro_i:",
        *yaml_matrix(turn.T, 6),
    ]
