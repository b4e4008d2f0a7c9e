"""JSON and YAML: the whole model, ready to be computed, and the straight line nearest to it, under plain names."""

from __future__ import annotations

import numpy as np

from imufield.deliver.exports.job import Draft, Job
from imufield.deliver.exports.text import comment, json_file, text_file, yaml_lines
from imufield.deliver.exports.whole_model import gauge_note, whole_model

FORMAT = "imufield-correction"
VERSION = 1  # Rises where a program that reads it would misread a new document.


def export(job: Job) -> Draft:
    """Return the document as JSON or YAML, as the target says."""
    if job.target.name == "json":
        files = {"imufield_correction.json": json_file(_document(job))}
    else:
        files = {"imufield_correction.yaml": text_file([*comment(job.heading()), *yaml_lines(_document(job))])}
    return Draft(files=files, notes=gauge_note(job))


def _document(job: Job) -> dict[str, object]:
    """Return the document that JSON and YAML have in common."""
    calibration, context = job.parameters.calibration, job.parameters.context
    model, linear = whole_model(job), job.corrections(job.free_frame)
    content: dict[str, object] = {
        "format": FORMAT,
        "version": VERSION,
        "created": context.created,
        "software": context.software,
        "model": context.instrument.model,
        "serial_number": context.instrument.serial_number,
        "gauge": job.options.gauge or calibration.gauge,
        "rotation_from_parameter_file": linear.rotation.tolist(),
        "accelerometer": {
            "raw_unit": calibration.accelerometer_raw_unit,
            "unit": "m/s^2",
            "equation": calibration.equation,
            "inverse": "s from K (s + b) + K2 s^2 = N - raw_zero axis by axis, then a = inverse_alignment s"
            if not model.quadratic_on_body_axes
            else "repeat a = inverse_alignment ((N - raw_zero - K2 a^2) / K - b)",
            **{name: model.arrays()[name].tolist() for name in ("raw_zero", "scale", "bias", "inverse_alignment", "quadratic")},
            "linear_equation": "a = matrix (N - offset)",
            "matrix": linear.accelerometer.matrix.tolist(),
            "offset": linear.accelerometer.offset.tolist(),
            "linear_is_exact": not bool(np.any(model.quadratic)),
        },
    }
    if linear.gyroscope is not None and calibration.gyroscope is not None:
        content["gyroscope"] = {
            "raw_unit": calibration.gyroscope.raw_unit,
            "unit": "rad/s",
            "equation": "w = matrix (N - offset - g_sensitivity a)",
            "matrix": linear.gyroscope.matrix.tolist(),
            "offset": linear.gyroscope.offset.tolist(),
            "g_sensitivity": linear.g_sensitivity.tolist(),
        }
    return content
