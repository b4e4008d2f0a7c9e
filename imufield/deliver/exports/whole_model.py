"""The whole model as plain arrays, for the targets that compute it themselves: c, binary, json, yaml."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np

from imufield.calibrate.model.gauge import turn_accelerometer
from imufield.dataclass import dataclass, fields
from imufield.deliver.exports.conventions import linear_corrections, rotation_to
from imufield.deliver.exports.job import Job, frame_note, sentence
from imufield.errors import UsageError
from imufield.samples import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class WholeModel:
    """Everything that is needed to correct a sample; names as in ``apply.h``."""

    scale: FloatArray
    bias: FloatArray
    inverse_alignment: FloatArray
    quadratic: FloatArray
    raw_zero: FloatArray
    rate_matrix: FloatArray
    rate_offset: FloatArray
    g_sensitivity: FloatArray
    has_gyroscope: bool
    quadratic_on_body_axes: bool

    def arrays(self) -> dict[str, FloatArray]:
        """Return the arrays in the order of the C struct and of the binary block."""
        every = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: values for name, values in every.items() if isinstance(values, np.ndarray)}


def whole_model(job: Job) -> WholeModel:
    """Return the model in the body frame that was asked for.

    Raises
    ------
    UsageError
        If another frame is asked for and the quadratic term stands on body axes, which no turn leaves as they are, or the
        calibration has higher terms.
    """
    calibration = job.parameters.calibration
    accelerometer, corrections = calibration.accelerometer, linear_corrections(calibration, job.free_frame)
    if accelerometer.higher is not None:
        raise UsageError(sentence("whole_model.higher"))
    # A zero term on body axes stays zero in every frame.
    on_body = accelerometer.quadratic_axes == "body" and bool(np.any(accelerometer.quadratic))
    if job.options.gauge is not None:
        if on_body:
            raise UsageError(sentence("whole_model.gauge", gauge=job.options.gauge))
        accelerometer = turn_accelerometer(accelerometer, rotation_to(accelerometer, job.options.gauge))
    gyroscope = corrections.gyroscope
    return WholeModel(
        scale=accelerometer.scale,
        bias=accelerometer.bias_m_s2,
        inverse_alignment=np.asarray(np.linalg.inv(np.eye(3) + accelerometer.misalignment_rad), dtype=np.float64),
        quadratic=accelerometer.quadratic,
        raw_zero=accelerometer.raw_zero,
        rate_matrix=np.zeros((3, 3)) if gyroscope is None else gyroscope.matrix,
        rate_offset=np.zeros(3) if gyroscope is None else gyroscope.offset,
        g_sensitivity=corrections.g_sensitivity,
        has_gyroscope=gyroscope is not None,
        quadratic_on_body_axes=on_body,
    )


def gauge_note(job: Job) -> tuple[str, ...]:
    """Say which body frame the numbers are in."""
    calibration, gauge = job.parameters.calibration, job.options.gauge
    turned = () if gauge is None else frame_note(rotation_to(calibration.accelerometer, gauge))
    return (sentence("whole_model.frame", gauge=gauge or calibration.gauge), *turned)


@cache
def apply_header() -> str:
    """Return the C functions that apply the model and read the binary block."""
    return (files("imufield.deliver.exports") / "apply.h").read_text(encoding="ascii")
