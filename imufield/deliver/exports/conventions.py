"""The one place where our error model becomes the correction other programs store.

Ours is the error direction, raw output from specific force: ``N = K (T a + b) + K2 (T a)**2 + raw_zero``. Without the quadratic
term it is ``N = M^-1 a + o`` with ``M = (K T)^-1`` and ``o = raw_zero + K b``. Four ways of writing that are in use::

    shifted input    u = M (N - o)             VectorNav, imu_tk, PX4, ArduPilot     Correction.matrix, .offset
    shifted output   u = M N - M o             dpkoch imu_calib, DLIO, RealSense, Basalt, PSINS     .output_offset
    error direction  N = M^-1 u + o            Kalibr, OpenVINS, pyins               .error_matrix
    split            N = K R u + o             imucal; imu_tk splits M = T K         .split_rows, .split_columns

A target that wants a triangular matrix wants another body frame: one rotation ``R``, ``u' = R u``, for both triads (``Frame``).

Quadratic term. On a sensing axis ``N = K (s + b) + K2 s**2``. Over all directions at 1 g, s is spread evenly over [-g, g]
(Archimedes' hat-box theorem), so the straight line nearest to it in the least-squares sense has the same K and the bias
``b + K2 g**2 / (3 K)``; what is left is ``K2 / K g**2 (x**2 - 1/3)``, ``0.298 K2 / K g**2`` rms and two thirds of it at most.
A cubic term ``c s**3`` makes the scale ``1 + 3 c g**2 / 5`` times as large, by the same means; cross terms do nothing to it.

Scale and bias only. With unit sensing axes ``u_i = T_i / norm(T_i)``, the diagonal model whose norm stays right on average
over all directions is ``S_i = 1 / (K_i norm(T_i))`` in the frame nearest to the sensing axes (``Frame`` "sensor"): the cross
terms of the norm have no mean there. Cutting the diagonal out of ``M`` in a triangular gauge is wrong by the squared angles.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imufield.calibrate.model.gauge import change_gauge
from imufield.calibrate.model.models import MISALIGNMENT, to_vector
from imufield.calibrate.model.result import AccelerometerParameters, Calibration, GyroscopeParameters
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.apply import correction_matrix
from imufield.errors import ParameterFileError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Frame = Literal["file", "lower", "upper", "symmetric", "sensor"]
"""Body frame of an export: as in the parameter file, one of three gauges, or nearest to the accelerometer's sensing axes."""

# What an export computes with, by triad.
_NEEDED = {
    "accelerometer": ("scale", "bias_m_s2", "misalignment_rad", "quadratic", "raw_zero"),
    "gyroscope": ("scale", "misalignment_rad", "bias", "g_sensitivity", "raw_zero"),
}


@dataclass(frozen=True, slots=True)
class Correction:
    """u = M (N - o): how the raw output of a triad is corrected."""

    matrix: FloatArray
    """M, shape (3, 3), m/s^2 (or rad/s) per raw unit."""
    offset: FloatArray
    """o, shape (3,), raw unit."""

    def apply(self, raw: FloatArray) -> FloatArray:
        """Return corrected values, shape (..., 3)."""
        return np.asarray((raw - self.offset) @ self.matrix.T)

    @property
    def output_offset(self) -> FloatArray:
        """M o of u = M N - M o, shape (3,)."""
        return np.asarray(self.matrix @ self.offset)

    @property
    def error_matrix(self) -> FloatArray:
        """M^-1 of N = M^-1 u + o, shape (3, 3)."""
        return np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)

    def split_rows(self) -> tuple[FloatArray, FloatArray]:
        """Return K, diagonal, and R, rows of unit length, of N = K R u + o; both of shape (3, 3)."""
        error = self.error_matrix
        length = np.linalg.norm(error, axis=1)
        return np.diag(length), error / length[:, None]

    def split_columns(self) -> tuple[FloatArray, FloatArray]:
        """Return T, unit diagonal, and K, diagonal, of u = T K (N - o); both of shape (3, 3)."""
        diagonal = np.diag(self.matrix)
        return self.matrix / diagonal, np.diag(diagonal)

    def turned(self, rotation: FloatArray) -> Correction:
        """Return the correction into a body frame u' = R u."""
        return Correction(rotation @ self.matrix, self.offset)

    def of_scaled(self, scale: float, zero: FloatArray) -> Correction:
        """Return the correction of raw values given as (N - zero) / scale."""
        return Correction(self.matrix * scale, (self.offset - zero) / scale)


