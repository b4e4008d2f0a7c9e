"""The papers' cost functions over whole populations, written for speed: one call, no iteration that can be avoided.

``NormPopulation`` has the same costs as ``costs.NormProblem`` and agrees with it to rounding, in about a fifth of the time:
the inverse of the printed form ([1]_ eq. 14) starts from ``T^-1 (N / K - b)`` and takes a fixed number of passes; only the
candidates that still move then take the slow, safe way.

``TriadProblem`` is the linear triad of [2]_ eq. 1 and 3, ``N = K E w + n0``, in the paper's own vector (eq. 8 and 19), for
accelerometer (L_a, eq. 7) and gyroscope at rest (L_g, eq. 7).

``TurnsProblem`` is the gyroscope on a turntable. With ``N+`` and ``N-`` the mean outputs of a turn by ``w`` and by ``-w``::

    norm form     L_gm = sqrt(sum (|N+ - N-|^2 - |K E 2 w|^2)^2 / (J - 1))                    [2]_ eq. 26
    vector form   L_gv = sqrt(sum |(N+ - N-) / 2 - K E w|^2 / (3 J - 9))                     from [2]_ eq. 25

For turns about the sensor axes the norm form holds nothing but the three column norms of ``K E``: rank 3 of 9. Every turn of
the vector form gives three numbers, and three axes give all nine entries.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020.
.. [2] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imufield.calibrate.costs import CostName
from imufield.calibrate.models import BIAS, MISALIGNMENT, QUADRATIC, SCALE, norm_derivatives, recover_vectors
from imufield.calibrate.result import ACCELEROMETER_NAMES, QuadraticAxes
from imufield.samples import FloatArray

_PASSES = 4
"""Passes of eq. 14 that reach 2e-15 for navigation-grade parameters."""
_MORE_PASSES = 6
"""Passes more that settle the wild candidates of the first rounds without the safe way."""
_MOVING = 1e-12
"""Relative change in the last pass above which a candidate is inverted with care."""
_OFF_DIAGONAL = np.array([1, 2, 3, 5, 6, 7])
"""Places of T_xy, T_xz, T_yx, T_yz, T_zx, T_zy in a flattened 3 x 3 matrix."""


def unit_diagonal_matrices(off_diagonal: FloatArray) -> FloatArray:
    """Return matrices with a unit diagonal from their off-diagonals, shape (c, 6) -> (c, 3, 3)."""
    flat = np.empty((len(off_diagonal), 9))
    flat[:, (0, 4, 8)] = 1.0
    flat[:, _OFF_DIAGONAL] = off_diagonal
    return flat.reshape(-1, 3, 3)


def _inverse(T: FloatArray) -> FloatArray:
    """Return inverses, shape (c, 3, 3); NaN for the singular matrices a wild step may propose."""
    try:
        return np.asarray(np.linalg.inv(T), dtype=np.float64)
    except np.linalg.LinAlgError:  # LAPACK refuses the whole population for one of them
        T[np.linalg.det(T) == 0] = np.nan
        return np.asarray(np.linalg.inv(T), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class NormPopulation:
    """Norms of m positions as a function of n coordinates: parameters = origin + basis z.

    Attributes
    ----------
    raw : ndarray, shape (m, 3)
        Zeroed mean outputs.
    gravity_m_s2 : float
    sigma_m_s2 : ndarray, shape (m,)
    origin : ndarray, shape (15,)
    basis : ndarray, shape (15, n)
    lower, upper : ndarray, shape (n,)
        Bounds of the coordinates.
    quadratic_axes : {"sensing", "body"}
    cost_name : {"absolute", "squares", "weighted"}
    """

    raw: FloatArray
    gravity_m_s2: float
    sigma_m_s2: FloatArray
    origin: FloatArray
    basis: FloatArray
    lower: FloatArray
    upper: FloatArray
    quadratic_axes: QuadraticAxes = "sensing"
    cost_name: CostName = "absolute"

    @property
    def start(self) -> FloatArray:
        """The origin, shape (n,)."""
        return np.zeros(self.basis.shape[1])

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Limits of the coordinates, shape (n,) each."""
        return self.lower, self.upper

    @property
    def names(self) -> tuple[str, ...]:
        """What each coordinate moves most, for messages."""
        weight = np.abs(self.basis) / np.maximum(np.abs(self.basis).max(axis=1, keepdims=True), np.finfo(float).tiny)
        return tuple(ACCELEROMETER_NAMES[int(k)] for k in np.argmax(weight, axis=0))

    def vector(self, z: FloatArray) -> FloatArray:
        """Return parameters of coordinates, shape (..., n) -> (..., 15)."""
        vector: FloatArray = z @ self.basis.T
        vector += self.origin
        return vector

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return the cost of a population, shape (c, n) -> (c,); inf where the model cannot be inverted."""
        squares = self._squared_norms(self.vector(candidates))
        cost: FloatArray
        if self.cost_name == "squares":
            squares -= self.gravity_m_s2**2
            cost = np.sqrt(np.einsum("cm,cm->c", squares, squares) / (squares.shape[1] - 1))  # eq. 7 of [2]_
        else:
            residual = np.sqrt(squares, out=squares)
            residual -= self.gravity_m_s2
            if self.cost_name == "absolute":
                cost = np.abs(residual, out=residual).sum(axis=1)  # eq. 13 of [1]_
            else:
                residual /= self.sigma_m_s2
                cost = np.einsum("cm,cm->c", residual, residual)
        cost[~np.isfinite(cost)] = np.inf
        return cost

    def _squared_norms(self, vectors: FloatArray) -> FloatArray:
        """Return norm(a)^2, shape (c, 15) -> (c, m)."""
        with np.errstate(all="ignore"):
            inverse = _inverse(unit_diagonal_matrices(vectors[:, MISALIGNMENT]))
            a = self._sensing(vectors, inverse) if self.quadratic_axes == "sensing" else self._body(vectors, inverse)
            return np.asarray(np.einsum("cim,cim->cm", a, a))

    def _sensing(self, vectors: FloatArray, inverse: FloatArray) -> FloatArray:
        K, b, K2 = (vectors[:, part, None] for part in (SCALE, BIAS, QUADRATIC))
        unbiased = self.raw.T - K * b
        root = np.sqrt(K**2 + 4 * K2 * unbiased)
        s = 2 * unbiased / (K + np.copysign(root, K))
        return np.asarray(inverse @ s)

    def _body(self, vectors: FloatArray, inverse: FloatArray) -> FloatArray:
        K = vectors[:, SCALE]
        input_b = self.raw.T / K[:, :, None]
        input_b -= vectors[:, BIAS, None]
        linear = inverse @ input_b
        curved = inverse * (vectors[:, QUADRATIC] / K)[:, None, :]  # eq. 14 of [1]_: a = T^-1 (N / K - b) - T^-1 (K2 / K) a^2
        a = before = linear
        for _ in range(_PASSES - 1):
            a = linear - curved @ (a * a)
        for _ in range(_MORE_PASSES):
            before, a = a, linear - curved @ (a * a)
            if np.abs(a - before).max() <= _MOVING * self.gravity_m_s2:
                return np.asarray(a)
        # Negated, because a candidate with NaN moves too.
        moving = ~(np.abs(a - before).max(axis=(1, 2)) <= _MOVING * self.gravity_m_s2)
        a[moving] = np.swapaxes(recover_vectors(vectors[moving], self.raw, self.quadratic_axes), 1, 2)
        return np.asarray(a)

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return what least squares minimises for this cost, shape (m,)."""
        a = recover_vectors(self.vector(z), self.raw, self.quadratic_axes)
        norm = np.linalg.norm(a, axis=-1)
        if self.cost_name == "squares":
            return np.asarray((norm**2 - self.gravity_m_s2**2) / np.sqrt(len(norm) - 1))
        return np.asarray((norm - self.gravity_m_s2) / self.sigma_m_s2)

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the derivative of ``residuals``, shape (m, n)."""
        derivatives = norm_derivatives(self.vector(z), self.raw, self.quadratic_axes)
        jacobian = derivatives.jacobian @ self.basis
        if self.cost_name == "squares":
            return np.asarray(jacobian * (2 * derivatives.norm / np.sqrt(len(jacobian) - 1))[:, None])
        return np.asarray(jacobian / self.sigma_m_s2[:, None])


TRIAD_NAMES = tuple(f"{kind}.{axis}" for kind, axes in (
    ("K", "xyz"), ("E", ("xy", "xz", "yx", "yz", "zx", "zy")), ("n0", "xyz")) for axis in axes)  # fmt: skip
"""The vector of eq. 8 and 19 of [2]_."""


@dataclass(frozen=True, slots=True)
class TriadProblem:
    """N = K E w + n0 against one known norm: L_a and L_g of [2]_ eq. 7, in the vector [K, E, n0] of eq. 8.

    Attributes
    ----------
    raw : ndarray, shape (m, 3)
        Mean outputs at rest.
    reference : float
        Gravity, or the Earth's rate; any unit, K follows.
    lower, upper : ndarray, shape (12,)
        Bounds, as Tables 1 and 3 of [2]_.
    """

    raw: FloatArray
    reference: float
    lower: FloatArray
    upper: FloatArray

    @property
    def start(self) -> FloatArray:
        """The middle of the bounds."""
        return (self.lower + self.upper) / 2

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Limits, shape (12,) each."""
        return self.lower, self.upper

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 12 entries."""
        return TRIAD_NAMES

    def inputs(self, candidates: FloatArray) -> FloatArray:
        """Return w = (K E)^-1 (N - n0), shape (c, 12) -> (c, 3, m) (eq. 6 of [2]_)."""
        unbiased = self.raw.T - candidates[:, 9:, None]
        unbiased /= candidates[:, :3, None]
        return np.asarray(_inverse(unit_diagonal_matrices(candidates[:, 3:9])) @ unbiased)

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return L of eq. 7 of [2]_ for a population, shape (c, 12) -> (c,)."""
        w = self.inputs(candidates)
        excess = np.einsum("cim,cim->cm", w, w)
        excess -= self.reference**2
        return np.asarray(np.sqrt(np.einsum("cm,cm->c", excess, excess) / (len(self.raw) - 1)))

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return the terms of eq. 7: the sum of their squares is L^2."""
        w = self.inputs(z[None])[0]
        return np.asarray((np.einsum("im,im->m", w, w) - self.reference**2) / np.sqrt(len(self.raw) - 1))

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the derivative of ``residuals``, shape (m, 12)."""
        w = self.inputs(z[None])[0].T
        KE = z[:3, None] * unit_diagonal_matrices(z[None, 3:9])[0]
        v = w @ np.linalg.inv(KE)  # d |w|^2 / dN = 2 w^T (K E)^-1
        rows, columns = np.divmod(_OFF_DIAGONAL, 3)
        scale = v * (w @ KE.T / z[:3])
        jacobian = -2 * np.hstack([scale, v[:, rows] * z[rows] * w[:, columns], v])
        return np.asarray(jacobian / np.sqrt(len(self.raw) - 1))


