"""OpenVINS kalibr_imu_chain.yaml.

``a = R_IMUtoACC^T Ta^-1 (a_m - b_a)`` and ``w = R_IMUtoGYRO^T Tw^-1 (w_m - Tg a - b_g)`` with a in the IMU frame
(ov_msckf, Propagator). Model "kalibr": Ta and Tw lower triangular, the IMU frame is the accelerometer's. Model "rpng": both
upper triangular, the IMU frame is the gyroscope's.
"""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.conventions import Corrections, rotation_times_triangle
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, text_file, yaml_matrix
from imufield.deliver.exports.vio import bias_lines, bias_loss, noise_lines
from imufield.errors import ParameterFileError, Reason
from imufield.samples import FloatArray


def export(job: Job) -> Draft:
    """Return kalibr_imu_chain.yaml."""
    held = _held(job)
    si = job.in_si(held)
    triangle = np.triu if job.options.model == "rpng" else np.tril
    matrices = {
        "Tw": np.eye(3),
        "R_IMUtoGYRO": np.eye(3),
        "Ta": np.eye(3),
        "R_IMUtoACC": np.eye(3),
        "Tg": si.g_sensitivity,
    }
    matrices["R_IMUtoACC"], matrices["Ta"] = _split(si.accelerometer.matrix, job)
    if si.gyroscope is not None:
        matrices["R_IMUtoGYRO"], matrices["Tw"] = _split(si.gyroscope.matrix, job)
    noise, unknown = noise_lines(job, 2)
    lines = [
        "%YAML:1.0",
        *comment([*job.heading(), *bias_lines(si), *job.example(si)]),
        "",
        "imu0:",
        "  T_i_b:",
        *yaml_matrix(np.eye(4), 4),
        *noise,
        "  rostopic: /imu0",
        "  time_offset: 0.0",
        f'  model: "{job.options.model}"',
    ]
    for name, matrix in matrices.items():
        lines += [f"  {name}:", *yaml_matrix(triangle(matrix) if name in ("Ta", "Tw") else matrix, 4)]
    losses = bias_loss(si)
    return Draft(files={"kalibr_imu_chain.yaml": text_file(lines)}, held=held, losses=losses, notes=unknown)


def _held(job: Job) -> Corrections:
    if job.options.model == "kalibr":
        return job.corrections(job.fixed_frame("lower"))
    held = job.corrections(job.fixed_frame("file"))
    if held.gyroscope is None:
        raise ParameterFileError(
            "the IMU frame of OpenVINS' model rpng is the gyroscope's and this file has none with a scale; take model kalibr",
            Reason.UNITS,
        )
    turn, _ = rotation_times_triangle(held.gyroscope.matrix, "upper")
    return held.turned(turn.T)


def _split(matrix: FloatArray, job: Job) -> tuple[FloatArray, FloatArray]:
    """Return R and T of M = R^T T^-1."""
    turn, triangle = rotation_times_triangle(matrix, "upper" if job.options.model == "rpng" else "lower")
    # In its own frame a triad needs no rotation; what is left is rounding.
    turn = np.eye(3) if np.allclose(turn, np.eye(3), atol=1e-14) else turn
    return turn.T, np.asarray(np.linalg.inv(triangle), dtype=np.float64)
