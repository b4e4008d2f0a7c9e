"""imu_tk .calib, one file per triad: T, K, bias of ``u = T K (raw - bias)``; T upper triangular for the accelerometer."""

from __future__ import annotations

from imufield.deliver.exports.conventions import Correction
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import number, rows, text_file


def export(job: Job) -> Draft:
    """Return both files; they apply to raw output in its own unit, counts too."""
    held = job.corrections(job.fixed_frame("upper")).without_g_sensitivity()
    files = {"imu_tk_acc.calib": _file(held.accelerometer)}
    if held.gyroscope is not None:
        files["imu_tk_gyro.calib"] = _file(held.gyroscope)
    calibration = job.parameters.calibration
    note = (f"the files are for raw values in {calibration.accelerometer_raw_unit}, the unit the calibration was made in",)
    return Draft(files=files, held=held, notes=note)


def _file(correction: Correction) -> bytes:
    T, K = correction.split_columns()
    bias = [number(value) for value in correction.offset.tolist()]
    return text_file([*rows(T, "", "", " "), "", *rows(K, "", "", " "), "", *bias])
