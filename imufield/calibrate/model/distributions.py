"""Student's and the F distribution, which every solved session asks a few times: SciPy's take longer to load than it to solve.

Both are incomplete beta functions [1]_; what passes a chance is found between bounds that are halved. Where Student's
distribution has many degrees of freedom, its quantile is that of the normal distribution with the terms of [2]_.

References
----------
.. [1] NIST Digital Library of Mathematical Functions, 8.17.8 (symmetry, 8.17.4) and the continued fraction 8.17.22.
.. [2] M. Abramowitz and I. Stegun, Handbook of Mathematical Functions (1964), 26.7.5.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import cache
from statistics import NormalDist

_MANY = 1000  # Degrees of freedom from which the terms of [2] left out are below 1e-11.
_TERMS = 1000  # Of the continued fraction; it takes some root of the larger argument.
_SMALLEST = 1e-300
# Nearer to one than a product that swings by an ulp or two; what is left out is of the size of rounding.
_EXACT = 4 * sys.float_info.epsilon


@cache
def student_quantile(freedom: float, p: float) -> float:
    """Return what Student's distribution stays below with a probability p above one half."""
    if freedom >= _MANY:
        return _nearly_normal_quantile(freedom, p)
    return _between(lambda t: _student_tail(freedom, t) > 1 - p)


def student_freedom(p: float, t: float) -> float:
    """Return the degrees of freedom for which t, which is more than that of the normal distribution, is the quantile of p."""

    def is_too_few(freedom: float) -> bool:
        return student_quantile(freedom, p) > t if freedom >= _MANY else _student_tail(freedom, t) > 1 - p

    return _between(is_too_few)


def f_tail(numerator: float, denominator: float, value: float) -> float:
    """Return the probability that a variable of the F distribution is at least ``value``; NaN where there is none."""
    if not (value >= 0 and numerator > 0 and denominator > 0):
        return math.nan
    return _beta(denominator / 2, numerator / 2, denominator / (denominator + numerator * value))


@cache
def f_quantile(numerator: float, denominator: float, p: float) -> float:
    """Return what the F distribution stays below with a probability."""
    return _between(lambda value: f_tail(numerator, denominator, value) > 1 - p)


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


def _between(is_below: Callable[[float], bool]) -> float:
    """Return the positive number at which this ceases to be true."""
    low, high = 0.0, 1.0
    while is_below(high):
        low, high = high, 2 * high
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if is_below(middle) else (low, middle)
    return high


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
        if abs(c * d - 1) < _EXACT:
            break
    return front / value


def _no_zero(value: float) -> float:
    return value if abs(value) > _SMALLEST else _SMALLEST
