"""What the numbers and words of a parameter file must agree on, because some follow from others.

The hash tells that a file is what somebody wrote, not that ``imufield solve`` did: an editor or a tool can make it anew, and a
person can say "edited". A scale changed beside the intrinsic scale that follows from it leaves open which of the two was meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.accelerometer.accelerometer import EQUATIONS, HIGHER_EQUATIONS
from imufield.calibrate.accelerometer.quality import poor_sentences
from imufield.calibrate.model.budget import combined_sigma
from imufield.calibrate.model.gauge import constraint_jacobian, intrinsic, make_intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import GRAVITY_NAME, Calibration, GyroscopeCalibration
from imufield.deliver.parameters.apply import correct_accelerometer
from imufield.deliver.parameters.document import calibration_from_document, gyroscope_bias_rad_s, gyroscope_equation
from imufield.deliver.parameters.schema import Document
from imufield.deliver.parameters.temperature_tables import temperature_contradictions
from imufield.errors import CalibrationError
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

UNITS = {
    "accelerometer": ("m/s^2", "g", "count", "pulse", "count/s", "pulse/s"),
    "gyroscope": ("rad/s", "count", "pulse", "count/s", "pulse/s"),
}
"""Raw units that samples and files of position means can have, increments divided by their interval."""
_ROUNDING = 1e-9  # Relative: a covariance that was computed and printed is symmetric to a few units of the last digit.
_TYPED = 1e-6  # What a person types with seven digits is exact enough: it is below every uncertainty.
_FLATTEST = 1e-3  # Determinant of axes so close to one plane that they measure no third direction.
_FIXED = 1e-24  # Of a variance: rounding of what the gauge fixes, 1e-12 rad.
_ROUNDED = 1e-4  # Of a variance: what the propagation through a joint fit and the printing leave may lie this far below zero.
# Factor by which an instrument's scale is off the nominal one of its unit at most: far more than any, less than g is m/s^2.
_NEAR = 3.0


def contradiction(document: Document, *, is_edited: bool = False) -> str:
    """Say what in a document that fits the schema contradicts its parameters, the key first; empty where nothing does.

    Where a person changed a value and says so, the residuals and figures may be those of before.
    """
    return next(_contradictions(document, is_edited=is_edited), "")


def _contradictions(document: Document, *, is_edited: bool) -> Iterator[str]:
    yield from _shape(document)
    yield from _budget_shape(document)
    yield from temperature_contradictions(document)
    # From what is typed most often to what only a program gets wrong: the first sentence is the one a person reads.
    calibration, table = calibration_from_document(document), document["accelerometer"]
    wanted = (HIGHER_EQUATIONS if "higher" in table else EQUATIONS)[table["quadratic_axes"]]
    if table["equation"] != wanted:
        yield sentence("consistency.equation", stated=table["equation"], axes=table["quadratic_axes"], wanted=wanted)
    yield from _units(document)
    gauge, vector = table["gauge"], to_vector(calibration.accelerometer)
    # Of the gauge "preset" the frame is that of a preset, which is not in the file.
    if gauge != "preset" and np.any(np.abs(constraint_jacobian(vector, gauge) @ vector) > _TYPED):
        shape = "symmetric" if gauge == "symmetric" else f"{gauge} triangular"
        yield sentence("consistency.gauge", gauge=gauge, shape=shape)
    yield from _intrinsic(calibration)
    if calibration.gyroscope is not None:
        yield from _gyroscope(calibration.gyroscope, document["gyroscope"], gauge)
    yield from _possible(calibration)
    if not is_edited:
        yield from _positions(calibration, document)
        yield from _verdict(calibration)
        yield from _sigma(calibration, document)
    yield from _budget(calibration)


def _shape(document: Document) -> Iterator[str]:
    """Yield what keeps the numbers from being arrays that can be computed with."""
    names, rows = document["covariance"]["names"], document["covariance"]["matrix"]
    positions, tables = document["session"]["positions"], len(document["position"])
    if positions != tables:
        yield sentence("consistency.position_count", positions=positions, tables=tables)
    if any(len(row) != len(names) for row in [rows, *rows]):
        yield sentence("consistency.covariance_size", names=len(names))
    # Elements that are not known, NaN, contradict nothing.
    matrix = np.array(rows, dtype=np.float64).reshape(len(rows), len(rows))
    if np.any(np.diagonal(matrix) < 0):
        yield sentence("consistency.variance")
    # Where the gauge fixes a parameter nothing but rounding is left of its row.
    free = np.diagonal(matrix) > 0
    deviation = np.sqrt(np.diagonal(matrix)[free])
    correlation = matrix[np.ix_(free, free)] / np.outer(deviation, deviation)
    if np.any(np.abs(correlation - correlation.T) > _ROUNDING):
        yield sentence("consistency.not_symmetric")
    if np.any(np.abs(correlation) > 1 + _ROUNDING):
        yield sentence("consistency.correlation")
    for triad in (triad for triad in UNITS if triad in document):
        misalignment = np.array(document[triad]["misalignment_rad"], dtype=np.float64)
        if 0 in document[triad]["scale"]:
            yield sentence("consistency.zero_scale", triad=triad)
        if np.any(np.diagonal(misalignment) != 0):
            yield sentence("consistency.diagonal", triad=triad)
        if abs(np.linalg.det(np.eye(3) + misalignment)) < _FLATTEST:
            yield sentence("consistency.one_plane", triad=triad)


def _budget_shape(document: Document) -> Iterator[str]:
    names = len(document["covariance"]["names"])
    for share in document.get("budget", {}).get("share", ()):
        if len(share["sigma"]) != names:
            yield sentence("consistency.budget_size", share=share["name"], found=len(share["sigma"]), names=names)


def _units(document: Document) -> Iterator[str]:
    for triad, known in UNITS.items():
        table = document.get(triad)
        if table is None:
            continue
        unit, scale = table["raw_unit"], np.abs(np.array(table["scale"], dtype=np.float64))
        if unit not in known:
            yield sentence("consistency.unit", triad=triad, unit=unit, known=known)
            continue
        nominal = nominal_scale(unit)
        # A poor calibration says so itself; its scale may be anything.
        believed = document["quality"]["verdict"] != "poor"
        if believed and nominal is not None and np.any((scale < nominal / _NEAR) | (scale > nominal * _NEAR)):
            yield sentence("consistency.unit_of_scale", triad=triad, unit=unit, nominal=nominal, scale=table["scale"])


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
            rounded = [float(f"{value:.10g}") for value in values]
            yield sentence("consistency.intrinsic", name=key, stated=stated.tolist(), follows=rounded)


def _gyroscope(gyroscope: GyroscopeCalibration, table: Document, gauge: str) -> Iterator[str]:
    if table["equation"] != (wanted := gyroscope_equation(gyroscope.parameters)):
        yield sentence("consistency.gyroscope_equation", stated=table["equation"], wanted=wanted)
    if table["gauge"] != gauge:
        yield sentence("consistency.gyroscope_gauge", stated=table["gauge"], gauge=gauge)
    follows = gyroscope_bias_rad_s(gyroscope)[0]
    stated = np.array(table["bias_rad_s"], dtype=np.float64)
    if np.any(np.abs(stated - follows) > _TYPED * np.maximum(np.abs(follows), _TYPED)):
        yield sentence("consistency.bias_rate", stated=table["bias_rad_s"], follows=follows.tolist())


def _positions(calibration: Calibration, document: Document) -> Iterator[str]:
    """Yield where residuals are not those of the parameters, nor their summary that of the residuals."""
    # What was left out by hand may be no output of these parameters at all.
    used, quality = np.flatnonzero(calibration.positions.used), calibration.quality
    tables = [document["position"][k] for k in used]
    raw = np.array([table["mean_raw"] for table in tables], dtype=np.float64).reshape(-1, 3)
    drift_raw = calibration.accelerometer.scale * calibration.positions.bias_drift_m_s2[used]
    try:
        force = correct_accelerometer(calibration.accelerometer, raw - drift_raw)
    except CalibrationError as error:
        yield sentence("consistency.mean_raw", cause=error.message.partition(";")[0])
        return
    follows = np.linalg.norm(force, axis=1) - calibration.gravity.gravity_m_s2
    stated = calibration.positions.residual_m_s2[used]
    for k in np.flatnonzero(np.abs(stated - follows) > _TYPED):
        yield sentence("consistency.residual", number=used[k], stated=stated[k], follows=follows[k])
    known = np.abs(stated[np.isfinite(stated)])
    if not len(known):
        return
    for key, value in (("residual_rms_m_s2", float(np.sqrt(np.mean(known**2)))), ("residual_max_m_s2", float(known.max()))):
        if abs(getattr(quality, key) - value) > _TYPED:
            yield sentence("consistency.residual_summary", name=key, stated=getattr(quality, key), follows=value)


def _verdict(calibration: Calibration) -> Iterator[str]:
    """Yield a verdict that is not poor where the figures make it so."""
    quality, solver = calibration.quality, calibration.solver
    if quality.verdict == "poor":
        return
    unsettled = None if solver.converged else solver.message
    for reason in poor_sentences(unsettled, quality.degrees_of_freedom, quality.leave_one_out_rms_m_s2):
        yield sentence("consistency.verdict", verdict=quality.verdict, reason=reason.partition(": ")[0])


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
        yield sentence("consistency.indefinite", lowest=lowest, limit=-_ROUNDED)


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
            yield sentence("consistency.covariance_name", name=name)
        elif abs(stated - value) > _TYPED * max(value, stated):
            yield sentence("consistency.sigma", name=name, follows=value, stated=stated)


def _budget(calibration: Calibration) -> Iterator[str]:
    """Yield where the shares do not add up to the covariance."""
    if not calibration.budget:
        return
    variance = combined_sigma(calibration.budget) ** 2
    for name, follows, stated in zip(calibration.covariance_names, np.diagonal(calibration.covariance), variance, strict=True):
        # A share that is not known leaves a known sum without one.
        if math.isfinite(follows) and not abs(stated - follows) <= _TYPED * follows + _FIXED:
            yield sentence("consistency.budget", name=name, sum=math.sqrt(stated), sigma=math.sqrt(follows))
