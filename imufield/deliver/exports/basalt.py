"""Basalt calibration.json: ``a = (I + L) raw - b`` with L lower triangular, ``w = (I + S) raw - b`` (calib_bias.hpp).

``calib_accel_bias`` is [b, L by columns], ``calib_gyro_bias`` is [b, S by columns].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from imufield.deliver.exports.conventions import Correction
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import json_file
from imufield.deliver.exports.vio import noise_figures

_LOWER_BY_COLUMNS = ((0, 1, 2, 1, 2, 2), (0, 0, 0, 1, 1, 2))


def export(job: Job) -> Draft:
    """Return the IMU part of calibration.json."""
    held = job.corrections(job.fixed_frame("lower")).without_g_sensitivity()
    si = job.in_si(held)
    accelerometer = si.accelerometer
    lower = (accelerometer.matrix - np.eye(3))[_LOWER_BY_COLUMNS]
    values: dict[str, Any] = {"calib_accel_bias": [*accelerometer.output_offset.tolist(), *lower.tolist()]}
    if si.gyroscope is not None:
        values["calib_gyro_bias"] = _full(si.gyroscope)
    for key, name in _NOISE.items():
        value = noise_figures(job)[name]
        if value is not None:
            values[key] = value if name == "update_rate" else [value] * 3
    notes = (
        "the file has the IMU's keys only: put them into the calibration.json that has the cameras",
        "Basalt estimates the rest of the biases at run time",
    )
    return Draft(files={"calibration.json": json_file({"value0": values})}, held=held, notes=notes)


_NOISE = {
    "imu_update_rate": "update_rate",
    "accel_noise_std": "accelerometer_noise_density",
    "gyro_noise_std": "gyroscope_noise_density",
    "accel_bias_std": "accelerometer_random_walk",
    "gyro_bias_std": "gyroscope_random_walk",
}


def _full(correction: Correction) -> list[float]:
    by_columns = (correction.matrix - np.eye(3)).ravel(order="F")
    return [*correction.output_offset.tolist(), *by_columns.tolist()]
