"""Gauges: which turn of the body frame the parameters are written in.

The norm leaves the body frame free (``observability``), so a gauge fixes it by three constraints ``c(p) = 0``:

    lower      T_xy = T_xz = T_yz = 0         the sensing x axis is the body x axis
    upper      T_yx = T_zx = T_zy = 0         the sensing z axis is the body z axis
    symmetric  T_xy = T_yx, T_xz = T_zx, T_yz = T_zy
    preset     sum_i u_i x p_i = 0            unit sensing axes u nearest to the preset's p (Kabsch [1]_)

To change the gauge is to turn by one rotation ``R``, accelerometer and gyroscope together. Its derivative has two parts: the
turn with ``R`` fixed (matrix ``A``), and the change of ``R`` that keeps the constraints. With ``C = dc/dp`` and the generators
``G`` at the turned point

    d p' = (I - G (C G)^-1 C) A d p

which carries a covariance from one gauge to another. On "body" quadratic axes the turn is not exact; refit after it.

References
----------
.. [1] W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A32 (1976).
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import (
    BIAS,
    MISALIGNMENT,
    MISALIGNMENT_COLUMNS,
    MISALIGNMENT_ROWS,
    PARAMETERS,
    QUADRATIC,
    SCALE,
    alignment_matrix,
    from_vector,
    to_vector,
)
from imufield.calibrate.model.observability import generators
from imufield.calibrate.model.result import AccelerometerParameters, Gauge, GyroscopeParameters, Intrinsic, QuadraticAxes
from imufield.calibrate.model.rotation import cross, unit_vectors
from imufield.dataclass import dataclass, fields, replace
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_UPPER_ENTRIES = (6, 7, 9)
_LOWER_ENTRIES = (8, 10, 11)
_LEAST_VOLUME = 0.01  # Of the unit sensing axes: nearer to one plane than any instrument, or left-handed.
_SYMMETRIC_PASSES = 50  # At most: Newton takes two for misalignments up to 0.05 rad.


@dataclass(frozen=True, slots=True)
class GaugeChange:
    """Parameters in another gauge."""

    vector: FloatArray
    """Shape (15,)."""
    rotation: FloatArray
    """R of a' = R a, shape (3, 3)."""
    jacobian: FloatArray
    """d new / d old parameters, shape (15, 15)."""
    turn: FloatArray
    """How R follows the old parameters: it becomes (I + [w]) R with w = ``turn`` dp, shape (3, 15)."""


def change_gauge(vector: FloatArray, gauge: Gauge, preset: FloatArray | None = None) -> GaugeChange:
    """Write a parameter vector, shape (15,), in a gauge.

    Raises
    ------
    UsageError
        If the gauge is "preset" and there is no preset.
    CalibrationError
        If the sensing axes are left-handed or nearly in one plane.
    """
    rotation = _rotation_to(vector, gauge, preset)
    turned, jacobian = turn(vector, rotation)
    G = generators(turned)
    # d p' = (I - G (C G)^-1 C) A d p: R changes so that the constraints stay met
    C = constraint_jacobian(turned, gauge, preset)
    following = np.asarray(-np.linalg.solve(C @ G, C @ jacobian), dtype=np.float64)
    return GaugeChange(turned, rotation, jacobian + G @ following, following)


