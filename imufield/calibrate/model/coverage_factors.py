"""The 95 % factors and limits: quantiles of Student's and the F distribution, which every solved session asks a few times.

``accelerometer.quality`` says how many degrees of freedom a calibration has.
SciPy's take longer to load than a session to solve. Both are incomplete beta functions [1]_; what passes a chance is found
between bounds that are halved. Where Student's distribution has many degrees of freedom, its quantile is that of the normal
distribution with the terms of [2]_. Chi squared has whole degrees of freedom here, and its tail is a finite sum [3]_.

References
----------
.. [1] NIST Digital Library of Mathematical Functions, 8.17.8 (symmetry, 8.17.4) and the continued fraction 8.17.22.
.. [2] M. Abramowitz and I. Stegun, Handbook of Mathematical Functions (1964), 26.7.5.
.. [3] The same, 26.4.4 and 26.4.5.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import cache
from statistics import NormalDist

import numpy as np

from imufield.samples import FloatArray

NORMAL_FACTOR_95 = 1.959964
"""``student_factor`` for infinitely many degrees of freedom."""

_NORMAL_NEARLY = 1.9602  # A Student factor below it stands for more than 10,000 degrees of freedom.
_MANY = 1000  # Degrees of freedom from which the terms of [2] left out are below 1e-11.
_TERMS = 1000  # Of the continued fraction; it takes some root of the larger argument.
_SMALLEST = 1e-300
_LEAST_SIGMA = 1e-9  # 1 sigma of a number that is known, in units of those beside it.
# Of the next factor, off one: a product swings by an ulp or two, and what is left out is of the size of rounding.
_CONVERGED = 4 * sys.float_info.epsilon


@cache
def student_quantile(freedom: float, p: float) -> float:
    """Return what Student's distribution stays below with a probability p above one half."""
    if freedom >= _MANY:
        return _nearly_normal_quantile(freedom, p)
    return _positive_root(lambda t: _student_tail(freedom, t) - (1 - p))


def f_tail(numerator: float, denominator: float, value: float) -> float:
    """Return the probability that a variable of the F distribution is at least ``value``; NaN where there is none."""
    if not (value >= 0 and numerator > 0 and denominator > 0):
        return math.nan
    return _beta(denominator / 2, numerator / 2, denominator / (denominator + numerator * value))


@cache
def f_quantile(numerator: float, denominator: float, p: float) -> float:
    """Return what the F distribution stays below with a probability."""
    return _positive_root(lambda value: f_tail(numerator, denominator, value) - (1 - p))