@dataclass(frozen=True, slots=True)
class TurnsProblem:
    """K E from J pairs of opposite turns, in the vector [K, E], shape (9,).

    Attributes
    ----------
    difference : ndarray, shape (J, 3)
        N+ - N- of each pair.
    rate : ndarray, shape (J, 3)
        Rate of the positive turn in the body frame.
    lower, upper : ndarray, shape (9,)
    form : {"norm", "vector"}
        Eq. 26 as printed, or the vector form of eq. 25 of [2]_.
    unit : float
    """

    difference: FloatArray
    rate: FloatArray
    lower: FloatArray
    upper: FloatArray
    form: Literal["norm", "vector"] = "vector"
    unit: float = 1.0
    """Raw units in which the cost is expressed: with the nominal K it is in (deg/s)^2 or deg/s where rates are in deg/s.
    Eq. 17 of [2]_ is not free of units, so a cost in squared pulses would keep its mutation factor up."""

    @property
    def start(self) -> FloatArray:
        """The middle of the bounds."""
        return (self.lower + self.upper) / 2

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Limits, shape (9,) each."""
        return self.lower, self.upper

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 9 entries."""
        return TRIAD_NAMES[:9]

    def _terms(self, candidates: FloatArray) -> FloatArray:
        turned = self.rate @ np.swapaxes(unit_diagonal_matrices(candidates[:, 3:]), 1, 2) * candidates[:, None, :3]
        J = len(self.rate)
        if self.form == "norm":
            excess = (self.difference**2).sum(axis=1) - 4 * np.einsum("cji,cji->cj", turned, turned)
            return np.asarray(excess / (self.unit**2 * np.sqrt(J - 1)))
        terms = (self.difference / 2 - turned) / (self.unit * np.sqrt(max(3 * J - 9, 1)))
        return np.asarray(terms.reshape(len(candidates), -1))

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return L_gm (eq. 26 of [2]_) or L_gv of a population, shape (c, 9) -> (c,)."""
        terms = self._terms(candidates)
        return np.asarray(np.sqrt(np.einsum("cj,cj->c", terms, terms)))

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return the terms of the cost: the sum of their squares is its square."""
        return np.asarray(self._terms(z[None])[0])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the derivative of ``residuals``, shape (J or 3 J, 9)."""
        J = len(self.rate)
        turned = self.rate @ unit_diagonal_matrices(z[None, 3:])[0].T
        rows, columns = np.divmod(_OFF_DIAGONAL, 3)
        derivative = np.zeros((J, 3, 9))  # of K E w
        derivative[:, range(3), range(3)] = turned
        derivative[:, rows, range(3, 9)] = z[rows] * self.rate[:, columns]
        if self.form == "norm":
            KEw = turned * z[:3]
            return np.asarray(-8 * np.einsum("ji,jik->jk", KEw, derivative) / (self.unit**2 * np.sqrt(J - 1)))
        return np.asarray(-derivative.reshape(3 * J, 9) / (self.unit * np.sqrt(max(3 * J - 9, 1))))
