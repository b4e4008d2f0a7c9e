"""Use parameters: raw output in, specific force and angular rate out.

A linear model is one product per sample: ``a = C N + d`` with ``C = (K T)^-1`` and ``d = -C (raw_zero + K b)``, likewise
for the gyroscope. The matrices are formed once per block, so the cost is that of reading and writing the arrays. The
quadratic model goes through ``imufield.calibrate.models.recover``.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.models import recover
from imufield.calibrate.result import AccelerometerParameters, GyroscopeParameters
from imufield.errors import ParameterFileError, Reason
from imufield.samples import FloatArray


def correct_accelerometer(parameters: AccelerometerParameters, raw: FloatArray) -> FloatArray:
    """Return specific force in m/s^2 for raw outputs (increments divided by their interval), both of shape (..., 3).

    Raises
    ------
    CalibrationError
        If no specific force gives such an output with these parameters; NaN is passed on as NaN.
    ParameterFileError
        If the last axis of ``raw`` has not 3 entries.
    """
    raw = three_columns(raw, "accelerometer")
    if np.any(parameters.quadratic):
        return recover(parameters, raw.reshape(-1, 3)).reshape(raw.shape)
    inverse = _inverse(parameters.scale, parameters.misalignment_rad)
    return _affine(inverse, parameters.raw_zero + parameters.scale * parameters.bias_m_s2, raw)


def correct_gyroscope(parameters: GyroscopeParameters, raw: FloatArray, specific_force: FloatArray | None = None) -> FloatArray:
    """Return angular rate in rad/s for raw outputs, both of shape (..., 3).

    Parameters
    ----------
    parameters : GyroscopeParameters
    raw : ndarray, shape (..., 3)
        Raw unit; increments divided by their interval.
    specific_force : ndarray, shape (..., 3), optional
        m/s^2, corrected; needed where a g-sensitivity was fitted.

    Raises
    ------
    ParameterFileError
        If a g-sensitivity was fitted and ``specific_force`` is not given, or a shape is wrong.
    """
    raw = three_columns(raw, "gyroscope")
    inverse = _inverse(parameters.scale, parameters.misalignment_rad)
    rate = _affine(inverse, parameters.bias, raw)
    if not np.any(parameters.g_sensitivity):
        return rate
    if specific_force is None:
        raise ParameterFileError(
            "these gyroscope parameters contain a g-sensitivity; give the corrected specific force as well", Reason.USAGE
        )
    rate -= three_columns(specific_force, "specific force") @ (inverse @ parameters.g_sensitivity).T
    return rate


def _inverse(scale: FloatArray, misalignment_rad: FloatArray) -> FloatArray:
    forward = scale[:, None] * (np.eye(3) + misalignment_rad)
    return np.asarray(np.linalg.inv(forward), dtype=np.float64)


def _affine(inverse: FloatArray, offset: FloatArray, raw: FloatArray) -> FloatArray:
    corrected: FloatArray = raw @ inverse.T
    corrected -= inverse @ offset
    return corrected


def three_columns(values: FloatArray, what: str) -> FloatArray:
    """Return ``values`` as float64 of shape (..., 3).

    Raises
    ------
    ParameterFileError
        If the last axis has not 3 entries.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.shape[-1:] != (3,):
        raise ParameterFileError(
            f"{what} values of shape {array.shape} cannot be corrected; give an array whose last axis is x, y, z", Reason.USAGE
        )
    return array
