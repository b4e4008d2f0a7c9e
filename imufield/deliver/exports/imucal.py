"""imucal JSON, Ferraris: ``raw = K_a R_a a + b_a`` and ``raw = K_g R_g w + K_ga a + b_g`` with w in deg/s."""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.conventions import Correction
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import json_file

FORMAT_VERSION = "2.0.0"  # _format_version of imucal 2 (calibration_info.py); it refuses newer ones.


def export(job: Job) -> Draft:
    """Return the file that ``FerrarisCalibrationInfo.from_json_file`` reads; it applies to raw output in its own unit."""
    corrections = job.corrections(job.free_frame)
    calibration = job.parameters.calibration
    K_a, R_a = corrections.accelerometer.split_rows()
    notes = [sentence("imucal.degrees")]
    if corrections.gyroscope is not None and calibration.gyroscope is not None:
        gyroscope = Correction(np.degrees(corrections.gyroscope.matrix), corrections.gyroscope.offset)
        gyroscope_unit = calibration.gyroscope.raw_unit
    else:
        # Without a gyroscope imucal still wants its numbers: deg/s passed through unchanged.
        gyroscope, gyroscope_unit = Correction(np.eye(3), np.zeros(3)), "deg/s"
        notes.append(sentence("imucal.no_gyroscope"))
    K_g, R_g = gyroscope.split_rows()
    document = {
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": calibration.accelerometer_raw_unit,
        "from_gyr_unit": gyroscope_unit,
        "comment": "; ".join(job.heading()),
        "K_a": K_a,
        "R_a": R_a,
        "b_a": corrections.accelerometer.offset,
        "K_g": K_g,
        "R_g": R_g,
        "K_ga": corrections.g_sensitivity,
        "b_g": gyroscope.offset,
        "cal_type": "Ferraris",
        "_format_version": FORMAT_VERSION,
    }
    return Draft(files={"imucal.json": json_file(document)}, target_model=corrections, notes=tuple(notes))
