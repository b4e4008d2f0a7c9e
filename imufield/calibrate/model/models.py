"""Error models of the two triads: predict outputs, recover inputs, and their derivatives.

Accelerometer, with zeroed output ``N`` (raw unit), specific force ``a`` (m/s^2) and ``s = T a``::

    "sensing" quadratic axes    N = K (s + b) + K2 s**2
    "body" quadratic axes       N = K (s + b) + K2 a**2        as [1]_ eq. 8 to 10 print it

On sensing axes each axis is a quadratic of its own ``s``. Of its two roots the one that goes to ``N / K - b`` for a
vanishing ``K2`` is wanted, in the form without cancellation::

    s = f / (1/2 + sqrt(1/4 + f K2 / K)),    f = N / K - b

On body axes ``a = T^-1 ((N - K2 a**2) / K - b)`` is a contraction for any sane instrument ([1]_ eq. 14) and is iterated.

With higher terms (``higher_terms``) ``f = s + h(s)`` stands in place of ``s``, and ``T^-1 f`` in place of ``a``: what is
recovered without them is f, and ``s = f - h(s)`` is a contraction too.

The derivative of ``norm(a)`` with fixed outputs follows from ``N(a, p) = const``: with ``u = a / norm(a)`` and
``v = (dN/da)^-T u``, ``d norm(a) / dp = -v . dN/dp`` and ``d norm(a) / dN = v``. With higher terms and ``H = dh/ds``,
``y = (I + H)^-T T^-T u`` is ``d norm(a) / df``, and ``d norm(a) / dh = -y``.

Vectors of parameters have 15 entries in the order of ``ACCELEROMETER_NAMES``. Lever arms between
the accelerometers are not modelled: at rest they have no effect.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from imufield.calibrate.model.higher_terms import HigherTerms, higher_columns
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters, QuadraticAxes
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.dataclass import dataclass, replace
from imufield.errors import CalibrationError, Reason
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_Triad = TypeVar("_Triad", AccelerometerParameters, GyroscopeParameters)

PARAMETERS = 15
SCALE = slice(0, 3)
BIAS = slice(3, 6)
MISALIGNMENT = slice(6, 12)
QUADRATIC = slice(12, 15)
MISALIGNMENT_ROWS = np.array([0, 0, 1, 1, 2, 2])
MISALIGNMENT_COLUMNS = np.array([1, 2, 0, 2, 0, 1])
"""Row and column of T for the six entries of the vector: xy, xz, yx, yz, zx, zy."""
_OFF_DIAGONAL = 3 * MISALIGNMENT_ROWS + MISALIGNMENT_COLUMNS  # Their places in a flattened matrix.

# Relative change at which the iteration stops: navigation grade gets there in four or five passes.
_CONTRACTION_TOLERANCE = 1e-14
_CONTRACTION_ACCEPTED = 1e-12  # Rounding can keep the last bits moving for ever; a real failure moves by far more.
_CONTRACTION_PASSES = 60  # A contraction by 0.6 a pass reaches the tolerance in 60; what is slower is no instrument.


def to_vector(parameters: AccelerometerParameters) -> FloatArray:
    """Return the 15 parameters as a vector (``raw_zero`` and higher terms are none of them)."""
    off_diagonal = parameters.misalignment_rad[MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS]
    return np.concatenate([parameters.scale, parameters.bias_m_s2, off_diagonal, parameters.quadratic])


def from_vector(
    vector: FloatArray, raw_zero: FloatArray | None = None, quadratic_axes: QuadraticAxes = "sensing"
) -> AccelerometerParameters:
    """Return the parameters of a vector, shape (15,)."""
    zero = np.zeros(3) if raw_zero is None else np.asarray(raw_zero, dtype=np.float64)
    return AccelerometerParameters(
        scale=vector[SCALE].copy(),
        bias_m_s2=vector[BIAS].copy(),
        misalignment_rad=alignment_matrix(vector) - np.eye(3),
        quadratic=vector[QUADRATIC].copy(),
        raw_zero=zero,
        quadratic_axes=quadratic_axes,
    )


def alignment_matrix(vector: FloatArray) -> FloatArray:
    """Return T of one vector or of many, shape (..., 15) -> (..., 3, 3)."""
    return unit_diagonal_matrices(vector[..., MISALIGNMENT])


def unit_diagonal_matrices(off_diagonal: FloatArray) -> FloatArray:
    """Return matrices with a unit diagonal from their off-diagonals, shape (..., 6) -> (..., 3, 3)."""
    flat = np.empty((*off_diagonal.shape[:-1], 9))
    flat[..., ::4] = 1.0
    flat[..., _OFF_DIAGONAL] = off_diagonal
    return flat.reshape(*flat.shape[:-1], 3, 3)


def predict(parameters: AccelerometerParameters, a: FloatArray) -> FloatArray:
    """Return raw outputs, ``raw_zero`` included, for specific forces in m/s^2, both of shape (..., 3)."""
    s = a + a @ parameters.misalignment_rad.T
    if parameters.higher is not None:
        s = s + parameters.higher.of(s)
        a = s @ np.linalg.inv(np.eye(3) + parameters.misalignment_rad).T
    squared = s if parameters.quadratic_axes == "sensing" else a
    return np.asarray(parameters.scale * (s + parameters.bias_m_s2) + parameters.quadratic * squared**2 + parameters.raw_zero)


def recover(parameters: AccelerometerParameters, raw: FloatArray) -> FloatArray:
    """Return specific forces in m/s^2 for raw outputs, both of shape (n, 3).

    Raises
    ------
    CalibrationError
        If no specific force gives such an output with these parameters.
    """
    raw = np.asarray(raw, dtype=np.float64)
    zeroed = raw - parameters.raw_zero
    a = recover_vectors(to_vector(parameters), zeroed, parameters.quadratic_axes, parameters.higher)
    lost = np.isnan(a).any(axis=-1) & np.isfinite(raw).all(axis=-1)
    for row in np.flatnonzero(lost):
        output = raw.reshape(-1, 3)[row]
        s = _sensing_input(to_vector(parameters), output - parameters.raw_zero)
        if parameters.quadratic_axes == "body" or not np.isnan(s).any():
            key = "models.no_inverse" if parameters.higher is None else "models.no_higher_inverse"
            lost_row = sentence(key, raw=output.tolist(), row=int(row), passes=_CONTRACTION_PASSES)
            raise CalibrationError(lost_row, Reason.NOT_CONVERGED)
        axis = int(np.argmax(np.isnan(s).reshape(3)))
        model = {"scale": parameters.scale[axis], "quadratic": parameters.quadratic[axis]}
        beyond = sentence("models.turning_point", raw=float(output[axis]), axis=AXES[axis], row=int(row), **model)
        raise CalibrationError(beyond, Reason.BOUNDS)
    return a


def without_higher(parameters: AccelerometerParameters, raw: FloatArray) -> FloatArray:
    """Return the outputs (n, 3) that the same instrument without its higher terms would give; raises as ``recover``."""
    if parameters.higher is None:
        return raw
    return predict(replace(parameters, higher=None), recover(parameters, raw))


def recover_vectors(
    vector: FloatArray, raw: FloatArray, quadratic_axes: QuadraticAxes, higher: HigherTerms | None = None
) -> FloatArray:
    """Return specific forces for one or many candidate vectors; NaN where there is no solution.

    Parameters
    ----------
    vector : ndarray, shape (..., 15)
    raw : ndarray, shape (m, 3)
        Zeroed outputs.
    quadratic_axes : {"sensing", "body"}
    higher : HigherTerms, optional
        The same of all candidates.

    Returns
    -------
    ndarray, shape (..., m, 3)
    """
    T = alignment_matrix(vector)
    inverse = np.asarray(np.swapaxes(np.linalg.inv(T), -1, -2), dtype=np.float64)
    if higher is not None:
        felt = recover_vectors(vector, raw, quadratic_axes) @ np.swapaxes(T, -1, -2)
        return np.asarray(_contracted(felt, lambda s: felt - higher.of(s)) @ inverse)
    if quadratic_axes == "sensing":
        return np.asarray(_sensing_input(vector, raw) @ inverse)
    K, b, K2 = (vector[..., None, part] for part in (SCALE, BIAS, QUADRATIC))
    a: FloatArray = (raw / K - b) @ inverse
    if not np.any(K2):
        return a
    return _contracted(a, lambda a: ((raw - K2 * a**2) / K - b) @ inverse)  # [1]_ eq. 14


def _contracted(a: FloatArray, step: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return where steps from ``a`` stand still, NaN where they do not, shape (..., 3)."""
    change: FloatArray | float = np.inf
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_CONTRACTION_PASSES):
            previous, a = a, step(a)
            change = np.abs(a - previous).max(axis=-1) / np.maximum(np.abs(a).max(axis=-1), np.finfo(float).tiny)
            if not np.any(change > _CONTRACTION_TOLERANCE):
                break
    stuck = np.asarray(~(change <= _CONTRACTION_ACCEPTED))
    return np.where(stuck[..., None], np.nan, a)


