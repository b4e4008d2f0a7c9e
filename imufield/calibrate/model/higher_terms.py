"""Terms of an accelerometer beyond the quadratic one: cubic terms, and cross terms of two axes.

The g-sensitivity of a gyroscope is in ``models``; ``gyroscope.model_choice`` decides whether it is fitted.

With ``s = T a`` an axis feels ``f = s + h(s)``; the model goes on from ``f`` in place of ``s``: ``N = K (f + b) + K2 f**2``.

    h_i(s) = cubic_i s_i^3 + sum_p cross_pi q_p,    q = (s_x s_y, s_x s_z, s_y s_z)        [1]_

A turn of the body frame changes ``s`` to ``D^-1 s`` (``observability``), so ``cubic' = cubic D^2``; for the product of the
axes j and k on axis i, ``cross' = cross D_j D_k / D_i``.

At rest axis i adds its share ``u_i h_i`` to the norm, u being the direction of up. On the unit sphere that is ``u_i^4`` for the
three cubic terms. Beside bias (``u_i``) and K2 (``u_i^3``) the nine cross terms make four functions more: ``u_x u_y u_z``, of
three of them, and three differences such as ``u_x^2 u_y - u_z^2 u_y``; the sums are ``u_y - u_y^3``. So the norm shows no cross
term of one axis by itself. Fitted is the part that it shows, with the least sum of squares: ``u_x u_y u_z`` on three axes
alike, a difference as +c and -c. The rest is zero in the parameters; in their uncertainty it is as is typical (``aliasing``).

References
----------
.. [1] IEEE Std 1293-2018, "Specification format guide and test procedure for linear single-axis nongyroscopic accelerometers":
   the model equation, with its cubic and cross-coupling coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imufield.dataclass import dataclass
from imufield.samples import FloatArray

TERMS = 12
"""Three cubic terms, then the products xy, xz, yz on the axes x, y, z each."""
KINDS = (slice(0, 3), slice(3, TERMS))
"""Cubic terms, cross terms."""
_CUBIC, _CROSS = KINDS
_J = (0, 0, 1)
_K = (1, 2, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class HigherTerms:
    """Cubic and cross terms, or their 1 sigma."""

    cubic: FloatArray
    """Of each sensing axis, shape (3,), m/s^2 per (m/s^2)^3."""
    cross: FloatArray
    """Rows are the products xy, xz, yz, columns the sensing axes, shape (3, 3), m/s^2 per (m/s^2)^2."""

    @classmethod
    def from_vector(cls, vector: FloatArray) -> HigherTerms:
        """Return the terms of a vector, shape (12,)."""
        return cls(cubic=vector[_CUBIC].copy(), cross=vector[_CROSS].reshape(3, 3).copy())

    def to_vector(self) -> FloatArray:
        """Return them as a vector, shape (12,)."""
        return np.concatenate([self.cubic, self.cross.ravel()])

    def of(self, s: FloatArray) -> FloatArray:
        """Return h(s), both in m/s^2 and of shape (..., 3)."""
        return np.asarray(self.cubic * s**3 + (s[..., _J] * s[..., _K]) @ self.cross)

    def slope(self, s: FloatArray) -> FloatArray:
        """Return dh / ds, shape (m, 3) to (m, 3, 3)."""
        by_product = np.zeros((len(s), 3, 3))
        by_product[:, (0, 1, 2), _J] = s[:, _K]
        by_product[:, (0, 1, 2), _K] = s[:, _J]
        return np.asarray(self.cross.T @ by_product + (3 * self.cubic * s**2)[:, None, :] * np.eye(3))

    def turned(self, D: FloatArray) -> HigherTerms:
        """Return the terms for inputs s' = s / D, shape (3,)."""
        return HigherTerms(cubic=self.cubic * D**2, cross=self.cross * (D[[*_J]] * D[[*_K]])[:, None] / D)


def higher_columns(gradient: FloatArray, s: FloatArray) -> FloatArray:
    """Return d norm / d term for given d norm / d f of each axis, shape (m, 3) both, to (m, 12)."""
    products = s[:, _J] * s[:, _K]
    return np.hstack([gradient * s**3, *(gradient * product[:, None] for product in products.T)])


def higher_scale(gravity_m_s2: float) -> FloatArray:
    """Return the step of each term that weighs as 1 m/s^2 at 1 g, shape (12,)."""
    return np.repeat([gravity_m_s2**-3, gravity_m_s2**-2], [3, TERMS - 3])


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownTerms:
    """What positions show of the higher terms beside the parameters of a model, k combinations."""

    combinations: FloatArray
    """Orthonormal columns, in steps of ``higher_scale``, shape (12, k)."""
    span: FloatArray
    """What the model and then each of them adds to the norms over their sigmas, orthonormal, shape (m, n + k)."""
    lengths: FloatArray
    """Of what a step of each adds, shape (k,)."""

    @property
    def columns(self) -> FloatArray:
        """What each adds and nothing else does, shape (m, k)."""
        return self.span[:, self.span.shape[1] - len(self.lengths) :]

    @property
    def spare(self) -> int:
        """Positions that are left over."""
        return len(self.span) - len(self.span.T)

    @property
    def leverage(self) -> float:
        """Of the position that they follow most."""
        return float(np.sum(self.span**2, axis=1).max())

    @property
    def counts(self) -> tuple[int, int]:
        """How many are cubic, and how many cross terms."""
        cubic = int(np.count_nonzero(self.combinations[_CUBIC].any(axis=0)))
        return cubic, self.combinations.shape[1] - cubic


def shown_terms(
    jacobian: FloatArray, up: FloatArray, sigma: FloatArray, *, least: float, kinds: Sequence[slice] = KINDS
) -> ShownTerms:
    """Return what positions show of kinds of terms, each beside those before it.

    Parameters
    ----------
    jacobian : ndarray, shape (m, n)
        Of the norms by what is fitted beside them.
    up : ndarray, shape (m, 3)
        Unit vectors.
    sigma : ndarray, shape (m,)
        Of the norms, m/s^2.
    least : float
        Length of the shortest column of its own that counts, at equal sigmas.
    kinds : sequence of slice
        Of ``KINDS``.
    """
    own = np.linalg.qr(jacobian / sigma[:, None])[0]
    every = higher_columns(up, up) / sigma[:, None]
    shortest = least / np.sqrt(np.mean(sigma**2))
    combinations, lengths = np.zeros((TERMS, 0)), np.zeros(0)
    for kind in kinds:
        rest = every[:, kind] - own @ (own.T @ every[:, kind])
        left, size, right = np.linalg.svd(rest, full_matrices=False)
        kept = size > shortest
        placed = np.zeros((TERMS, int(kept.sum())))
        placed[kind] = right[kept].T
        own, combinations, lengths = (
            np.hstack(each) for each in ((own, left[:, kept]), (combinations, placed), (lengths, size[kept]))
        )
    return ShownTerms(combinations=combinations, span=own, lengths=lengths)
