"""imu_tk .calib, one file per triad: T, K, bias of ``u = T K (raw - bias)``; T upper triangular for the accelerometer."""

from __future__ import annotations

from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import number, rows, text_file


def export(job: Job) -> Draft:
    """Return both files; they apply to raw output in its own unit, counts too."""
    corrections = job.corrections(job.fixed_frame("upper")).without_g_sensitivity()
    short = {"accelerometer": "acc", "gyroscope": "gyro"}
    files = {}
    for triad, correction in corrections.triads.items():
        T, K = correction.split_columns()
        # calibration.h of imu_tk: load() reads the nine numbers of T, those of K, then the bias, and skips no comment.
        lines = [*rows(T, "", "", " "), "", *rows(K, "", "", " "), "", *map(number, correction.offset)]
        files[f"imu_tk_{short[triad]}.calib"] = text_file(lines)
    unit = job.parameters.calibration.accelerometer_raw_unit
    return Draft(files=files, target_model=corrections, notes=(sentence("imu_tk.unit", unit=unit),))
