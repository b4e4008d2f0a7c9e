"""PSINS clbt for imuclbt: on increments, ``wm = Kg wm - eb ts - gSens vm``, ``vm = Ka vm - db ts - Ka2 vm^2 / ts``.

In rates, with the raw r on the right: ``a = Ka r - db - Ka2 r^2``. Ours, from ``r = K (s + b) + K2 s^2`` with ``k = K2 / K``
and ``p = r / K``, to first order in k:

    s = p - b - k (p - b)^2 = (1 + 2 k b) p - (b + k b^2) - k p^2

so on the sensing axes the quadratic term changes scale and bias by its part of the bias, and what PSINS cannot hold is the
turn of ``k p^2`` into body axes and the second order in k.

The gyroscope's G a is made of the raw r, without Ka2: ``a = M r - M o``, the straight line nearest to the quadratic model,
becomes ``gSens = Mg G M`` and a shift of eb. With Ka and db, a line that touches the model at zero, the error would be half as
large again.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.gauge import turn_accelerometer
from imufield.dataclass import dataclass, fields
from imufield.deliver.exports.conventions import Corrections, rotation_to
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import comment, row, rows, text_file
from imufield.samples import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class _PsinsModel(Corrections):
    """What imuclbt computes, in rates; the accelerometer's numbers in SI. The gyroscope's force is that of the line."""

    Ka: FloatArray
    db: FloatArray
    Ka2: FloatArray
    scale: float
    zero: FloatArray  # The driver's m/s^2 are (N - zero) / scale.

    def apply_accelerometer(self, raw: FloatArray) -> FloatArray:
        r = (raw - self.zero) / self.scale
        return np.asarray(r @ self.Ka.T - self.db - self.Ka2 * r**2)


def export(job: Job) -> Draft:
    """Return a function that makes the struct."""
    linear = job.corrections(job.fixed_frame("lower"))
    model, si = _psins_model(job, linear), job.in_si(linear)
    lines = [
        "function clbt = imufield_clbt()",
        *comment([*job.heading(), "imu = imuclbt(imu, imufield_clbt());"], "%"),
        # imuclbt multiplies by sf before everything else: scale is in Kg and Ka already.
        "clbt.sf = [1.0; 1.0; 1.0; 1.0; 1.0; 1.0];",
        *_gyroscope(si),
        f"clbt.Ka = {_matrix(model.Ka)};",
        f"clbt.db = {_column(model.db)};",
        f"clbt.Ka2 = {_column(model.Ka2)};",
        "clbt.rx = [0.0; 0.0; 0.0]; clbt.ry = [0.0; 0.0; 0.0]; clbt.rz = [0.0; 0.0; 0.0];",
        # Lever arms of the accelerometers and a delay between the triads are not part of our model.
        "clbt.tGA = 0.0;",
        "end",
    ]
    return Draft(
        files={"imufield_clbt.m": text_file(lines)},
        target_model=model,
        accelerometer_lacks=sentence("psins.lacks"),
        notes=_notes(model, job.parameters.calibration.accelerometer.quadratic),
    )


def _psins_model(job: Job, linear: Corrections) -> _PsinsModel:
    parameters = job.parameters.calibration.accelerometer
    scale, zero = job.accelerometer_si()
    turned = turn_accelerometer(parameters, rotation_to(parameters, "lower"))
    K, k = turned.scale / scale, turned.quadratic / turned.scale
    # A mid-scale that the driver leaves in is one more bias.
    b = turned.bias_m_s2 + (parameters.raw_zero - zero) / turned.scale
    # Lower by the gauge: what rounding leaves above the diagonal would be read as a misalignment.
    inverse = np.tril(np.linalg.inv(np.eye(3) + turned.misalignment_rad))
    Ka: FloatArray = inverse * ((1 + 2 * k * b) / K)
    return _PsinsModel(
        **{item.name: getattr(linear, item.name) for item in fields(linear)},
        Ka=Ka,
        db=inverse @ (b + k * b**2),
        Ka2=np.diag(inverse) * k / K**2,
        scale=scale,
        zero=zero,
    )


def _gyroscope(si: Corrections) -> list[str]:
    if si.gyroscope is None:
        return ["clbt.Kg = eye(3);", "clbt.eb = [0.0; 0.0; 0.0];"]
    sensitivity = si.gyroscope.matrix @ si.g_sensitivity
    eb = si.gyroscope.output_offset - sensitivity @ si.accelerometer.output_offset
    lines = [f"clbt.Kg = {_matrix(si.gyroscope.matrix)};", f"clbt.eb = {_column(eb)};"]
    if np.any(sensitivity):
        lines.append(f"clbt.gSens = {_matrix(sensitivity @ si.accelerometer.matrix)};")
    return lines


def _notes(model: _PsinsModel, quadratic: FloatArray) -> tuple[str, ...]:
    notes = []
    if np.any(quadratic):
        notes.append(sentence("psins.order"))
    if np.any(quadratic) and not np.all(quadratic):
        notes.append(sentence("psins.all_three"))
    if model.has_g_sensitivity:
        notes.append(sentence("psins.sensitivity"))
    return tuple(notes)


def _matrix(matrix: FloatArray) -> str:
    return f"[{'; '.join(rows(matrix, '', ''))}]"


def _column(values: FloatArray) -> str:
    return f"[{row(values, '; ')}]"
