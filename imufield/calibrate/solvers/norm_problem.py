"""Cost functions of the norm of the specific force over whole populations, and the problem that solvers work on.

With ``n_i = norm(a_i)`` of position i, ``g`` the gravity and ``s_i`` the sigma of ``n_i``::

    absolute   sum |n_i - g|                            m/s^2         [1]_ eq. 13
    squares    sqrt(sum (g^2 - n_i^2)^2 / (M - 1))      (m/s^2)^2     [2]_ eq. 7 and 10
    weighted   sum ((n_i - g) / s_i)^2                  1

Derivatives of the norm by the parameters are those of ``models.norm_derivatives``; here they are carried to z.

Coordinates: ``parameters = origin + basis z``. The basis keeps the gauge and the parameters that are not fitted, and scales
each coordinate to m/s^2 at 1 g, so that a step of one size means the same in all of them.

Swarms ask for thousands of costs and get them in one call with no iteration that can be avoided: the inverse of the printed
form ([1]_ eq. 14) starts from ``T^-1 (N / K - b)`` and takes a fixed number of passes; only the candidates that still move then
take the slow, safe way of ``models.recover_vectors``.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020.
.. [2] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imufield.calibrate.model.higher_terms import HigherTerms
from imufield.calibrate.model.models import (
    BIAS,
    QUADRATIC,
    SCALE,
    NormDerivatives,
    alignment_matrix,
    norm_derivatives,
    recover_vectors,
    sensing_input,
)
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, QuadraticAxes
from imufield.calibrate.solvers.triad_costs import inverse_matrices
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

CostName = Literal["absolute", "squares", "weighted"]

_PASSES = 4  # Passes of eq. 14 that reach 2e-15 for navigation-grade parameters.
_MORE_PASSES = 6  # Passes more that settle the wild candidates of the first rounds without the safe way.
_MOVING = 1e-12  # Relative change in the last pass above which a candidate is inverted with care.


@dataclass(frozen=True, slots=True, kw_only=True)
class Coordinates:
    """The coordinates of a problem: ``parameters = origin + basis z``.

    Attributes
    ----------
    origin : ndarray, shape (k,)
        Parameters at the start.
    basis : ndarray, shape (k, n)
    reach : float
        Bounds of every coordinate: minus and plus this.
    """

    origin: FloatArray
    basis: FloatArray
    reach: float = np.inf

    @property
    def start(self) -> FloatArray:
        """The origin, shape (n,)."""
        return np.zeros(self.basis.shape[1])

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Limits of the coordinates, shape (n,) each."""
        reach = np.full(self.basis.shape[1], self.reach)
        return -reach, reach


