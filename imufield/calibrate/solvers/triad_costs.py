"""The cost functions of [1]_ over whole populations: a linear triad against one known norm, and turns on a turntable.

``TriadProblem`` is ``N = K E w + n0`` (eq. 1 and 3) in the paper's own vector (eq. 8 and 19), for the accelerometer (L_a,
eq. 7) and the gyroscope at rest (L_g, eq. 7).

``TurnsProblem`` is the gyroscope on a turntable. With ``N+`` and ``N-`` the mean outputs of a turn by ``w`` and by ``-w``::

    norm form     L_gm = sqrt(sum (|N+ - N-|^2 - |K E 2 w|^2)^2 / (J - 1))                    eq. 26
    vector form   L_gv = sqrt(sum |(N+ - N-) / 2 - K E w|^2 / (3 J - 9))                     from eq. 25

For turns about the sensor axes the norm form holds nothing but the three column norms of ``K E``: rank 3 of 9. Every turn of
the vector form gives three numbers, and three axes give all nine entries.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from imufield.calibrate.model.models import MISALIGNMENT_COLUMNS, MISALIGNMENT_ROWS, unit_diagonal_matrices
from imufield.calibrate.model.result import MISALIGNMENTS, names_of
from imufield.dataclass import dataclass
from imufield.samples import AXES, FloatArray


def inverse_matrices(T: FloatArray) -> FloatArray:
    """Return inverses, shape (c, 3, 3); NaN for the singular matrices a wild step may propose."""
    try:
        return np.asarray(np.linalg.inv(T), dtype=np.float64)
    except np.linalg.LinAlgError:  # LAPACK refuses the whole population for one of them
        T[np.linalg.det(T) == 0] = np.nan
        return np.asarray(np.linalg.inv(T), dtype=np.float64)


TRIAD_NAMES = names_of("{}.{}", K=AXES, E=MISALIGNMENTS, n0=AXES)
"""The vector of eq. 8 and 19 of [1]_."""


class _Bounded:
    """What both problems have: n first entries of the triad's vector, each between two bounds."""

    __slots__ = ()
    lower: FloatArray
    upper: FloatArray

    @property
    def start(self) -> FloatArray:
        """The middle of the bounds, shape (n,)."""
        return (self.lower + self.upper) / 2

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Limits, shape (n,) each."""
        return self.lower, self.upper

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the n entries."""
        return TRIAD_NAMES[: len(self.lower)]


@dataclass(frozen=True, slots=True)
class TriadProblem(_Bounded):
    """N = K E w + n0 against one known norm: L_a and L_g of [1]_ eq. 7, in the vector [K, E, n0] of eq. 8.

    Attributes
    ----------
    raw : ndarray, shape (m, 3)
        Mean outputs at rest.
    reference : float
        Gravity, or the Earth's rate; any unit, K follows.
    lower, upper : ndarray, shape (12,)
        Bounds, as Tables 1 and 3 of [1]_.
    """

    raw: FloatArray
    reference: float
    lower: FloatArray
    upper: FloatArray

    def inputs(self, candidates: FloatArray) -> FloatArray:
        """Return w = (K E)^-1 (N - n0), shape (c, 12) -> (c, 3, m) (eq. 6 of [1]_)."""
        # eq. 6: w = (K E)^-1 (N - n0), all candidates in one call
        unbiased = np.ascontiguousarray(self.raw.T) - candidates[:, 9:, None]
        unbiased /= candidates[:, :3, None]
        return np.asarray(inverse_matrices(unit_diagonal_matrices(candidates[:, 3:9])) @ unbiased)

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return L of eq. 7 of [1]_ for a population, shape (c, 12) -> (c,)."""
        w = self.inputs(candidates)
        excess = np.einsum("cim,cim->cm", w, w)
        excess -= self.reference**2  # eq. 7
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
        rows, columns = MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS
        # d (K E w) / dK is E w, d (K E w) / dE_ij is K_i w_j
        scale = v * (w @ KE.T / z[:3])
        jacobian = -2 * np.hstack([scale, v[:, rows] * z[rows] * w[:, columns], v])
        return np.asarray(jacobian / np.sqrt(len(self.raw) - 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnsProblem(_Bounded):
    """K E from J pairs of opposite turns, in the vector [K, E], shape (9,).

    Attributes
    ----------
    difference : ndarray, shape (J, 3)
        N+ - N- of each pair.
    rate : ndarray, shape (J, 3)
        Rate of the positive turn in the body frame.
    lower, upper : ndarray, shape (9,)
    form : {"norm", "vector"}
        Eq. 26 as printed, or the vector form of eq. 25 of [1]_.
    unit : float
    """

    difference: FloatArray
    rate: FloatArray
    lower: FloatArray
    upper: FloatArray
    form: Literal["norm", "vector"] = "vector"
    unit: float = 1.0
    """Raw units in which the cost is expressed: with the nominal K it is in (deg/s)^2 or deg/s where rates are in deg/s.
    Eq. 17 of [1]_ is not free of units, so a cost in squared pulses would keep its mutation factor up."""

    def _terms(self, candidates: FloatArray) -> FloatArray:
        turned = self.rate @ np.swapaxes(unit_diagonal_matrices(candidates[:, 3:]), 1, 2) * candidates[:, None, :3]
        J = len(self.rate)
        if self.form == "norm":
            excess = (self.difference**2).sum(axis=1) - 4 * np.einsum("cji,cji->cj", turned, turned)  # eq. 26
            return np.asarray(excess / (self.unit**2 * np.sqrt(J - 1)))
        terms = (self.difference / 2 - turned) / (self.unit * np.sqrt(max(3 * J - 9, 1)))  # eq. 25, as vectors
        return np.asarray(terms.reshape(len(candidates), -1))

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return L_gm (eq. 26 of [1]_) or L_gv of a population, shape (c, 9) -> (c,)."""
        terms = self._terms(candidates)
        return np.asarray(np.sqrt(np.einsum("cj,cj->c", terms, terms)))

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return the terms of the cost: the sum of their squares is its square."""
        return np.asarray(self._terms(z[None])[0])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the derivative of ``residuals``, shape (J or 3 J, 9)."""
        J = len(self.rate)
        turned = self.rate @ unit_diagonal_matrices(z[None, 3:])[0].T
        rows, columns = MISALIGNMENT_ROWS, MISALIGNMENT_COLUMNS
        derivative = np.zeros((J, 3, 9))  # of K E w
        derivative[:, range(3), range(3)] = turned  # by K
        derivative[:, rows, range(3, 9)] = z[rows] * self.rate[:, columns]  # by E
        if self.form == "norm":
            # d |K E 2 w|^2 = 8 (K E w) . d (K E w)
            KEw = turned * z[:3]
            return np.asarray(-8 * np.einsum("ji,jik->jk", KEw, derivative) / (self.unit**2 * np.sqrt(J - 1)))
        return np.asarray(-derivative.reshape(3 * J, 9) / (self.unit * np.sqrt(max(3 * J - 9, 1))))
