"""imucal JSON, Ferraris: ``raw = K_a R_a a + b_a`` and ``raw = K_g R_g w + K_ga a + b_g`` with w in deg/s."""

from __future__ import annotations

from typing import Any

import numpy as np

from imufield.deliver.exports.conventions import Correction
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import json_file

FORMAT_VERSION = "2.0.0"


def export(job: Job) -> Draft:
    """Return the file that ``FerrarisCalibrationInfo.from_json_file`` reads; it applies to raw output in its own unit."""
    held = job.corrections(job.free_frame)
    calibration = job.parameters.calibration
    K_a, R_a = held.accelerometer.split_rows()
    # Without a gyroscope imucal still wants its numbers: deg/s passed through unchanged.
    gyroscope = Correction(np.eye(3), np.zeros(3))
    gyroscope_unit = "deg/s"
    if held.gyroscope is not None and calibration.gyroscope is not None:
        gyroscope = Correction(np.degrees(held.gyroscope.matrix), held.gyroscope.offset)
        gyroscope_unit = calibration.gyroscope.raw_unit
    K_g, R_g = gyroscope.split_rows()
    document: dict[str, Any] = {
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": calibration.accelerometer_raw_unit,
        "from_gyr_unit": gyroscope_unit,
        "comment": "; ".join(job.heading()),
        "K_a": K_a.tolist(),
        "R_a": R_a.tolist(),
        "b_a": held.accelerometer.offset.tolist(),
        "K_g": K_g.tolist(),
        "R_g": R_g.tolist(),
        "K_ga": held.g_sensitivity.tolist(),
        "b_g": gyroscope.offset.tolist(),
        "cal_type": "Ferraris",
        "_format_version": FORMAT_VERSION,
    }
    notes = ["imucal gives angular rate in deg/s"]
    if held.gyroscope is None:
        notes.append("the gyroscope is passed through unchanged in deg/s, because imucal wants numbers for it")
    return Draft(files={"imucal.json": json_file(document)}, held=held, notes=tuple(notes))