def _sensing_input(vector: FloatArray, raw: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore"):
        return sensing_input(raw, *(vector[..., None, part] for part in (SCALE, BIAS, QUADRATIC)))


def sensing_input(raw: FloatArray, K: FloatArray, b: FloatArray, K2: FloatArray) -> FloatArray:
    """Return s on sensing axes, of shapes that broadcast; NaN, and NumPy's warning, where there is no solution."""
    linear = raw / K - b
    return np.asarray(linear / (0.5 + np.sqrt(0.25 + K2 / K * linear)))


@dataclass(frozen=True, slots=True, kw_only=True)
class NormDerivatives:
    """norm(a) of m positions and its derivatives at one parameter vector."""

    a: FloatArray
    """Specific force, shape (m, 3)."""
    norm: FloatArray
    """Shape (m,)."""
    jacobian: FloatArray
    """d norm / d parameters, shape (m, 15)."""
    raw_gradient: FloatArray
    """d norm / d raw output, shape (m, 3)."""
    by_higher: FloatArray
    """d norm / d higher terms, shape (m, 12); (m, 0) without them."""


def norm_derivatives(
    vector: FloatArray, raw: FloatArray, quadratic_axes: QuadraticAxes = "sensing", higher: HigherTerms | None = None
) -> NormDerivatives:
    """Return norm(a) and its analytic derivatives for zeroed outputs, shape (m, 3)."""
    K, b, K2 = vector[SCALE], vector[BIAS], vector[QUADRATIC]
    T = alignment_matrix(vector)
    felt = a = recover_vectors(vector, raw, quadratic_axes)
    if higher is not None:
        a = recover_vectors(vector, raw, quadratic_axes, higher)
    norm = np.linalg.norm(a, axis=1)
    s = felt @ T.T
    sensing = quadratic_axes == "sensing"
    slope = K + 2 * K2 * s if sensing else np.broadcast_to(K, s.shape)
    with np.errstate(invalid="ignore"):  # a position without any specific force has no direction: NaN
        u = a / norm[:, None]
    by_T, by_higher = np.zeros((len(raw), 6)), np.zeros((len(raw), 0))
    if higher is not None:
        u, by_T, by_higher = _through_higher(T, a, felt, u, higher=higher)
    # d norm / dN = (dN/da)^-T u
    if sensing:
        v = np.linalg.solve(T.T, u.T).T / slope
    else:
        dN_da = K[:, None] * T + 2 * K2 * felt[:, :, None] * np.eye(3)
        v = np.linalg.solve(np.swapaxes(dN_da, 1, 2), u[:, :, None])[:, :, 0]
    # d norm / dp = -v . dN/dp
    misalignment = (v * slope)[:, MISALIGNMENT_ROWS] * felt[:, MISALIGNMENT_COLUMNS] + by_T
    squared = s**2 if sensing else felt**2
    jacobian = -np.hstack([v * (s + b), v * K, misalignment, v * squared])
    return NormDerivatives(a=a, norm=norm, jacobian=jacobian, raw_gradient=np.asarray(v, dtype=np.float64), by_higher=by_higher)


def _through_higher(
    T: FloatArray, a: FloatArray, felt: FloatArray, u: FloatArray, *, higher: HigherTerms
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d norm / d T^-1 f, what the derivatives by misalignments have beside it, and those by higher terms."""
    s = a @ T.T
    H = higher.slope(s)
    by_felt = np.linalg.solve(np.eye(3) + np.swapaxes(H, 1, 2), (u @ np.linalg.inv(T))[:, :, None])
    y = np.asarray(by_felt[:, :, 0], dtype=np.float64)
    # f = T a + h(T a) depends on T itself, and T^-1 f once more.
    bent = (y[:, None, :] @ H)[:, 0]
    rows, columns = MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS
    by_T = bent[:, rows] * a[:, columns] - y[:, rows] * (felt - a)[:, columns]
    return y @ T, by_T, -higher_columns(y, s)


def predict_gyroscope(parameters: GyroscopeParameters, rate: FloatArray, a: FloatArray | None = None) -> FloatArray:
    """Return raw outputs N = K E w + e + G a + raw_zero for rates in rad/s (and specific forces in m/s^2), shape (..., 3)."""
    turned = rate + rate @ parameters.misalignment_rad.T
    output: FloatArray = parameters.scale * turned + parameters.offset
    return output if a is None else output + a @ parameters.g_sensitivity.T


def at_temperature(parameters: _Triad, temperature: TriadTemperature, temperature_degc: float) -> _Triad:
    """Return the parameters of a triad that hold at a temperature."""
    factor, bias = temperature.change_at(temperature_degc)
    scale = parameters.scale * factor
    if isinstance(parameters, AccelerometerParameters):
        # Its bias stands inside K (s + b), that of a gyroscope outside.
        return replace(parameters, scale=scale, bias_m_s2=parameters.bias_m_s2 + bias, quadratic=parameters.quadratic * factor)
    e = (parameters.bias + parameters.scale * bias) * factor
    return replace(parameters, scale=scale, bias=e, g_sensitivity=parameters.g_sensitivity * factor[:, None])
