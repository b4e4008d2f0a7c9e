"""RealSense calibration.json: ``S raw - b`` for each triad (librealsense, motion transform); S by rows."""

from __future__ import annotations

from typing import Any

from imufield.deliver.exports.conventions import Correction
from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import json_file


def export(job: Job) -> Draft:
    """Return calibration.json."""
    held = job.corrections(job.free_frame).without_g_sensitivity()
    si = job.in_si(held)
    imu = {"accelerometer": _triad(si.accelerometer)}
    if si.gyroscope is not None:
        imu["gyroscope"] = _triad(si.gyroscope)
    order = (
        "scale_and_alignment is by rows; the tool that writes the EEPROM transposes the accelerometer's and not the "
        "gyroscope's, so read it back and compare one corrected sample"
    )
    axes = "librealsense turns the axes of some models before it corrects: calibrate the raw stream with its correction off"
    return Draft(files={"calibration.json": json_file({"imus": [imu]})}, held=held, notes=(order, axes))


def _triad(correction: Correction) -> dict[str, Any]:
    return {"scale_and_alignment": correction.matrix.ravel().tolist(), "bias": correction.output_offset.tolist()}
