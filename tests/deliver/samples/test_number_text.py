"""Text of many numbers against that of ``repr`` and ``str``, one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imufield.deliver.samples.number_text import float_column, integer_column, table_text
from imufield.samples import FloatArray, IntArray

EDGES = (
    *(0.0, 1.0, np.nan, np.inf, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 0.1, 1 / 3, 99.99999999999999, 100.0),
    *(1e-4, 9.999999999999999e-05, 1e-05, 1.5e-7, 1e-10, 1e-28, 1e-29, 9.999999999999999e-30, 1e-45, 2.0**-14, 2.0**-60, 3e-5),
    *(1e9, 9999999999.0, 9999999999.5, 1e10, 10000000000.5, 1e15, 9999999999999998.0, 1e16, 1e17, 123456789012345680.0),
    *(9007199254740991.0, 9007199254740993.0, 1e21, 1e22, 1e23, 1234567.0, 12345678.9, 0.0999, 0.0625, 0.00390625, 199.5),
)


def text_of(columns: FloatArray) -> str:
    return table_text([*map(float_column, columns)]).decode()


def by_repr(columns: FloatArray) -> str:
    texts = ["" if number != number else repr(number) for number in columns.T.ravel().tolist()]
    width = len(columns)
    return "".join(",".join(texts[start : start + width]) + "\n" for start in range(0, len(texts), width))


def assert_as_repr(columns: FloatArray) -> None:
    assert text_of(columns) == by_repr(columns)


def test_edges() -> None:
    edges = np.array(EDGES)
    assert_as_repr(np.array([edges, -edges, edges[::-1]]))
    # A number alone has the narrowest words that it can have.
    for edge in (*EDGES, *-edges):
        assert_as_repr(np.array([[edge]]))


@given(st.lists(st.floats(), min_size=1, max_size=40))
def test_any_numbers(numbers: list[float]) -> None:
    assert_as_repr(np.array([numbers]))


@pytest.mark.parametrize("exponent", [-320, -31, -12, -5, -4, -3, -2, -1, 0, 1, 2, 3, 8, 9, 14, 15, 16, 17, 290])
def test_many_numbers_of_one_size(exponent: int) -> None:
    rng = np.random.default_rng(exponent + 400)
    digits = rng.integers(1, 10 ** rng.integers(1, 17, 3000)) / 10.0 ** rng.integers(0, 17, 3000)
    assert_as_repr(np.array([digits, -digits]) * 10.0**exponent)


def test_counts_and_their_multiples() -> None:
    counts = np.random.default_rng(1).integers(-(2**23), 2**23, 3000)
    for scale in (1.0, 2.0**-19, 2.0**-31, 9.80665 / 2**18, 1e-3, 65536.0):
        assert_as_repr(np.array([counts * scale]))


def test_what_is_missing_is_empty() -> None:
    numbers = np.random.default_rng(2).normal(size=(3, 2500))
    numbers[0] = np.nan
    numbers[1, ::3] = np.nan
    numbers[2, 1] = np.inf
    assert_as_repr(numbers)
    assert text_of(np.full((3, 2), np.nan)) == ",,\n,,\n"


@pytest.mark.parametrize("bits", [1, 8, 13, 14, 16, 32, 40, 62, 63])
def test_integers(bits: int) -> None:
    numbers = np.random.default_rng(bits).integers(-(2**bits), 2**bits - 1, 2000, endpoint=True)
    numbers[:3] = 0, -(2**bits), 2**bits - 1
    missing = np.arange(2000) % 7 == 3
    wanted = "".join(("" if gone else str(number)) + "\n" for number, gone in zip(numbers.tolist(), missing, strict=True))
    assert table_text([integer_column(numbers, missing)]).decode() == wanted


@pytest.mark.parametrize("rows", [0, 1, 1023, 1024, 1025, 5000])
def test_a_table_of_both_kinds(rows: int) -> None:
    times = np.arange(rows) / 2000 + 99
    numbers: IntArray = np.arange(rows)
    columns = [float_column(times), integer_column(numbers, numbers < 0), float_column(-times)]
    wanted = "".join(f"{time!r},{number},{-time!r}\n" for number, time in enumerate(times.tolist()))
    # Twice: text is made of columns, and leaves them as they are.
    assert table_text(columns).decode() == table_text(columns).decode() == wanted
