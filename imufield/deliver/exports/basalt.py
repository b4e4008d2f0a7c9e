"""Basalt calibration.json: ``a = (I + L) raw - b`` with L lower triangular, ``w = (I + S) raw - b`` (calib_bias.hpp).

``calib_accel_bias`` is [b, L by columns], ``calib_gyro_bias`` is [b, S by columns].
"""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import json_file
from imufield.deliver.exports.vio import noise_figures

# calib_bias.hpp, CalibAccelBias::getBiasAndScale: params 3 to 8 fill the lower triangle column by column.
_LOWER_BY_COLUMNS = ((0, 1, 2, 1, 2, 2), (0, 0, 0, 1, 1, 2))
# Its keys, by Kalibr's names of the noise figures.
_NOISE = {
    "imu_update_rate": "update_rate",
    "accel_noise_std": "accelerometer_noise_density",
    "gyro_noise_std": "gyroscope_noise_density",
    "accel_bias_std": "accelerometer_random_walk",
    "gyro_bias_std": "gyroscope_random_walk",
}


def export(job: Job) -> Draft:
    """Return the IMU part of calibration.json."""
    corrections = job.corrections(job.fixed_frame("lower")).without_g_sensitivity()
    si = job.in_si(corrections)
    lower = (si.accelerometer.matrix - np.eye(3))[_LOWER_BY_COLUMNS]
    values: dict[str, object] = {"calib_accel_bias": [*si.accelerometer.output_offset, *lower]}
    if si.gyroscope is not None:
        by_columns = (si.gyroscope.matrix - np.eye(3)).ravel(order="F")
        values["calib_gyro_bias"] = [*si.gyroscope.output_offset, *by_columns]
    figures = noise_figures(job)
    for key, name in _NOISE.items():
        if figures[name] is not None:
            # One number for the rate, one for each axis for all others.
            values[key] = figures[name] if name == "update_rate" else [figures[name]] * 3
    notes = (sentence("basalt.keys"), sentence("basalt.estimates"))
    return Draft(files={"calibration.json": json_file({"value0": values})}, target_model=corrections, notes=notes)
