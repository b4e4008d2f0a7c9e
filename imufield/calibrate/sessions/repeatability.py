"""How much numbers of one kind change from session to session: estimate, interval, and what a new day will bring.

The numbers ``y`` (m,) of the sessions, of one kind on several axes, are

    y = M mu + delta + e,    delta ~ N(0, s^2 I),    e ~ N(0, C)

with the axis of each in ``M`` (m, a) and a known ``C``. One variance stands for all axes of a triad: three sessions of one axis
would leave its deviation open by a factor of 0.5 to 6, pooled it is 0.64 to 2.2. With an orthonormal basis ``L`` of what ``M``
leaves and ``L^T C L = U diag(l) U^T`` the contrasts ``u = U^T L^T y`` are independent,

    u_j ~ N(0, s^2 + l_j),    j = 1 ... n = m - a

and hold all that ``y`` says of ``s``. Restricted maximum likelihood is that of ``u``. ``Q(s) = sum u_j^2 / (s^2 + l_j)`` falls
with ``s`` and is chi squared with ``n`` degrees of freedom at the true one: where it passes the quantiles is an exact interval
(Q-profile [1]_), which may begin, or end, at zero.

A new day is ``mu + delta'``. With ``s`` known it is normal with the variance ``v(s) + s^2`` about ``mu(s)``; it is averaged
over ``s`` with the likelihood of ``u`` and a prior that is flat where sessions are many. Where they are few, a flat one would
leave the largest ``s`` almost open, and the prior is half a Cauchy distribution [2]_ with what is typical of the instrument's
grade as its scale: flat below, falling beyond. An estimate of zero is thus never taken for a variance of zero.

References
----------
.. [1] W. Viechtbauer, "Confidence intervals for the amount of heterogeneity in meta-analysis", Statistics in Medicine 26,
   2007.
.. [2] A. Gelman, "Prior distributions for variance parameters in hierarchical models", Bayesian Analysis 1 (2006).
"""

from __future__ import annotations

import math

import numpy as np

from imufield.calibrate.model.coverage_factors import chi_squared_quantile, sigma_of_mixture
from imufield.calibrate.solvers.scoring import cut_at_top
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

_CHANCE = 0.05  # Of 95 % intervals.
_STEPS = 200  # Of the scoring, at most; it takes 5 to 30.
_SETTLED = 1e-9  # Relative change of the variance.
_DECADES = 3.0  # Of the grid of s, to both sides of the size of the contrasts: beyond, 0.1 % of the likelihood is left.
_GRID = 400  # Steps of 3.5 %: the likelihood changes by a factor of 2 in some twenty.
_HALVINGS = 50  # Of an interval that is 1e7 times the smallest deviation.


