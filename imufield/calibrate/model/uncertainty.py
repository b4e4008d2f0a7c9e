"""How sure the parameters are: weights, scatter between positions; covariances of parts and wholes.

The covariance of the parameters is made of these in ``accelerometer.covariance`` and in ``gyroscope.fit``.
The factors from a standard uncertainty to 95 % are those of ``coverage_factors``.

The variance of position i is ``s_i^2 = within_i^2 + tau^2``. ``within`` is the covariance of the mean output carried to the
norm; it cannot see flicker noise and drift between holds. ``tau`` is estimated by Mandel and Paule's rule [1]_: the smallest
``tau >= 0`` for which ``sum (r_i / s_i)^2`` of the refitted residuals is not above the degrees of freedom (so it is zero where
the Birge ratio is below one). Without known covariances ``within`` is zero and ``tau`` is the residual's standard deviation.

References
----------
.. [1] R. C. Paule and J. Mandel, "Consensus values and weighting factors", J. Res. NBS 87 (1982).
.. [2] F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics Bulletin 2 (1946).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imufield.calibrate.model.models import BIAS, PARAMETERS, QUADRATIC, SCALE
from imufield.calibrate.model.result import GRAVITY_NAME
from imufield.samples import FloatArray

SPARE_POSITIONS = 4
"""Degrees of freedom below this give Student factors of 3.2 and more, and scatter and jackknife from chance."""

_NO_VARIANCE = 1e-12  # Of a correlation matrix: a direction with less is one that the gauge fixes, and rounding.
_NEWTON_STEPS = 100  # At most; each comes nearer, from below.
_LARGEST_DIRECT_ROWS = 32  # Of a triangle that is inverted as it is.


def rms(values: FloatArray) -> float:
    """Return the root mean square of the finite values; NaN where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def known_covariance(covariance_raw: FloatArray) -> FloatArray | None:
    """Return the covariances of the means, shape (m, 3, 3); None unless all are usable: finite, positive definite."""
    if not np.isfinite(covariance_raw).all():
        return None
    eigenvalues = np.linalg.eigvalsh((covariance_raw + np.swapaxes(covariance_raw, 1, 2)) / 2)
    return covariance_raw if np.all(eigenvalues[:, 0] > 0) else None


def within_variance(raw_gradient: FloatArray, covariance_raw: FloatArray | None) -> FloatArray:
    """Return the variance of each norm from the covariance of its mean output, shape (m,), (m/s^2)^2; 0 where not known."""
    if covariance_raw is None:
        return np.zeros(len(raw_gradient))
    return np.asarray(np.einsum("mi,mij,mj->m", raw_gradient, covariance_raw, raw_gradient))


def between_position_sigma(residual: FloatArray, jacobian: FloatArray, within: FloatArray) -> float:
    """Return tau in the unit of the residual.

    Parameters
    ----------
    residual : ndarray, shape (m,)
        Residuals at any parameters near the solution.
    jacobian : ndarray, shape (m, n)
        Their derivatives, n < m.
    within : ndarray, shape (m,)
        Variance of each position; all zero where it is not known.
    """
    freedom = len(residual) - jacobian.shape[1]
    if freedom < 1:
        return 0.0
    # The residuals may be those of parameters near the solution: each weighting is refitted here, linearly.
    square = float(np.sum(_refitted(residual, jacobian, np.ones(len(residual))) ** 2)) / freedom
    if not np.any(within):
        return float(np.sqrt(square))
    # The excess over the degrees of freedom falls and is convex in tau^2: Newton from below never overshoots.
    tau2 = 0.0
    for _ in range(_NEWTON_STEPS):
        weight = 1 / (within + tau2)
        weighted = _refitted(residual, jacobian, np.sqrt(weight))
        excess = float(np.sum(weighted**2)) - freedom  # [1]_: sum (r / s)^2 may not exceed the degrees of freedom
        if excess <= 1e-9 * freedom:
            break
        tau2 += excess / float(np.sum(weighted**2 * weight))  # d sum (r / s)^2 / d tau^2 = - sum r^2 / s^4
    return float(np.sqrt(tau2))


def _refitted(residual: FloatArray, jacobian: FloatArray, root_weight: FloatArray) -> FloatArray:
    Q = np.linalg.qr(jacobian * root_weight[:, None])[0]
    weighted = residual * root_weight
    return np.asarray(weighted - Q @ (Q.T @ weighted))


def without_gravity(names: Sequence[str], covariance: FloatArray) -> FloatArray:
    """Return the covariance of parameters for a known gravity, ``C - c c^T / C_gg``: its error is common to all sessions."""
    if GRAVITY_NAME not in names:
        return covariance
    of_gravity = covariance[names.index(GRAVITY_NAME)]
    variance = of_gravity[names.index(GRAVITY_NAME)]
    return covariance - np.outer(of_gravity, of_gravity) / variance if variance > 0 else covariance