@dataclass(frozen=True, slots=True)
class Corrections:
    """Both triads in one body frame."""

    accelerometer: Correction
    gyroscope: Correction | None
    g_sensitivity: FloatArray
    """G, shape (3, 3), raw gyroscope unit per m/s^2 in this body frame: w = M (N - o - G a)."""
    rotation: FloatArray
    """R of u' = R u from the parameter file's body frame to this one, shape (3, 3)."""

    @property
    def triads(self) -> dict[str, Correction]:
        """The triads that there are, by name."""
        both = {"accelerometer": self.accelerometer, "gyroscope": self.gyroscope}
        return {name: correction for name, correction in both.items() if correction is not None}

    @property
    def has_g_sensitivity(self) -> bool:
        """Whether anything of a specific force is taken off the gyroscope."""
        return bool(np.any(self.g_sensitivity))

    def turned(self, rotation: FloatArray) -> Corrections:
        """Return the corrections into a body frame u' = R u, accelerometer and gyroscope together."""
        gyroscope = None if self.gyroscope is None else self.gyroscope.turned(rotation)
        G: FloatArray = self.g_sensitivity @ rotation.T
        return Corrections(self.accelerometer.turned(rotation), gyroscope, G, rotation @ self.rotation)

    def without_g_sensitivity(self) -> Corrections:
        """Return the same for a target that does not know G."""
        return replace(self, g_sensitivity=np.zeros((3, 3)))

    def apply_accelerometer(self, raw: FloatArray) -> FloatArray:
        """Return specific force in m/s^2 for raw outputs, both of shape (..., 3)."""
        return self.accelerometer.apply(raw)

    gyroscope_force = apply_accelerometer
    """G is multiplied with what the linear accelerometer makes of its raw output."""

    def apply_gyroscope(self, raw: FloatArray, specific_force: FloatArray) -> FloatArray:
        """Return angular rate in rad/s for raw outputs and specific force in this frame, shape (..., 3)."""
        if self.gyroscope is None:
            return np.full_like(raw, np.nan)
        return self.gyroscope.apply(raw - specific_force @ self.g_sensitivity.T)


def linear_corrections(calibration: Calibration, frame: Frame = "file") -> Corrections:
    """Return the linear corrections nearest to a calibration over all directions at 1 g, in a body frame.

    Raises
    ------
    ParameterFileError
        If a parameter is not finite or a scale is zero.
    CalibrationError
        If the sensing axes are left-handed or nearly in one plane.
    """
    require_usable(calibration)
    accelerometer = linearised(calibration.accelerometer, calibration.gravity.gravity_m_s2)
    gyroscope, g_sensitivity = None, np.zeros((3, 3))
    rates = _usable_gyroscope(calibration)
    if rates is not None:
        gyroscope = Correction(correction_matrix(rates.scale, rates.misalignment_rad), rates.offset)
        g_sensitivity = rates.g_sensitivity
    matrix = correction_matrix(accelerometer.scale, accelerometer.misalignment_rad)
    corrections = Corrections(Correction(matrix, accelerometer.offset), gyroscope, g_sensitivity, rotation=np.eye(3))
    if frame == "file":
        return corrections
    turned = corrections.turned(rotation_to(calibration.accelerometer, frame))
    # The gauge makes these entries zero; what rounding leaves of them would be refused or read as a misalignment.
    shape = {"lower": np.tril, "upper": np.triu}.get(frame, np.asarray)
    return replace(turned, accelerometer=Correction(shape(turned.accelerometer.matrix), accelerometer.offset))


