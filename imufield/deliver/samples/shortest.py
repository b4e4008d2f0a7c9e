"""The shortest decimal number that reads back as the same double, as ``repr`` has it, for many doubles at once by NumPy alone.

For a double ``v = m 2**e`` with ``2**52 <= m < 2**53``, let k be the least integer with ``10**k 2**e >= 1``, and ::

    V = v 10**k               2**52 <= V < 10**17: 16 or 17 digits before the point
    h = 10**k 2**e / 2        0.5 <= h < 5: half the step from v to its neighbours, in the same unit

What lies between V - h and V + h reads back as v. At most one multiple of ten does: it is the shortest, less its zeros at the
end. Where there is none, all integers between are equally long, and the one nearest to V is wanted, of two the even one
(R. Giulietti, "The Schubfach way to render doubles", 2020). So V is rounded to tens where that moves it by less than h, else
to ones.

V has more digits than a double. It is p + q, the product of two doubles and its rounding error, which is a double, too
(T. J. Dekker, "A floating-point technique for extending the available precision", Numer. Math. 18, 1971). That is exact as
long as 10**k is a double (k <= 22), else to 1e-14. What is too close to tell is undecided. So is m = 2**52, where the step
below is half of that above, unless k <= 20: V is an integer then, and needs no rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from imufield.samples import FloatArray, IntArray, UIntArray

BELOW = 1e16
"""Numbers from this on are not for here; ``repr`` writes them with an exponent."""
_LEAST = 1e-29  # Smaller ones are undecided: 10**k would not be the sum of two doubles.
MOST_DECIMALS = 45
"""k of these."""
_SURE_DECIMALS = 20  # Up to this k all is exact, with bits to spare: what looks like a tie is one.
_UNDECIDED = 2.0**-30  # Least difference that is believed: far above the rounding of V, and rarely met by chance.
_MANTISSA_BITS = 52
_MANTISSA = (1 << _MANTISSA_BITS) - 1
_BIAS = 1023 + _MANTISSA_BITS  # Of e in the bits of a double.
_UPPER_HALF = ~((1 << 27) - 1)  # Bits of a double that leave 26 of its mantissa.
_SPLIT = 2.0**27 + 1  # Dekker's factor for the same.


@dataclass(frozen=True, slots=True)
class _Powers:
    """Numbers by e, as it stands in the bits of a double, and by k."""

    decimals: IntArray
    """k by e, at most ``MOST_DECIMALS``."""
    half_step: FloatArray
    """h by e; of zero any number above."""
    upper: FloatArray
    lower: FloatArray
    """Halves of the double nearest to 10**k, of 26 bits each."""
    rest: FloatArray
    """10**k less that double."""


@cache
def _powers() -> _Powers:
    exponent = np.arange(2048) - _BIAS
    decimals = np.clip(np.ceil(-exponent * np.log10(2)), 0, MOST_DECIMALS).astype(np.int64)
    exact = [10**k for k in range(MOST_DECIMALS + 1)]
    power = np.array(exact, dtype=np.float64)
    upper = power * _SPLIT - (power * _SPLIT - power)
    half_step = np.ldexp(power[decimals], exponent - 1)
    half_step[0] = 1.0
    return _Powers(
        decimals=decimals,
        half_step=half_step,
        upper=upper,
        lower=power - upper,
        rest=np.array([float(whole - int(float(whole))) for whole in exact]),
    )


def shortest_decimals(size: FloatArray) -> tuple[UIntArray, IntArray, NDArray[np.bool_]]:
    """Return integers N and decimals k, so that N / 10**k is the shortest number, and where these are undecided.

    Parameters
    ----------
    size : ndarray, shape (n,)
        Not negative, less than ``BELOW``.
    """
    powers = _powers()
    exponent = size.view(np.int64) >> _MANTISSA_BITS
    decimals = powers.decimals.take(exponent)
    small = np.flatnonzero(decimals > _SURE_DECIMALS)
    upper, lower = powers.upper.take(decimals), powers.lower.take(decimals)
    size_upper = (size.view(np.int64) & _UPPER_HALF).view(np.float64)
    size_lower = size - size_upper
    p = size * (upper + lower)
    q = (size_upper * upper - p) + size_upper * lower + size_lower * upper + size_lower * lower
    q[small] += size[small] * powers.rest.take(decimals[small])
    whole = p.astype(np.uint64)
    tens = whole // np.uint64(10) * np.uint64(10)
    above = (whole - tens).astype(np.float64) + q  # V - tens, from -8 to 18.
    nearest_ten = np.rint(above / 10) * 10
    from_ten, half_step = np.abs(above - nearest_ten), powers.half_step.take(exponent)
    rounded = np.where(from_ten < half_step, nearest_ten, np.rint(above))
    undecided = np.abs(from_ten - half_step) < _UNDECIDED
    if len(small):
        size, from_half = size[small], np.abs(above[small] - np.floor(above[small]) - 0.5)
        is_hard = (from_half < _UNDECIDED) | (size < _LEAST) | (size.view(np.int64) & _MANTISSA == 0)
        undecided[small] |= is_hard & (size > 0)
    return tens + rounded.astype(np.int64).view(np.uint64), decimals, undecided
