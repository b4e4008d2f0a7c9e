"""Cost functions of the norm of the specific force, and the problem that solvers work on.

With ``n_i = norm(a_i)`` of position i, ``g`` the gravity and ``s_i`` the sigma of ``n_i``::

    absolute   sum |n_i - g|                            m/s^2         [1]_ eq. 13
    squares    sqrt(sum (g^2 - n_i^2)^2 / (M - 1))      (m/s^2)^2     [2]_ eq. 7 and 10
    weighted   sum ((n_i - g) / s_i)^2                  1

Coordinates: ``parameters = origin + basis z``. The basis keeps the gauge and the parameters that are not fitted, and scales
each coordinate to m/s^2 at 1 g, so that a step of one size means the same in all of them.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020.
.. [2] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from imufield.calibrate.models import norm_derivatives, recover_vectors
from imufield.calibrate.result import QuadraticAxes
from imufield.samples import FloatArray

CostName = Literal["absolute", "squares", "weighted"]
Cost = Callable[[FloatArray, float, FloatArray], FloatArray]


def absolute_cost(norms: FloatArray, gravity_m_s2: float, sigma: FloatArray) -> FloatArray:  # noqa: ARG001 (one signature)
    """Return sum |n - g|, shape (..., m) -> (...)."""
    cost: FloatArray = np.abs(norms - gravity_m_s2).sum(axis=-1)
    return cost


def squares_cost(norms: FloatArray, gravity_m_s2: float, sigma: FloatArray) -> FloatArray:  # noqa: ARG001 (one signature)
    """Return sqrt(sum (g^2 - n^2)^2 / (M - 1)), shape (..., m) -> (...)."""
    cost: FloatArray = np.sqrt(((gravity_m_s2**2 - norms**2) ** 2).sum(axis=-1) / (norms.shape[-1] - 1))
    return cost


def weighted_cost(norms: FloatArray, gravity_m_s2: float, sigma: FloatArray) -> FloatArray:
    """Return sum ((n - g) / s)^2, shape (..., m) -> (...)."""
    cost: FloatArray = (((norms - gravity_m_s2) / sigma) ** 2).sum(axis=-1)
    return cost


COSTS: Mapping[CostName, Cost] = MappingProxyType(
    {"absolute": absolute_cost, "squares": squares_cost, "weighted": weighted_cost}
)


@dataclass(frozen=True, slots=True)
class NormProblem:
    """The norms of m positions as a function of n coordinates (satisfies ``solvers.base.Problem``).

    Attributes
    ----------
    raw : ndarray, shape (m, 3)
        Zeroed mean outputs.
    gravity_m_s2 : float
    sigma_m_s2 : ndarray, shape (m,)
        1 sigma of the norm at each position.
    origin : ndarray, shape (15,)
    basis : ndarray, shape (15, n)
    quadratic_axes : {"sensing", "body"}
    cost_name : {"absolute", "squares", "weighted"}
    reach_m_s2 : float
        Bounds of every coordinate: minus and plus this.
    """

    raw: FloatArray
    gravity_m_s2: float
    sigma_m_s2: FloatArray
    origin: FloatArray
    basis: FloatArray
    quadratic_axes: QuadraticAxes = "sensing"
    cost_name: CostName = "weighted"
    reach_m_s2: float = np.inf

    @property
    def start(self) -> FloatArray:
        """The origin, shape (n,)."""
        return np.zeros(self.basis.shape[1])

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Limits of the coordinates, shape (n,) each."""
        reach = np.full(self.basis.shape[1], self.reach_m_s2)
        return -reach, reach

    def vector(self, z: FloatArray) -> FloatArray:
        """Return parameters of coordinates, shape (..., n) -> (..., 15)."""
        vector: FloatArray = self.origin + z @ self.basis.T
        return vector

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return the cost of a population, shape (c, n) -> (c,); inf where the model cannot be inverted."""
        norms = np.linalg.norm(recover_vectors(self.vector(candidates), self.raw, self.quadratic_axes), axis=-1)
        cost = COSTS[self.cost_name](norms, self.gravity_m_s2, self.sigma_m_s2)
        return np.where(np.isfinite(cost), cost, np.inf)

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return (n - g) / s, shape (m,)."""
        a = recover_vectors(self.vector(z), self.raw, self.quadratic_axes)
        residuals: FloatArray = (np.linalg.norm(a, axis=-1) - self.gravity_m_s2) / self.sigma_m_s2
        return residuals

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the derivative of ``residuals``, shape (m, n)."""
        derivatives = norm_derivatives(self.vector(z), self.raw, self.quadratic_axes)
        jacobian: FloatArray = (derivatives.jacobian @ self.basis) / self.sigma_m_s2[:, None]
        return jacobian
