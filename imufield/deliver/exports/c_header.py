"""C99: one header with the numbers, the functions that apply them, and the reader of the binary block."""

from __future__ import annotations

import re

import numpy as np

from imufield.calibrate.model.models import predict, predict_gyroscope
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.calibrate.model.temperature_polynomials import HIGHEST_ORDER, Polynomials
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import number, text_file
from imufield.deliver.exports.whole_model import WholeModel, apply_header, gauge_note, whole_model
from imufield.errors import UsageError
from imufield.samples import FloatArray


def export(job: Job) -> Draft:
    """Return the header; include it in one or many files."""
    name = job.options.name
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise UsageError(sentence("c_header.no_name", name=name))
    # Two meanings of one name would end in an error of the compiler that names neither this option nor this program.
    if re.search(rf"\b{name}\b", apply_header()):
        raise UsageError(sentence("c_header.taken_name", name=name))
    model = whole_model(job)
    guard = f"{name.upper()}_NUMBERS_H"
    calibration = job.parameters.calibration
    gyroscope_unit = calibration.gyroscope.raw_unit if model.has_gyroscope and calibration.gyroscope else "none"
    about = [
        *(line.replace("*/", "* /") for line in job.heading()),
        f"raw units: accelerometer {calibration.accelerometer_raw_unit}, gyroscope {gyroscope_unit}",
        *gauge_note(job),
        *_example(job, model),
    ]
    lines = [
        apply_header(),
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        *("/* " + "\n * ".join(about) + "\n */").splitlines(),
        f"static const imufield_parameters {name} = {{",
        f"    {int(model.has_gyroscope)},",
        f"    {int(model.quadratic_on_body_axes)},",
        *(f"    {_initializer(values)}, /* {field} */" for field, values in model.arrays().items()),
        "};",
        "",
        *_temperatures(job, name),
        f"#endif /* {guard} */",
    ]
    return Draft(files={f"{name}.h": text_file(lines)}, notes=gauge_note(job))


def _temperatures(job: Job, name: str) -> list[str]:
    """Return a constant for each triad that is known over temperature: NAME_accelerometer_temperature, and the gyroscope's."""
    calibration, lines = job.parameters.calibration, []
    gyroscope = calibration.gyroscope if job.has_gyroscope else None
    triads: dict[str, AccelerometerParameters | GyroscopeParameters] = {"accelerometer": calibration.accelerometer}
    models = {"accelerometer": calibration.accelerometer_temperature}
    if gyroscope is not None:
        triads["gyroscope"], models["gyroscope"] = gyroscope.parameters, gyroscope.temperature
    for triad, model in models.items():
        if model is None:
            continue
        own = triads[triad]
        rows = {"bias": _padded(model.bias) * own.scale, "scale": _padded(model.scale), "raw_zero": own.raw_zero}
        lines += [
            f"/* imufield_at_reference(&{name}_{triad}_temperature, degc, raw, raw) comes first. */",
            f"static const imufield_temperature {name}_{triad}_temperature = {{",
            f"    {_initializer(np.array([model.reference_degc]))[1:-1]},",
            f"    {_initializer(np.array(model.range_degc))},",
            *(f"    {_initializer(values)}, /* {field} */" for field, values in rows.items()),
            "};",
            "",
        ]
    return lines


def _padded(polynomials: Polynomials) -> FloatArray:
    """Return the coefficients of the highest order there can be, shape (5, 3)."""
    return np.vstack([polynomials.coefficients, np.zeros((HIGHEST_ORDER - polynomials.order, 3))])


def _initializer(values: FloatArray) -> str:
    if values.ndim == 1:
        # Without the cast every number is a warning where imufield_real is float.
        return f"{{{', '.join(f'(imufield_real){number(value)}' for value in values.tolist())}}}"
    return f"{{{', '.join(map(_initializer, values))}}}"


def _example(job: Job, model: WholeModel) -> list[str]:
    """Return a worked number: what must come out for one raw sample."""
    calibration = job.parameters.calibration
    # Through the model and back, so that the number lies in the instrument's range in whatever unit it has.
    force = np.array([[1.0, -2.0, 9.5]])
    raw = predict(calibration.accelerometer, force)
    corrected = job.parameters.apply_accelerometer(raw)
    lines = [f"example in the frame of the parameter file: raw {_shown(raw)} -> {_shown(corrected)} m/s^2"]
    if model.has_gyroscope and calibration.gyroscope is not None:
        raw = predict_gyroscope(calibration.gyroscope.parameters, np.array([[0.1, -0.2, 0.3]]), force)
        lines.append(f"with it raw {_shown(raw)} -> {_shown(job.parameters.apply_gyroscope(raw, corrected))} rad/s")
    return lines


def _shown(values: FloatArray) -> str:
    return f"({', '.join(number(float(f'{value:.9g}')) for value in values[0])})"