def turn(vector: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return parameters for a body frame turned by a' = R a, and their derivative with R fixed."""
    T = alignment_matrix(vector)
    M = T @ rotation.T
    D = np.diag(M).copy()
    K, b, K2 = vector[SCALE], vector[BIAS], vector[QUADRATIC]
    misalignment = (M / D[:, None])[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]
    A = np.zeros((PARAMETERS, PARAMETERS))
    # With D = diag(T R^T): K' = K D, b' = b / D, T' = D^-1 T R^T, K2' = K2 D^2.
    A[range(PARAMETERS), range(PARAMETERS)] = np.concatenate([D, 1 / D, np.zeros(6), D**2])
    i, j, entries = MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS, np.arange(PARAMETERS)[MISALIGNMENT]
    dM = rotation[:, j]  # by each entry, row i of dM; the other rows do not change
    dD = dM[i, range(6)]
    A[i, entries] = K[i] * dD
    A[3 + i, entries] = -b[i] / D[i] ** 2 * dD
    A[12 + i, entries] = 2 * K2[i] * D[i] * dD
    A[MISALIGNMENT, MISALIGNMENT] = (i[:, None] == i) * (dM[j] / D[i] - M[i][:, j].T * dD / D[i] ** 2)
    return np.concatenate([K * D, b / D, misalignment, K2 * D**2]), A


def turn_gyroscope(parameters: GyroscopeParameters, rotation: FloatArray) -> GyroscopeParameters:
    """Return gyroscope parameters for a body frame turned by a' = R a: E and G turn with it."""
    M = (np.eye(3) + parameters.misalignment_rad) @ rotation.T
    D = np.diag(M).copy()
    return replace(
        parameters,
        scale=parameters.scale * D,
        misalignment_rad=M / D[:, None] - np.eye(3),
        g_sensitivity=parameters.g_sensitivity @ rotation.T,
    )


def turn_accelerometer(parameters: AccelerometerParameters, rotation: FloatArray) -> AccelerometerParameters:
    """Return accelerometer parameters for a body frame turned by a' = R a."""
    turned = from_vector(turn(to_vector(parameters), rotation)[0], parameters.raw_zero, parameters.quadratic_axes)
    if parameters.higher is None:
        return turned
    return replace(turned, higher=parameters.higher.turned(turned.scale / parameters.scale))


def constraint_jacobian(vector: FloatArray, gauge: Gauge, preset: FloatArray | None = None) -> FloatArray:
    """Return C = dc/dp of the gauge's three constraints, shape (3, 15)."""
    C = np.zeros((3, PARAMETERS))
    if gauge == "preset":
        T = alignment_matrix(vector)
        length = np.linalg.norm(T, axis=1)
        u, p = T / length[:, None], unit_vectors(alignment_matrix(_required(preset)))
        i, j = MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS
        du = (np.eye(3)[j] - u[i] * u[i, j, None]) / length[i, None]
        C[:, MISALIGNMENT] = cross(du, p[i]).T
        return C
    # lower: upper entries zero; upper: lower entries zero; symmetric: their difference zero
    if gauge in ("lower", "symmetric"):
        C[range(3), _UPPER_ENTRIES] = 1.0
    if gauge in ("upper", "symmetric"):
        C[range(3), _LOWER_ENTRIES] = -1.0
    return C


def _required(preset: FloatArray | None) -> FloatArray:
    if preset is None:
        raise UsageError(sentence("gauge.no_preset"))
    return preset


def _rotation_to(vector: FloatArray, gauge: Gauge, preset: FloatArray | None) -> FloatArray:
    unit = unit_vectors(alignment_matrix(vector))
    volume = float(np.linalg.det(unit))
    if not volume > _LEAST_VOLUME:
        raise CalibrationError(sentence("gauge.left_handed", volume=volume, least_volume=_LEAST_VOLUME), Reason.HANDEDNESS)
    if gauge == "preset":
        return _kabsch(unit, unit_vectors(alignment_matrix(_required(preset))))
    if gauge == "lower":
        return _triangular_frame(unit)
    if gauge == "upper":
        # Reversing the order of axes turns the upper case into the lower one.
        return _triangular_frame(unit[::-1, ::-1])[::-1, ::-1]
    # Symmetric: Newton steps on the antisymmetric part.
    rotation = _kabsch(unit, np.eye(3))  # symmetric for equal row lengths; a near start for others
    C = constraint_jacobian(vector, "symmetric")
    for _ in range(_SYMMETRIC_PASSES):
        turned = turn(vector, rotation)[0]
        constraint = C @ turned
        if np.abs(constraint).max() < 1e-15:
            break
        w = np.asarray(-np.linalg.solve(C @ generators(turned), constraint), dtype=np.float64)
        # A proper rotation by about w, in Cayley form: orthogonal to rounding.
        x, y, z = w / 2
        half = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rotation = np.asarray(np.linalg.solve(np.eye(3) - half, np.eye(3) + half), dtype=np.float64) @ rotation
    return rotation


def _kabsch(unit: FloatArray, target: FloatArray) -> FloatArray:
    """Return the rotation R that brings the rows of ``unit`` nearest to those of ``target``: u_i' = R u_i."""
    left, _, right = np.linalg.svd(target.T @ unit)
    # [1]_: the smallest singular direction is reversed where the best fit would be a reflection
    fix = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray(left @ fix @ right)


def _triangular_frame(unit: FloatArray) -> FloatArray:
    """Return the orthonormal rows of Gram-Schmidt in the order x, y, z: T R^T is lower triangular, diagonal positive."""
    x = unit[0]
    y = unit[1] - (unit[1] @ x) * x
    y /= np.linalg.norm(y)
    z = unit[2] - (unit[2] @ x) * x - (unit[2] @ y) * y
    return np.array([x, y, z / np.linalg.norm(z)])


def intrinsic(vector: FloatArray, quadratic_axes: QuadraticAxes = "sensing") -> tuple[FloatArray, FloatArray]:
    """Return the 12 gauge-free numbers and their derivatives.

    Returns
    -------
    values : ndarray, shape (12,)
        Row lengths of K T with the sign of K; K b; angles between sensing axes x-y, x-z, y-z minus a right angle; K2 along
        the *unit* sensing axis, K2_i norm(T_i)**2, because K2 by itself changes with the gauge (K2 itself on body axes).
    jacobian : ndarray, shape (12, 15)
    """
    T = alignment_matrix(vector)
    length = np.linalg.norm(T, axis=1)
    u = T / length[:, None]
    K, b, K2 = vector[SCALE], vector[BIAS], vector[QUADRATIC]
    # K2 by itself changes with the gauge; along the unit sensing axis it does not.
    power = length**2 if quadratic_axes == "sensing" else np.ones(3)
    pairs = ((0, 1), (0, 2), (1, 2))
    cosines = np.array([u[i] @ u[j] for i, j in pairs])
    values = np.concatenate([K * length, K * b, -np.arcsin(cosines), K2 * power])
    J = np.zeros((len(values), PARAMETERS))
    J[range(3), range(3)] = length
    J[range(3, 6), range(3)] = b
    J[range(3, 6), range(3, 6)] = K
    J[range(9, 12), range(12, 15)] = power
    for k, (i, j) in enumerate(zip(MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS, strict=True)):
        J[i, 6 + k] = K[i] * u[i, j]
        if quadratic_axes == "sensing":
            J[9 + i, 6 + k] = 2 * K2[i] * T[i, j]
        du = (np.eye(3)[j] - u[i] * u[i, j]) / length[i]
        for row, pair in enumerate(pairs):
            if i in pair:
                other = pair[0] if pair[1] == i else pair[1]
                J[6 + row, 6 + k] = -(du @ u[other]) / np.sqrt(1 - cosines[row] ** 2)
    return values, J


def make_intrinsic(values: FloatArray, sigma: FloatArray) -> Intrinsic:
    """Put the 12 gauge-free numbers and their sigmas into their record."""
    names = (field.name for field in fields(Intrinsic))
    return Intrinsic(**dict(zip(names, np.split(np.concatenate([values, sigma]), 8), strict=True)))
