"""What a file edited by hand must still agree on: numbers and words that follow from its parameters.

The hash vouches for a file that ``imufield solve`` wrote. Where somebody changed a value and says so nothing does, and a scale
changed beside the intrinsic scale that follows from it leaves open which of the two was meant.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imufield.acquire.protocol import nominal_scale
from imufield.calibrate.accelerometer import EQUATIONS
from imufield.calibrate.gauge import constraint_jacobian, intrinsic
from imufield.calibrate.models import to_vector
from imufield.calibrate.result import AccelerometerParameters, Calibration, Gauge
from imufield.deliver.document import GYROSCOPE_EQUATION, Document, calibration_from_document, gyroscope_bias_rad_s
from imufield.samples import FloatArray

UNITS = {
    "accelerometer": ("m/s^2", "g", "count", "pulse", "count/s", "pulse/s"),
    "gyroscope": ("rad/s", "count", "pulse", "count/s", "pulse/s"),
}
"""Raw units that samples and files of position means can have, increments divided by their interval."""
_TYPED = 1e-6
"""What a person types with seven digits is exact enough: it is below every uncertainty."""
_NEAR = 3.0
"""Factor by which an instrument's scale is off the nominal one of its unit at most: far more than any, less than g is m/s^2."""
_INTRINSIC = ("scale", "bias_raw", "angle_rad", "quadratic")


def contradiction(document: Document) -> str:
    """Say what in a document that fits the schema contradicts its parameters, the key first; empty where nothing does."""
    return next(_contradictions(document), "")


def _contradictions(document: Document) -> Iterator[str]:
    calibration, table = calibration_from_document(document), document["accelerometer"]
    wanted = EQUATIONS[table["quadratic_axes"]]
    if table["equation"] != wanted:
        yield f'accelerometer.equation is "{table["equation"]}", but quadratic_axes "{table["quadratic_axes"]}" is "{wanted}"'
    yield from _units(document)
    yield from _gauge(calibration.accelerometer, table["gauge"])
    yield from _intrinsic(calibration)
    yield from _gyroscope(calibration, document.get("gyroscope"), table["gauge"])


def _units(document: Document) -> Iterator[str]:
    for triad, known in UNITS.items():
        table = document.get(triad)
        if table is None:
            continue
        unit, scale = table["raw_unit"], np.abs(np.array(table["scale"], dtype=np.float64))
        if unit not in known:
            yield f'{triad}.raw_unit is "{unit}", which is none of {", ".join(known)}'
            continue
        nominal = nominal_scale(unit)
        if nominal is not None and np.any((scale < nominal / _NEAR) | (scale > nominal * _NEAR)):
            yield f'{triad}.raw_unit is "{unit}", whose scale is about {nominal:.4g}, and {triad}.scale is {table["scale"]}'


def _gauge(parameters: AccelerometerParameters, gauge: Gauge) -> Iterator[str]:
    if gauge == "preset":
        return  # the preset is not in the file
    vector = to_vector(parameters)
    if np.any(np.abs(constraint_jacobian(vector, gauge) @ vector) > _TYPED):
        shape = "symmetric" if gauge == "symmetric" else f"{gauge} triangular"
        yield f'accelerometer.gauge is "{gauge}", but accelerometer.misalignment_rad is not {shape}'


def _intrinsic(calibration: Calibration) -> Iterator[str]:
    parameters = calibration.accelerometer
    follows = np.split(intrinsic(to_vector(parameters), parameters.quadratic_axes)[0], len(_INTRINSIC))
    size = np.abs(parameters.scale)
    for key, values, unit in zip(_INTRINSIC, follows, (size, size, np.ones(3), size / 100), strict=True):
        stated: FloatArray = getattr(calibration.intrinsic, key)
        # NaN, an angle that is not known, contradicts nothing.
        if np.any(np.abs(stated - values) > _TYPED * unit):
            yield (
                f"accelerometer.intrinsic.{key} is {stated.tolist()}, but scale, bias_m_s2, misalignment_rad and quadratic of "
                f"the accelerometer give {[float(f'{value:.10g}') for value in values]}"
            )


def _gyroscope(calibration: Calibration, table: Document | None, gauge: str) -> Iterator[str]:
    if table is None or calibration.gyroscope is None:
        return
    if table["equation"] != GYROSCOPE_EQUATION:
        yield f'gyroscope.equation is "{table["equation"]}" instead of "{GYROSCOPE_EQUATION}"'
    if table["gauge"] != gauge:
        yield f'gyroscope.gauge is "{table["gauge"]}", but accelerometer.gauge "{gauge}": both triads have one frame'
    follows = gyroscope_bias_rad_s(calibration.gyroscope)[0]
    stated = np.array(table["bias_rad_s"], dtype=np.float64)
    if np.any(np.abs(stated - follows) > _TYPED * np.maximum(np.abs(follows), _TYPED)):
        yield f"gyroscope.bias_rad_s is {table['bias_rad_s']}, but bias and scale of the gyroscope give {follows.tolist()}"
