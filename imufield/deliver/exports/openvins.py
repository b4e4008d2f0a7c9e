"""OpenVINS kalibr_imu_chain.yaml.

``a = R_IMUtoACC^T Ta^-1 (a_m - b_a)`` and ``w = R_IMUtoGYRO^T Tw^-1 (w_m - Tg a - b_g)`` with a in the IMU frame
(ov_msckf, Propagator). Model "kalibr": Ta and Tw lower triangular, the IMU frame is the accelerometer's. Model "rpng": both
upper triangular, the IMU frame is the gyroscope's.
"""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.conventions import Corrections, rotation_times_triangle
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import comment, text_file, yaml_lines
from imufield.deliver.exports.vio import bias_lines, bias_loss, imu_lines
from imufield.errors import ParameterFileError, Reason
from imufield.samples import FloatArray


def export(job: Job) -> Draft:
    """Return kalibr_imu_chain.yaml."""
    corrections = _corrections(job)
    si = job.in_si(corrections)
    triangle = np.triu if job.options.model == "rpng" else np.tril
    # The order of OpenVINS' own files; what is not there is the identity.
    matrices = {"Tw": np.eye(3), "R_IMUtoGYRO": np.eye(3)}
    if si.gyroscope is not None:
        matrices["R_IMUtoGYRO"], matrices["Tw"] = _split(si.gyroscope.matrix, job)
    R, T = _split(si.accelerometer.matrix, job)
    matrices |= {"Ta": T, "R_IMUtoACC": R, "Tg": si.g_sensitivity}
    imu, unknown = imu_lines(job)
    lines = [
        "%YAML:1.0",  # cv::FileStorage, which OpenVINS reads with, refuses a file without this line
        *comment([*job.heading(), *bias_lines(si), *job.example(si)]),
        "",
        *imu,
        "  rostopic: /imu0",
        "  time_offset: 0.0",
        f'  model: "{job.options.model}"',
    ]
    # What rounding leaves outside of a triangle goes.
    matrices |= {name: triangle(matrices[name]) for name in ("Ta", "Tw")}
    lines += yaml_lines(matrices, 2)
    files = {"kalibr_imu_chain.yaml": text_file(lines)}
    return Draft(files=files, target_model=corrections, losses=bias_loss(si), notes=unknown)


def _corrections(job: Job) -> Corrections:
    """Return the corrections in the IMU frame of the model: that of the accelerometer, or for rpng of the gyroscope."""
    if job.options.model == "kalibr":
        return job.corrections(job.fixed_frame("lower"))
    corrections = job.corrections(job.fixed_frame("file"))
    if corrections.gyroscope is None:
        raise ParameterFileError(sentence("openvins.no_gyroscope"), Reason.UNITS)
    turn, _ = rotation_times_triangle(corrections.gyroscope.matrix, "upper")
    return corrections.turned(turn.T)


def _split(matrix: FloatArray, job: Job) -> tuple[FloatArray, FloatArray]:
    """Return R and T of M = R^T T^-1."""
    turn, triangle = rotation_times_triangle(matrix, "upper" if job.options.model == "rpng" else "lower")
    # In its own frame a triad needs no rotation; what is left is rounding.
    turn = np.eye(3) if np.allclose(turn, np.eye(3), atol=1e-14) else turn
    return turn.T, np.asarray(np.linalg.inv(triangle), dtype=np.float64)
