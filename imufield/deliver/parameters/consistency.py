"""What the numbers and words of a parameter file must agree on, because some follow from others.

The hash tells that a file is what somebody wrote, not that ``imufield solve`` did: an editor or a tool can make it anew, and a
person can say "edited". A scale changed beside the intrinsic scale that follows from it leaves open which of the two was meant.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.accelerometer.accelerometer import EQUATIONS
from imufield.calibrate.accelerometer.quality import poor_sentences
from imufield.calibrate.model.gauge import constraint_jacobian, intrinsic, make_intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import GRAVITY_NAME, Calibration
from imufield.deliver.parameters.apply import correct_accelerometer
from imufield.deliver.parameters.document import GYROSCOPE_EQUATION, calibration_from_document, gyroscope_bias_rad_s
from imufield.deliver.parameters.schema import Document
from imufield.errors import CalibrationError
from imufield.samples import AXES, FloatArray

UNITS = {
    "accelerometer": ("m/s^2", "g", "count", "pulse", "count/s", "pulse/s"),
    "gyroscope": ("rad/s", "count", "pulse", "count/s", "pulse/s"),
}
"""Raw units that samples and files of position means can have, increments divided by their interval."""
_TYPED = 1e-6  # What a person types with seven digits is exact enough: it is below every uncertainty.
_ROUNDED = 1e-4  # Of a variance: what the propagation through a joint fit and the printing leave may lie this far below zero.
# Factor by which an instrument's scale is off the nominal one of its unit at most: far more than any, less than g is m/s^2.
_NEAR = 3.0


def contradiction(document: Document, *, is_edited: bool = False) -> str:
    """Say what in a document that fits the schema contradicts its parameters, the key first; empty where nothing does.

    Where a person changed a value and says so, the residuals and figures may be those of before.
    """
    return next(_contradictions(document, is_edited=is_edited), "")


def _contradictions(document: Document, *, is_edited: bool) -> Iterator[str]:
    # From what is typed most often to what only a program gets wrong: the first sentence is the one a person reads.
    calibration, table = calibration_from_document(document), document["accelerometer"]
    wanted = EQUATIONS[table["quadratic_axes"]]
    if table["equation"] != wanted:
        yield f'accelerometer.equation is "{table["equation"]}", but quadratic_axes "{table["quadratic_axes"]}" is "{wanted}"'
    yield from _units(document)
    gauge, vector = table["gauge"], to_vector(calibration.accelerometer)
    # Of the gauge "preset" the frame is that of a preset, which is not in the file.
    if gauge != "preset" and np.any(np.abs(constraint_jacobian(vector, gauge) @ vector) > _TYPED):
        shape = "symmetric" if gauge == "symmetric" else f"{gauge} triangular"
        yield f'accelerometer.gauge is "{gauge}", but accelerometer.misalignment_rad is not {shape}'
    yield from _intrinsic(calibration)
    yield from _gyroscope(calibration, document.get("gyroscope"), gauge)
    yield from _possible(calibration)
    if not is_edited:
        yield from _positions(calibration, document)
        yield from _verdict(calibration)
        yield from _sigma(calibration, document)


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
        # A poor calibration says so itself; its scale may be anything.
        believed = document["quality"]["verdict"] != "poor"
        if believed and nominal is not None and np.any((scale < nominal / _NEAR) | (scale > nominal * _NEAR)):
            yield f'{triad}.raw_unit is "{unit}", whose scale is about {nominal:.4g}, and {triad}.scale is {table["scale"]}'


def _intrinsic(calibration: Calibration) -> Iterator[str]:
    parameters = calibration.accelerometer
    numbers = intrinsic(to_vector(parameters), parameters.quadratic_axes)[0]
    follows = make_intrinsic(numbers, numbers)  # only the values of it are used
    size = np.abs(parameters.scale)
    for key, unit in {"scale": size, "bias_raw": size, "angle_rad": np.ones(3), "quadratic": size / 100}.items():
        stated: FloatArray = getattr(calibration.intrinsic, key)
        values: FloatArray = getattr(follows, key)
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


def _positions(calibration: Calibration, document: Document) -> Iterator[str]:
    """Yield where residuals are not those of the parameters, nor their summary that of the residuals."""
    tables, quality = document["position"], calibration.quality
    raw = np.array([table["mean_raw"] for table in tables], dtype=np.float64).reshape(-1, 3)
    try:
        force = correct_accelerometer(calibration.accelerometer, raw)
    except CalibrationError as error:
        yield f"position.mean_raw cannot come from these parameters: {error.message.partition(';')[0]}"
        return
    follows = np.linalg.norm(force, axis=1) - calibration.gravity.gravity_m_s2
    stated = calibration.positions.residual_m_s2
    for k in np.flatnonzero(np.abs(stated - follows) > _TYPED):
        yield (
            f"position[{k}].residual_m_s2 is {stated[k]:.6g}, but mean_raw, the accelerometer and site.gravity_m_s2 give "
            f"{follows[k]:.6g}"
        )
    known = np.abs(stated[np.isfinite(stated)])
    if not len(known):
        return
    for key, value in (("residual_rms_m_s2", float(np.sqrt(np.mean(known**2)))), ("residual_max_m_s2", float(known.max()))):
        if abs(getattr(quality, key) - value) > _TYPED:
            yield f"quality.{key} is {getattr(quality, key):.6g}, but the residuals of the positions give {value:.6g}"


def _verdict(calibration: Calibration) -> Iterator[str]:
    """Yield a verdict that is not poor where the figures make it so."""
    quality, solver = calibration.quality, calibration.solver
    if quality.verdict == "poor":
        return
    unsettled = None if solver.converged else solver.message
    for reason in poor_sentences(unsettled, quality.degrees_of_freedom, quality.leave_one_out_rms_m_s2):
        yield f'quality.verdict is "{quality.verdict}" instead of "poor", but {reason.partition(": ")[0]}'


def _possible(calibration: Calibration) -> Iterator[str]:
    """Yield where the covariance matrix is not positive semi-definite."""
    matrix = calibration.covariance
    sigma = np.sqrt(np.diagonal(matrix))
    free = np.isfinite(sigma) & (sigma > 0)
    correlation = matrix[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    if not len(correlation) or not np.isfinite(correlation).all():
        return
    lowest = float(np.linalg.eigvalsh(correlation)[0])
    if lowest < -_ROUNDED:
        yield (
            "covariance.matrix is not positive semi-definite: some combination of its parameters has a variance below zero "
            f"(lowest eigenvalue {lowest:.3g} of its correlations, limit {-_ROUNDED:g})"
        )


def _sigma(calibration: Calibration, document: Document) -> Iterator[str]:
    """Yield standard deviations that are not those of the covariance."""
    sigma = np.sqrt(np.diagonal(calibration.covariance))
    for name, value in zip(calibration.covariance_names, sigma, strict=True):
        # The name of a parameter in the matrix says where the file states its standard deviation a second time.
        triad, _, rest = name.partition(".")
        key, _, axes = rest.partition(".")
        stated = document.get(triad, {}).get("uncertainty", {}).get(key) if triad in UNITS else None
        for axis in axes:
            stated = stated[AXES.index(axis)] if isinstance(stated, list) and axis in AXES else None
        if name == GRAVITY_NAME:
            stated = document["site"]["gravity_sigma_m_s2"]
        if not isinstance(stated, int | float):
            yield f"covariance.names has {name}, which is no parameter of this file"
        elif abs(stated - value) > _TYPED * max(value, stated):
            yield f"covariance.matrix gives {name} a standard deviation of {value:.6g}, and the file states {stated:.6g}"