def chi_squared_tail(freedom: int, value: float) -> float:
    """Return the probability that a variable of chi squared is above ``value``."""
    if value <= 0:
        return 1.0
    half, odd = value / 2, freedom % 2
    # (value / 2)^k exp(-value / 2) / gamma(k + 1), k from 0 or 1/2 in steps of one up to freedom / 2 - 1; by logarithms, as one
    # factor alone may be beyond all numbers.
    orders = (k + odd / 2 for k in range(freedom // 2))
    terms = (math.exp(k * math.log(half) - half - math.lgamma(k + 1)) for k in orders)
    return math.fsum(terms) + (math.erfc(math.sqrt(half)) if odd else 0.0)


@cache
def chi_squared_quantile(freedom: int, p: float) -> float:
    """Return what a variable of chi squared stays below with a probability."""
    return _positive_root(lambda value: chi_squared_tail(freedom, value) - (1 - p))


def student_factor(degrees_of_freedom: float, of: int = 1, chance: float = 0.05) -> float:
    """Return the factor from sigma to the limit that the largest of some values passes with a chance, 95 % by default.

    Two-sided, by Student's distribution, Bonferroni for ``of`` values. It is 1.96 for one value and infinitely many degrees of
    freedom; NaN without any.
    """
    return student_quantile(float(degrees_of_freedom), 1 - chance / (2 * of)) if degrees_of_freedom > 0 else float("nan")


@cache
def degrees_of_freedom(student_factor_95: float) -> float:
    """Return the degrees of freedom whose ``student_factor`` this is; 0 where it is NaN."""
    t, p = student_factor_95, 0.975
    if not t > 0:
        return 0.0
    if t <= _NORMAL_NEARLY:
        return math.inf

    def excess(freedom: float) -> float:
        return student_quantile(freedom, p) - t if freedom >= _MANY else _student_tail(freedom, t) - (1 - p)

    return _positive_root(excess)


def deviation_limits_95(sigma: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the 95 % limits of estimated standard deviations: chi squared with their degrees of freedom."""
    from scipy.special import chdtri  # slow to load, and only noise needs it

    low = sigma * np.sqrt(freedom / chdtri(freedom, 0.025))
    high = sigma * np.sqrt(freedom / chdtri(freedom, 0.975))
    return np.asarray(low), np.asarray(high)


def f_limit_95(numerator: int, denominator: int) -> float:
    """Return the 95 % point of the F distribution; infinite without degrees of freedom."""
    return f_quantile(float(numerator), float(denominator), 0.95) if denominator > 0 else float("inf")


def sigma_of_mixture(weight: FloatArray, shift: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the sigma whose 1.96-fold is the 95 % limit of each |x|, x normal about one of some shifts.

    For one large shift d that limit is d + 1.64 sigma, less than 1.96 times the root of the sum of squares.

    Parameters
    ----------
    weight : ndarray, shape (k,)
        Probabilities of the shifts.
    shift, sigma : ndarray, shape (k, n)
    """
    size = np.sqrt(weight @ (shift**2 + sigma**2))
    limits = [_limit_of_mixture(weight, shift[:, i] / own, sigma[:, i] / own) if own > 0 else 0.0 for i, own in enumerate(size)]
    return np.asarray(size * limits / NORMAL_FACTOR_95)


def _limit_of_mixture(weight: FloatArray, shift: FloatArray, sigma: FloatArray) -> float:
    # A term that a model leaves out is exactly zero there.
    width = math.sqrt(2) * np.maximum(sigma, _LEAST_SIGMA)
    parts, erfc = list(zip(weight.tolist(), shift.tolist(), width.tolist(), strict=True)), math.erfc
    return _positive_root(lambda limit: sum(w * (erfc((limit - d) / s) + erfc((limit + d) / s)) for w, d, s in parts) - 0.1)


def _student_tail(freedom: float, t: float) -> float:
    return _beta(freedom / 2, 0.5, freedom / (freedom + t * t)) / 2


def _nearly_normal_quantile(freedom: float, p: float) -> float:
    x = NormalDist().inv_cdf(p)
    terms = (
        x,
        (x**3 + x) / 4,
        (5 * x**5 + 16 * x**3 + 3 * x) / 96,
        (3 * x**7 + 19 * x**5 + 17 * x**3 - 15 * x) / 384,
        (79 * x**9 + 776 * x**7 + 1482 * x**5 - 1920 * x**3 - 945 * x) / 92160,
    )
    return sum(term / freedom**power for power, term in enumerate(terms))


def _positive_root(excess: Callable[[float], float]) -> float:
    """Return the positive number at which a falling function is zero, by the method of Chandrupatla.

    References
    ----------
    T. R. Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function without using
    derivatives", Advances in Engineering Software 28, 1997.
    """
    a = b = 1.0
    at_a = at_b = excess(b)
    while at_a * at_b > 0:
        a, at_a = b, at_b
        b *= 2 if at_b > 0 else 0.5
        at_b = excess(b)
    c, at_c, t = a, at_a, 0.5
    while True:
        x, at_a_before = a + t * (b - a), at_a
        at_x = excess(x)
        # a is the newest point, b stands on the other side of the root, c is the one that was replaced.
        if at_x * at_a_before > 0:
            c, at_c = a, at_a
        else:
            c, at_c, b, at_b = b, at_b, a, at_a
        a, at_a = x, at_x
        best, at_best = (a, at_a) if abs(at_a) < abs(at_b) else (b, at_b)
        smallest = sys.float_info.epsilon * best / abs(b - a) if b != a else 1.0
        if at_best == 0 or smallest > 0.5:
            return best
        share, height = (a - b) / (c - b), (at_a - at_b) / (at_c - at_b)
        # Only where the three points are as an inverse parabola through them needs it.
        if 1 - math.sqrt(1 - share) < height < math.sqrt(share):
            t = at_a / (at_b - at_a) * at_c / (at_b - at_c)
            t += (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b)
        else:
            t = 0.5
        t = min(1 - smallest, max(smallest, t))


def _beta(a: float, b: float, x: float) -> float:
    """Return the regularised incomplete beta function I_x(a, b)."""
    if x <= 0 or x >= 1:
        return float(x >= 1)
    if x > (a + 1) / (a + b + 2):
        return 1 - _beta(b, a, 1 - x)
    front = math.exp(a * math.log(x) + b * math.log1p(-x) + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)) / a
    # Lentz's way from the front to the end of the fraction.
    value, c, d = 1.0, 1.0, 0.0
    for term in range(_TERMS):
        m = term // 2
        factor = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        if term % 2:
            m += 1
            factor = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        d = 1 / _no_zero(1 + factor * d)
        c = _no_zero(1 + factor / c)
        value *= c * d
        if abs(c * d - 1) < _CONVERGED:
            break
    return front / value


def _no_zero(value: float) -> float:
    return value if abs(value) > _SMALLEST else _SMALLEST
