from __future__ import annotations

import math

import pytest

from imufield.deliver.parameters.printed_numbers import (
    acceleration_unit,
    bar,
    beside,
    decimals,
    hanging,
    to_ascii,
    with_sigma,
    with_sigma_within,
)
from imufield.earth import MICRO_G_M_S2

pytestmark = pytest.mark.numerical


@pytest.mark.parametrize(
    ("sigma", "expected"),
    [(0.056, 3), (0.56, 2), (5.6, 1), (56, 0), (560, -1), (0.0996, 2), (0.0994, 3), (0, 0)],
)
def test_decimals(sigma: float, expected: int) -> None:
    assert decimals(sigma) == expected


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (1.23456, 0.0561, "+1.235 ± 0.056"),
        (-25537.0, 9545.0, "-25500 ± 9500"),
        (0.0, 0.0, "0 fixed"),
        (1.5, 0.0, "+1.5 fixed"),
        (0.0, math.nan, "not estimated"),
        (4777.93, math.nan, "+4777.9 ± ?"),
    ],
)
def test_with_sigma(value: float, sigma: float, expected: str) -> None:
    assert with_sigma(value, sigma, sign=True) == expected


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (0.0312, 0.00011, "0.03120 ± 0.00011"),
        (1.000123456, 0.0000521, "1.00012 ± 0.00005"),
        (0.0001, 0.0000021, "(100.0 ± 2.1)e-6"),
        (123456.789, 0.0123, "123456.789 ± 0.012"),
        (1234567.89123, 0.000123, "1234567.8912 ± 0.0001"),
        (math.nan, math.nan, "nan ± ?"),
        (-0.029879123, math.nan, "-0.029879 ± ?"),
        (-1.2345678e-12, 0.0, "-1.2346e-12 fixed"),
    ],
)
def test_with_sigma_within(value: float, sigma: float, expected: str) -> None:
    assert with_sigma_within(18, value, sigma) == expected


def test_bars_grow_by_eighths() -> None:
    assert [bar(share, 2) for share in (0, 1 / 16, 0.5, 1, 7)] == ["  ", "▏ ", "█ ", "██", "██"]


def test_units_of_the_trade() -> None:
    assert acceleration_unit(50 * MICRO_G_M_S2)[0] == "µg"
    assert acceleration_unit(0.2)[0] == "mg"
    assert acceleration_unit(math.nan)[0] == "µg"


def test_ascii_says_the_same() -> None:
    assert to_ascii("± is: 1.23 ± 0.05 °/h") == "+- is: 1.23 +-0.05 deg/h"
    assert to_ascii("31 °C µg/g² █▎ ◄") == "31 degC ug/g^2 #. <"


def test_long_sentences_hang_and_keep_their_words() -> None:
    path = "x" * 90
    words = "a sentence of so many words that it is longer than one line of a terminal, with"
    lines = hanging("lost:    ", f"{words} {path}").splitlines()
    assert lines[0].startswith("lost:    a sentence")
    assert all(line.startswith(" " * 9) for line in lines[1:])
    assert lines[-1].strip() == path
    assert max(map(len, lines[:-1])) <= 80


def test_a_path_is_not_broken() -> None:
    assert beside("written to", "a/b") == "written to a/b"
    assert beside("written to", "x" * 75) == f"written to\n{'x' * 75}"
    assert beside("written to ", "x" * 75, indent=2) == f"written to\n  {'x' * 75}"


def test_a_wide_character_takes_two_columns() -> None:
    # "written to " and 34 of them are 79 columns, 35 are 81.
    assert beside("written to", "東" * 34) == f"written to {'東' * 34}"
    assert beside("written to", "東" * 35) == f"written to\n{'東' * 35}"


@pytest.mark.parametrize(("columns", "width"), [("200", 80), ("80", 80), ("60", 60)])
def test_sentences_fill_a_terminal_up_to_80_columns(monkeypatch: pytest.MonkeyPatch, columns: str, width: int) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    words = "a word of five letters and another one " * 10
    lines = hanging(" · ", words).splitlines()
    assert width - len("another") <= max(map(len, lines)) <= width
    assert " ".join(line.strip(" ·") for line in lines) == words.strip()