@dataclass(frozen=True, slots=True, kw_only=True)
class Contrasts:
    """What the sessions say of one kind of numbers, m of them on a axes, n = m - a contrasts."""

    y: FloatArray
    """The numbers, shape (m,)."""
    axes: FloatArray
    """M, shape (m, a)."""
    covariance: FloatArray
    """C, shape (m, m)."""
    u: FloatArray
    """Shape (n,)."""
    own_variance: FloatArray
    """l, shape (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeatability:
    """Deviation from session to session, 1 sigma."""

    sigma: float
    low: float
    """Of the 95 % interval."""
    high: float
    freedom: int
    """n, the number of contrasts."""


@dataclass(frozen=True, slots=True)
class Sigmas:
    """About the estimate, shape (a,): their 1.96-fold is the 95 % half width."""

    mean: FloatArray
    """Of the mean over all days."""
    day: FloatArray
    """Of a day that was not measured."""


def contrasts(y: FloatArray, axes: FloatArray, covariance: FloatArray) -> Contrasts:
    """Return the contrasts of numbers (m,) on axes M (m, a) with the covariance C (m, m)."""
    basis = np.linalg.qr(axes, mode="complete")[0][:, axes.shape[1] :]
    own_variance, vectors = np.linalg.eigh(basis.T @ covariance @ basis)
    return Contrasts(
        y=y,
        axes=axes,
        covariance=covariance,
        u=np.asarray(vectors.T @ (basis.T @ y)),
        own_variance=np.maximum(own_variance, np.finfo(np.float64).tiny),
    )


def reml_variance(found: Contrasts) -> float:
    """Return s^2 of the largest restricted likelihood, zero where the contrasts scatter no more than their own errors."""
    squares, own = found.u**2, found.own_variance
    variance = float(np.mean(squares))
    for _ in range(_STEPS):
        # Fisher scoring: towards the weighted mean of u^2 - l with the information on s^2 as weights.
        weight = (variance + own) ** -2.0
        expected, observed = float(np.sum(weight)), float(np.sum(weight * (2 * squares / (variance + own) - 1)))
        score = np.array([np.sum(weight * (squares - own - variance))])
        step = cut_at_top(score / expected, score, np.array([[observed]]))
        before, variance = variance, max(variance + float(step[0]), 0.0)
        if abs(variance - before) <= _SETTLED * (variance + float(own.min())):
            break
    return variance


def repeatability(found: Contrasts) -> Repeatability:
    """Return the deviation from session to session with its 95 % interval."""
    n = len(found.u)
    low, high = (_where_q_is(found, chi_squared_quantile(n, p)) for p in (1 - _CHANCE / 2, _CHANCE / 2))
    return Repeatability(sigma=math.sqrt(reml_variance(found)), low=low, high=high, freedom=n)


def _where_q_is(found: Contrasts, limit: float) -> float:
    """Return s with Q(s) = limit; 0 where Q is below it from the start."""
    squares, own = found.u**2, found.own_variance
    if float(np.sum(squares / own)) <= limit:
        return 0.0
    # Q(s) < sum u^2 / s^2.
    low, high = 0.0, float(np.sum(squares)) / limit
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if float(np.sum(squares / (middle + own))) > limit else (low, middle)
    return math.sqrt(high)


def sigmas(found: Contrasts, prior_scale: float, estimate: FloatArray) -> Sigmas:
    """Return the sigmas of mean and new day about an estimate of mu, shape (a,).

    Parameters
    ----------
    found : Contrasts
    prior_scale : float
        Of the half Cauchy distribution; infinite for a flat prior.
    estimate : ndarray, shape (a,)
    """
    squares, own = found.u**2, found.own_variance
    size = math.sqrt(float(np.mean(squares + own)))
    s = size * np.logspace(-_DECADES, _DECADES, _GRID)
    total = s[:, None] ** 2 + own
    # The factor s: the grid is one of log s.
    log_weight = -0.5 * np.sum(np.log(total) + squares / total, axis=1) + np.log(s) - np.log1p((s / prior_scale) ** 2)
    weight = np.exp(log_weight - log_weight.max())
    values, vectors = np.linalg.eigh(found.covariance)
    rows = vectors.T @ found.axes
    gain = 1 / (s[:, None] ** 2 + np.maximum(values, 0.0))
    # v(s) = (M^T (s^2 + C)^-1 M)^-1, mu(s) = v(s) M^T (s^2 + C)^-1 y
    mean_covariance = np.linalg.inv(np.einsum("jm,ma,mb->jab", gain, rows, rows))
    mean = np.einsum("jab,jm,mb,m->ja", mean_covariance, gain, rows, vectors.T @ found.y)
    variance = np.diagonal(mean_covariance, axis1=1, axis2=2)
    offset, weight = mean - estimate, weight / weight.sum()
    return Sigmas(
        mean=sigma_of_mixture(weight, offset, np.sqrt(variance)),
        day=sigma_of_mixture(weight, offset, np.sqrt(variance + s[:, None] ** 2)),
    )


def studentised(found: Contrasts, variance: float) -> FloatArray:
    """Return by how many of its sigmas each number is off what the others predict, externally studentised, shape (m,).

    With V = s^2 + C and P = V^-1 - V^-1 M (M^T V^-1 M)^-1 M^T V^-1 the prediction of number j without it misses by
    (P y)_j / P_jj, the variance of which is 1 / P_jj. The deviation that is estimated has that number in it: taken out as of a
    sum of n squares.
    """
    inverse = np.linalg.inv(variance * np.eye(len(found.y)) + found.covariance)
    across = inverse @ found.axes
    P = inverse - across @ np.linalg.solve(found.axes.T @ across, across.T)
    n = len(found.u)
    internal = (P @ found.y) / np.sqrt(np.diag(P))
    return np.asarray(internal * np.sqrt((n - 1) / np.maximum(n - internal**2, np.finfo(np.float64).tiny)))