def gravity_sensitivity(vector: FloatArray, gravity_m_s2: float) -> FloatArray:
    """Return d parameters / d g, shape (15,): for the same outputs K goes with 1/g, b with g, K2 with 1/g^2."""
    sensitivity = np.zeros(PARAMETERS)
    sensitivity[SCALE] = -vector[SCALE] / gravity_m_s2
    sensitivity[BIAS] = vector[BIAS] / gravity_m_s2
    sensitivity[QUADRATIC] = -2 * vector[QUADRATIC] / gravity_m_s2
    return sensitivity


def estimated_share(covariance: FloatArray, prior_root: FloatArray) -> float:
    """Return the share of the variance of the parameters that the residuals tell, mean over the parameters.

    Gravity and what is typical are known beforehand, with infinitely many degrees of freedom. By Welch and Satterthwaite's rule
    a sum of variances of which this share has n degrees of freedom has n over its square [2]_.

    Parameters
    ----------
    covariance : ndarray, shape (16, 16)
        Of the parameters and gravity.
    prior_root : ndarray, shape (15, k)
        Root of the part of it that is typical, in columns.
    """
    variance, gravity = np.diag(covariance)[:PARAMETERS], covariance[:PARAMETERS, -1] ** 2 / covariance[-1, -1]
    prior, has_any = np.sum(prior_root**2, axis=1) + gravity, variance > 0
    return float(np.mean(1 - prior[has_any] / variance[has_any])) if has_any.any() else 1.0


def distinguishing_digits(value: float, limit: float) -> tuple[str, str]:
    """Return both with as many decimals, at least one and at most four, as it takes to see which is larger."""
    texts = [(f"{value:.{places}f}", f"{limit:.{places}f}") for places in range(1, 5)]
    return next((pair for pair in texts if pair[0] != pair[1]), texts[-1])


def bounded_cross_covariance(cross: FloatArray, ours: FloatArray, theirs: FloatArray) -> FloatArray:
    """Return the covariance between two groups of parameters, taken back where it is more than those of the groups allow.

    A standard deviation that was raised for what no model holds (a single position, an unfitted term) makes a covariance that
    is propagated from it too large: together with the other group's it would give some combination a variance below zero.
    The canonical correlations of the two groups [1]_ are brought down to 1.

    Parameters
    ----------
    cross : ndarray, shape (n, m)
    ours : ndarray, shape (n, n)
    theirs : ndarray, shape (m, m)

    Returns
    -------
    ndarray, shape (n, m)
        ``cross`` itself where it is possible, or holds NaN for what is not observable.

    References
    ----------
    .. [1] H. Hotelling, "Relations between two sets of variates", Biometrika 28 (1936).
    """
    # No decomposition takes NaN.
    if not np.isfinite(cross).all():
        return cross
    to_theirs, from_theirs = _whitening(theirs)
    to_ours, from_ours = _whitening(ours)
    left, correlation, right = np.linalg.svd(to_ours @ cross @ to_theirs.T, full_matrices=False)
    if np.all(correlation <= 1.0):
        return cross
    return np.asarray(from_ours @ (left * np.minimum(correlation, 1.0)) @ right @ from_theirs.T)


def _whitening(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what makes parameters independent and of variance one, shape (r, n), and the way back, shape (n, r)."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    known = np.flatnonzero(size > 0)
    # As a correlation matrix: parameters differ in unit by ten powers of ten.
    values, vectors = np.linalg.eigh(covariance[np.ix_(known, known)] / np.outer(size[known], size[known]))
    kept = values > _NO_VARIANCE
    root, vectors = np.sqrt(values[kept]), vectors[:, kept]
    there, back = np.zeros((len(root), len(size))), np.zeros((len(size), len(root)))
    there[:, known] = (vectors / root).T / size[known]
    back[known] = size[known][:, None] * vectors * root
    return there, back


def inverse_root(covariance: FloatArray) -> FloatArray:
    """Return L^-1 of S = L L^T, which whitens; raises ``numpy.linalg.LinAlgError`` where S is not positive definite."""
    return _triangle_inverse(np.asarray(np.linalg.cholesky(covariance), dtype=np.float64))


def _triangle_inverse(L: FloatArray) -> FloatArray:
    # By halves: NumPy inverts a triangle as it does every matrix, in about three times the time.
    if len(L) <= _LARGEST_DIRECT_ROWS:
        return np.asarray(np.linalg.inv(L), dtype=np.float64)
    inverse, half = np.zeros_like(L), len(L) // 2
    upper = inverse[:half, :half] = _triangle_inverse(L[:half, :half])
    lower = inverse[half:, half:] = _triangle_inverse(L[half:, half:])
    inverse[half:, :half] = -lower @ (L[half:, :half] @ upper)
    return inverse


def block_diagonal(blocks: FloatArray) -> FloatArray:
    """Return a matrix with these on its diagonal, shape (s, n, m) -> (s n, s m)."""
    s, n, m = blocks.shape
    whole = np.zeros((s, n, s, m))
    whole[range(s), :, range(s)] = blocks
    return whole.reshape(s * n, s * m)
