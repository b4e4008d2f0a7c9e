"""RealSense calibration.json: ``S raw - b`` for each triad (librealsense, motion transform); S by columns."""

from __future__ import annotations

from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import json_file


def export(job: Job) -> Draft:
    """Return calibration.json."""
    corrections = job.corrections(job.free_frame).without_g_sensitivity()
    # As rs-imu-calibration.py of librealsense writes them: its rows of X are multiplied with a row of values from the left.
    imu = {
        triad: {"scale_and_alignment": correction.matrix.T.ravel(), "bias": correction.output_offset}
        for triad, correction in job.in_si(corrections).triads.items()
    }
    notes = (sentence("realsense.order"), sentence("realsense.axes"))
    return Draft(files={"calibration.json": json_file({"imus": [imu]})}, target_model=corrections, notes=notes)
