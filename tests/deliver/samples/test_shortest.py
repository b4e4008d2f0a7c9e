"""The shortest decimals of doubles against ``repr``, and against the definition by fractions."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imufield.deliver.samples.shortest import BELOW, shortest_decimals
from imufield.samples import FloatArray


def assert_shortest(size: FloatArray) -> float:
    """Compare with ``repr`` where it is decided; return the share where it is not."""
    digits, decimals, undecided = shortest_decimals(size)
    for row in np.flatnonzero(~undecided):
        assert Decimal(int(digits[row])).scaleb(-int(decimals[row])) == Decimal(repr(float(size[row])))
    return float(np.mean(undecided))


def bounds(number: float) -> tuple[Fraction, Fraction]:
    """Return what lies half way from a double to its neighbours."""
    exact = Fraction(number)
    low, high = ((exact + Fraction(float(np.nextafter(number, end)))) / 2 for end in (0.0, np.inf))
    return low, high


@given(st.lists(st.floats(0.0, BELOW, exclude_max=True), min_size=1, max_size=40))
def test_any_numbers(numbers: list[float]) -> None:
    assert_shortest(np.array(numbers))


@pytest.mark.parametrize("exponent", range(-28, 16))
def test_random_doubles_are_decided(exponent: int) -> None:
    size = np.random.default_rng(exponent + 100).uniform(1.0, 10.0, 3000) * 10.0**exponent
    assert assert_shortest(size[size < BELOW]) == 0.0


@pytest.mark.parametrize("bits", range(-21, 53))
def test_multiples_of_a_power_of_two_are_decided(bits: int) -> None:
    # Of such are the ties: counts times a scale that a converter has.
    most = min(2**24, int(BELOW) >> max(bits, 0))
    size = np.random.default_rng(bits + 100).integers(1, most, 3000, endpoint=True).astype(np.float64) * 2.0**bits
    assert assert_shortest(size[size >= 1e-4]) == 0.0


def test_a_tie_goes_to_the_even_digit() -> None:
    # These have 17 decimals, the last of them a 5; k is 16.
    size = np.array([0.5 + odd * 2.0**-17 for odd in range(1, 4000, 2)])
    digits, decimals, undecided = shortest_decimals(size)
    assert not undecided.any()
    exact = [Fraction(number) * 10**places for number, places in zip(size.tolist(), decimals.tolist(), strict=True)]
    pairs = zip(exact, digits.tolist(), strict=True)
    ties = [(value, whole) for value, whole in pairs if value.denominator == 2 and whole % 10]
    assert len(ties) > 1000
    assert all(abs(value - whole) == Fraction(1, 2) and whole % 2 == 0 for value, whole in ties)


def test_no_shorter_number_reads_back() -> None:
    size = np.random.default_rng(1).uniform(0.0, 20.0, 500)
    digits, decimals, _ = shortest_decimals(size)
    for number, whole, places in zip(size.tolist(), digits.tolist(), decimals.tolist(), strict=True):
        low, high = (bound * 10**places for bound in bounds(number))
        assert low <= whole <= high
        step = 10 if whole % 10 else 10 ** (len(str(whole)) - len(str(whole).rstrip("0")) + 1)
        assert not any(low <= shorter <= high for shorter in (whole // step * step, whole // step * step + step))


def test_zero_and_whole_numbers() -> None:
    size = np.array([0.0, 1.0, 2.0, 1024.0, 8388607.0, 2.0**40, 2.0**52, 2.0**53, 9007199254740994.0, 0.5, 2.0**-13])
    assert assert_shortest(size) == 0.0
