"""Use parameters: raw output in, specific force and angular rate out.

A linear model is one product per sample: ``a = C N - d`` with ``C = (K T)^-1`` and ``d = C (raw_zero + K b)``, likewise
for the gyroscope. The matrices are formed once, and the rows are worked on in pieces that stay in the processor's cache, so
the cost is that of reading and writing the arrays once. The quadratic and the extended model go through
``imufield.calibrate.model.models.recover``. With parameters over temperature, outputs are first brought to the reference
temperature by ``calibrate.model.temperature_polynomials``.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import recover
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.errors import ParameterFileError, Reason
from imufield.samples import FloatArray, Samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_ROWS_AT_ONCE = 4096  # Pieces of 96 KiB a triad, read and written: they stay in a second-level cache.


def correct_accelerometer(parameters: AccelerometerParameters, raw: FloatArray, *, out: FloatArray | None = None) -> FloatArray:
    """Return specific force in m/s^2 for raw outputs (increments divided by their interval), both of shape (..., 3).

    ``out`` of shape (n, 3) receives the result where it is given.

    Raises
    ------
    CalibrationError
        If no specific force gives such an output with these parameters; NaN is passed on as NaN.
    ParameterFileError
        If the last axis of ``raw`` has not 3 entries.
    """
    raw = three_columns(raw, "accelerometer")
    if _is_curved(parameters):
        out = np.empty(raw.shape) if out is None else out
        out[...] = recover(parameters, raw.reshape(-1, 3)).reshape(raw.shape)
        return out
    inverse = correction_matrix(parameters.scale, parameters.misalignment_rad)
    return _affine(inverse, parameters.offset, raw, out=out)


def _is_curved(parameters: AccelerometerParameters) -> bool:
    return parameters.higher is not None or bool(np.any(parameters.quadratic))


def correct_gyroscope(
    parameters: GyroscopeParameters,
    raw: FloatArray,
    specific_force: FloatArray | None = None,
    *,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return angular rate in rad/s for raw outputs, both of shape (..., 3).

    Parameters
    ----------
    parameters : GyroscopeParameters
    raw : ndarray, shape (..., 3)
        Raw unit; increments divided by their interval.
    specific_force : ndarray, shape (..., 3), optional
        m/s^2, corrected; needed where a g-sensitivity was fitted.
    out : ndarray, shape (n, 3), optional
        Receives the result.

    Raises
    ------
    ParameterFileError
        If a g-sensitivity was fitted and ``specific_force`` is not given, or a shape is wrong.
    """
    raw = three_columns(raw, "gyroscope")
    inverse = correction_matrix(parameters.scale, parameters.misalignment_rad)
    if not np.any(parameters.g_sensitivity):
        return _affine(inverse, parameters.offset, raw, out=out)
    if specific_force is None:
        raise ParameterFileError(sentence("apply.no_force"), Reason.USAGE)
    # One force for many rates is allowed: an instrument at rest.
    force = np.broadcast_to(three_columns(specific_force, "specific force"), raw.shape)
    return _affine(inverse, parameters.offset, raw, (inverse @ parameters.g_sensitivity, force), out=out)


def correct_both(accelerometer: AccelerometerParameters, gyroscope: GyroscopeParameters, raw: FloatArray) -> FloatArray:
    """Return specific force and angular rate side by side for raw outputs side by side, both of shape (n, 6).

    In the linear model the two are one affine map of six numbers, g-sensitivity included: the rows are read once.

    Raises
    ------
    CalibrationError
        If no specific force gives such an output with these parameters; NaN stays in its triad.
    """
    corrected = np.empty(raw.shape)
    if _is_curved(accelerometer):
        return _by_triads(accelerometer, gyroscope, raw, corrected)
    force = correction_matrix(accelerometer.scale, accelerometer.misalignment_rad)
    rate = correction_matrix(gyroscope.scale, gyroscope.misalignment_rad)
    matrix = np.block([[force, np.zeros((3, 3))], [-rate @ gyroscope.g_sensitivity @ force, rate]])
    _affine(matrix, np.concatenate([accelerometer.offset, gyroscope.offset]), raw, out=corrected)
    # NaN of a sample that was lost is data, and no reason for a warning.
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(corrected.sum())
    if not finite:
        # Zero times NaN is NaN: what one triad lacks must not spoil the other.
        spoilt = np.flatnonzero(~np.isfinite(corrected).all(axis=1))
        corrected[spoilt] = _by_triads(accelerometer, gyroscope, raw[spoilt], corrected[spoilt])
    return corrected