def diagonal_corrections(calibration: Calibration) -> Corrections:
    """Return the best corrections of scale and bias only for the accelerometer.

    In the frame nearest to the accelerometer's sensing axes. The gyroscope's matrix stays whole: what scale a target without
    one assumes is the target's affair.
    """
    corrections = linear_corrections(calibration, "sensor")
    parameters = calibration.accelerometer
    length = np.linalg.norm(np.eye(3) + parameters.misalignment_rad, axis=1)
    diagonal = np.diag(1 / (parameters.scale * length))
    return replace(corrections, accelerometer=Correction(diagonal, corrections.accelerometer.offset))


def linearised(parameters: AccelerometerParameters, gravity_m_s2: float) -> AccelerometerParameters:
    """Return the linear model nearest to one with more terms over all directions at 1 g."""
    squared_length = np.ones(3)
    if parameters.quadratic_axes == "sensing":
        squared_length = np.sum((np.eye(3) + parameters.misalignment_rad) ** 2, axis=1)
    mean = parameters.quadratic / parameters.scale * gravity_m_s2**2 * squared_length / 3
    bias = parameters.bias_m_s2 + mean
    slope = np.ones(3) if parameters.higher is None else 1 + parameters.higher.cubic * gravity_m_s2**2 * squared_length * 3 / 5
    return replace(parameters, scale=parameters.scale * slope, bias_m_s2=bias / slope, quadratic=np.zeros(3), higher=None)


def rotation_to(parameters: AccelerometerParameters, frame: Frame) -> FloatArray:
    """Return R of u' = R u from the parameters' body frame to another, shape (3, 3)."""
    vector = to_vector(parameters)
    if frame == "file":
        return np.eye(3)
    if frame == "sensor":
        # A preset without misalignment has its body axes along the sensing axes.
        along_axes = vector.copy()
        along_axes[MISALIGNMENT] = 0.0
        return change_gauge(vector, "preset", along_axes).rotation
    return change_gauge(vector, frame).rotation


def rotation_times_triangle(matrix: FloatArray, triangle: Literal["lower", "upper"]) -> tuple[FloatArray, FloatArray]:
    """Split a matrix into Q, the proper rotation near the identity, and a triangular matrix: M = Q L or M = Q U."""
    order = slice(None, None, -1) if triangle == "lower" else slice(None)
    Q, R = np.linalg.qr(matrix[order, order])
    Q, R = Q[order, order], R[order, order]
    sign = np.where(np.diag(Q) < 0, -1.0, 1.0)
    # A reflection is no body frame; the axis that is least certain of its sign gives way.
    if np.linalg.det(Q * sign) < 0:
        sign[np.argmin(np.abs(np.diag(Q)))] *= -1
    return np.asarray(Q * sign, dtype=np.float64), np.asarray(sign[:, None] * R, dtype=np.float64)


def require_usable(calibration: Calibration) -> None:
    """Check that every parameter that will be used is a number and no scale is zero; raise ``ParameterFileError``."""
    triads = {"accelerometer": calibration.accelerometer, "gyroscope": _usable_gyroscope(calibration)}
    for triad, keys in _NEEDED.items():
        for key in keys if triads[triad] is not None else ():
            values = np.asarray(getattr(triads[triad], key))
            if not np.all(np.isfinite(values) & ((values != 0) | (key != "scale"))):
                refused = sentence("conventions.not_usable", name=f"{triad}.{key}", value=values.tolist())
                raise ParameterFileError(refused, Reason.NOT_FINITE)


def _usable_gyroscope(calibration: Calibration) -> GyroscopeParameters | None:
    """Return the parameters of a gyroscope whose scale is known: without it there is no rate."""
    gyroscope = calibration.gyroscope
    return gyroscope.parameters if gyroscope is not None and np.isfinite(gyroscope.parameters.scale).all() else None