@dataclass(frozen=True, slots=True, kw_only=True)
class NormProblem(Coordinates):
    """The norms of m positions as a function of n coordinates (satisfies ``solvers.base.Problem``).

    Attributes
    ----------
    raw : ndarray, shape (m, 3)
        Zeroed mean outputs.
    gravity_m_s2 : float
    sigma_m_s2 : ndarray, shape (m,)
    quadratic_axes : {"sensing", "body"}
    cost_name : {"absolute", "squares", "weighted"}
    drift : ndarray, shape (m, k), optional
        The last 3 k coordinates are a drift of the bias, m/s^2: each column times a vector of three axes. Least squares only.
    higher : ndarray, shape (12, k), optional
        The last k coordinates are combinations of higher terms. Least squares only, and not with a drift.
    """

    raw: FloatArray
    gravity_m_s2: float
    sigma_m_s2: FloatArray
    quadratic_axes: QuadraticAxes = "sensing"
    cost_name: CostName = "weighted"
    drift: FloatArray | None = None
    higher: FloatArray | None = None

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
        # In place: a population of 60 at 24 positions is asked for 72 000 times.
        vectors = self.vector(candidates)
        with np.errstate(all="ignore"):
            inverse = inverse_matrices(alignment_matrix(vectors))
            # Its rows beside each other in memory: NumPy's loops along them are long.
            raw = np.ascontiguousarray(self.raw.T)
            K, b, K2 = (vectors[:, part, None] for part in (SCALE, BIAS, QUADRATIC))
            if self.quadratic_axes == "sensing":
                a = inverse @ sensing_input(raw, K, b, K2)
            else:
                a = self._body_input(vectors, inverse @ (raw / K - b), inverse)
            squares = np.einsum("cim,cim->cm", a, a)
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
        # A candidate without a specific force must lose every comparison; NaN would lose none.
        cost[~np.isfinite(cost)] = np.inf
        return cost

    def _body_input(self, vectors: FloatArray, linear: FloatArray, inverse: FloatArray) -> FloatArray:
        # eq. 14 of [1]_: a = T^-1 (N / K - b) - T^-1 (K2 / K) a^2
        curved = inverse * (vectors[:, QUADRATIC] / vectors[:, SCALE])[:, None, :]
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

    def bias_drift(self, z: FloatArray) -> FloatArray:
        """Return the drift of the bias at each position, shape (n,) -> (m, 3)."""
        if self.drift is None:
            return np.zeros_like(self.raw)
        columns = self.drift.shape[1]
        return np.asarray(self.drift @ z[-3 * columns :].reshape(columns, 3))

    def _steady_raw(self, z: FloatArray, vector: FloatArray) -> FloatArray:
        """Return the outputs without the drift."""
        return self.raw if self.drift is None else self.raw - vector[SCALE] * self.bias_drift(z)

    def higher_terms(self, z: FloatArray) -> HigherTerms | None:
        """Return the higher terms of coordinates, shape (n,)."""
        if self.higher is None:
            return None
        return HigherTerms.from_vector(self.higher @ z[-self.higher.shape[1] :])

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return what least squares minimises for this cost, shape (m,)."""
        vector = self.vector(z)
        a = recover_vectors(vector, self._steady_raw(z, vector), self.quadratic_axes, self.higher_terms(z))
        # Levenberg-Marquardt squares and adds: the root of eq. 7 has the same minimum.
        norm = np.linalg.norm(a, axis=-1)
        if self.cost_name == "squares":
            return np.asarray((norm**2 - self.gravity_m_s2**2) / np.sqrt(len(norm) - 1))
        return np.asarray((norm - self.gravity_m_s2) / self.sigma_m_s2)

    def derivatives(self, z: FloatArray) -> tuple[NormDerivatives, FloatArray]:
        """Return norm(a) at all positions, and its derivative by the coordinates, shape (m, n)."""
        vector = self.vector(z)
        derivatives = norm_derivatives(vector, self._steady_raw(z, vector), self.quadratic_axes, self.higher_terms(z))
        by_parameters = derivatives.jacobian
        if self.higher is not None:
            jacobian = by_parameters @ self.basis
            jacobian[:, -self.higher.shape[1] :] = derivatives.by_higher @ self.higher
            return derivatives, jacobian
        if self.drift is None:
            return derivatives, by_parameters @ self.basis
        # N = K (s + b + drift): the drift moves the norm as the bias does, and the scale acts on it too.
        by_bias = by_parameters[:, BIAS]
        by_parameters[:, SCALE] -= derivatives.raw_gradient * self.bias_drift(z)
        jacobian = by_parameters @ self.basis
        by_drift = self.drift[:, :, None] * by_bias[:, None, :]
        jacobian[:, -3 * self.drift.shape[1] :] = by_drift.reshape(len(jacobian), -1)
        return derivatives, jacobian

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the derivative of ``residuals``, shape (m, n)."""
        derivatives, jacobian = self.derivatives(z)
        if self.cost_name == "squares":
            return np.asarray(jacobian * (2 * derivatives.norm / np.sqrt(len(jacobian) - 1))[:, None])  # d n^2 = 2 n d n
        return np.asarray(jacobian / self.sigma_m_s2[:, None])