def _by_triads(
    accelerometer: AccelerometerParameters, gyroscope: GyroscopeParameters, raw: FloatArray, out: FloatArray
) -> FloatArray:
    force = correct_accelerometer(accelerometer, raw[:, :3], out=out[:, :3])
    correct_gyroscope(gyroscope, raw[:, 3:], force, out=out[:, 3:])
    return out


def at_reference(
    raw: FloatArray,
    temperature_degc: FloatArray | float | None,
    model: TriadTemperature | None,
    *,
    scale: FloatArray,
    raw_zero: FloatArray | float,
) -> FloatArray:
    """Return what raw outputs of shape (..., 3) would be at the reference temperature of their triad.

    As they are where nothing is known over temperature, or no temperature is given; ``temperature_degc`` is one for all, or of
    shape (...), or (..., 3) for one of each axis. ``scale`` is K at the reference.
    """
    if model is None or temperature_degc is None:
        return raw
    raw = np.asarray(raw, dtype=np.float64)
    each_degc = np.asarray(temperature_degc, dtype=np.float64)
    of_axes = each_degc.ndim == raw.ndim
    each_degc = np.broadcast_to(each_degc, raw.shape if of_axes else raw.shape[:-1]).reshape(-1, *raw.shape[-1:] * of_axes)
    rows = model.to_reference(raw.reshape(-1, 3), each_degc, scale=scale, raw_zero=raw_zero)
    return rows.reshape(raw.shape)


def temperatures_for(samples: Samples, model: TriadTemperature | None, first: int) -> FloatArray:
    """Return the temperatures that correct a triad: of its own sensors, shape (n, 3), where they are sent and it was fitted so.

    Elsewhere that of the instrument, shape (n,). ``first`` is the place of the triad's first axis among the six.
    """
    own_degc = samples.sensor_temperature_degc
    if own_degc is None or model is None or model.sensor_offset_degc is None:
        return samples.temperature_degc
    there = own_degc[:, first : first + 3] - model.sensor_offset_degc
    return np.where(np.isnan(there), samples.temperature_degc[:, np.newaxis], there)


def correction_matrix(scale: FloatArray, misalignment_rad: FloatArray) -> FloatArray:
    """Return C = (K T)^-1, shape (3, 3)."""
    return np.asarray(np.linalg.inv(scale[:, None] * (np.eye(3) + misalignment_rad)), dtype=np.float64)


def _affine(
    inverse: FloatArray,
    offset: FloatArray,
    raw: FloatArray,
    less: tuple[FloatArray, FloatArray] | None = None,
    *,
    out: FloatArray | None = None,
) -> FloatArray:
    """Return C N - C o, less a matrix times vectors of the same shape as ``raw``; C is (3, 3), or (6, 6) for six columns."""
    out = np.empty(raw.shape) if out is None else out
    columns = len(offset)
    rows, target = raw.reshape(-1, columns), out.reshape(-1, columns)
    matrix = np.ascontiguousarray(inverse.T)
    product = np.empty((min(_ROWS_AT_ONCE, len(rows)), columns))
    # Rows of the constant written out: subtracting equal shapes is three times as fast as spreading one row.
    shift = np.tile(inverse @ offset, (len(product), 1))
    # Kernels for AVX-512 fill the width of a register with zeros, and an infinite value times a zero that nobody reads
    # raises "invalid value" although the product is right. Where the product itself is no number, NaN in it tells so.
    with np.errstate(invalid="ignore"):
        for start in range(0, len(rows), _ROWS_AT_ONCE):
            part = slice(start, start + _ROWS_AT_ONCE)
            piece = target[part]
            np.dot(rows[part], matrix, out=product[: len(piece)])
            np.subtract(product[: len(piece)], shift[: len(piece)], out=piece)
            if less is not None:
                piece -= less[1].reshape(-1, 3)[part] @ less[0].T
    return out


def three_columns(values: FloatArray, what: str) -> FloatArray:
    """Return ``values`` as float64 of shape (..., 3).

    Raises
    ------
    ParameterFileError
        If the last axis has not 3 entries.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.shape[-1:] != (3,):
        raise ParameterFileError(sentence("apply.columns", what=what, shape=array.shape), Reason.USAGE)
    return array
