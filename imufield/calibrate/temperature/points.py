"""Data points of the fit over temperature: bias and scale of each solved session, relative to the reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imufield.calibrate.model.result import (
    AccelerometerParameters,
    Calibration,
    GyroscopeCalibration,
    GyroscopeParameters,
)
from imufield.calibrate.model.uncertainty import without_gravity
from imufield.calibrate.temperature.fit import SessionPoints
from imufield.samples import FloatArray

_LEFT_OUT = 1.0  # Variance of a scale that a session does not show: any, as its row is left out.


class _Point(NamedTuple):
    """What one session found: a row of each array of ``SessionPoints``."""

    bias: FloatArray
    scale: FloatArray
    covariance: FloatArray


def accelerometer_points(
    reference: AccelerometerParameters,
    sessions: Sequence[Calibration],
    temperature_degc: Sequence[float],
    of_reference: int | None = None,
) -> SessionPoints:
    """Return bias and scale of sessions at temperatures, one each; all in the gauge of the reference.

    ``of_reference`` is the number of the session that the reference comes from.
    """
    return _points([_accelerometer(reference, session) for session in sessions], temperature_degc, of_reference)


def gyroscope_points(
    reference: GyroscopeParameters,
    sessions: Sequence[GyroscopeCalibration],
    temperature_degc: Sequence[float],
    of_reference: int | None = None,
) -> SessionPoints:
    """Return the same of gyroscopes, the bias as a rate; all in the frame of the reference."""
    return _points([_gyroscope(reference, session) for session in sessions], temperature_degc, of_reference)


def _points(points: Sequence[_Point], temperature_degc: Sequence[float], reference: int | None) -> SessionPoints:
    arrays = {name: np.array([getattr(point, name) for point in points]) for name in _Point._fields}
    return SessionPoints(temperature_degc=np.array(temperature_degc), reference=reference, **arrays)


def _accelerometer(reference: AccelerometerParameters, session: Calibration) -> _Point:
    unit = np.stack([np.ones(3), 1 / reference.scale], axis=1)
    rows = [[session.covariance_names.index(f"accelerometer.{key}.{axis}") for key in ("bias_m_s2", "scale")] for axis in "xyz"]
    # The error of gravity is that of the place, and no change from one temperature to another.
    known = without_gravity(session.covariance_names, session.covariance)
    covariance = np.array([known[np.ix_(row, row)] for row in rows]) * unit[:, :, None] * unit[:, None, :]
    return _Point(session.accelerometer.bias_m_s2, session.accelerometer.scale / reference.scale - 1, covariance)


def _gyroscope(reference: GyroscopeParameters, session: GyroscopeCalibration) -> _Point:
    K, found, sigma = reference.scale, session.parameters.about(reference.raw_zero), session.sigma
    is_shown = np.isfinite(sigma.scale)
    scale = np.where(is_shown, found.scale / K - 1, np.nan)
    covariance = np.zeros((3, 2, 2))
    covariance[:, 0, 0] = (sigma.bias / K) ** 2
    covariance[:, 1, 1] = np.where(is_shown, (sigma.scale / K) ** 2, _LEFT_OUT)
    # The bias as an output has grown with the scale; B has not.
    return _Point(found.bias / np.where(is_shown, 1 + scale, 1.0) / K, scale, covariance)
