"""Lines with their digits in the same places: every number as Python reads it, and no number where a line is another."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats.table_digits import read_alike
from imufield.acquire.formats.table_text import open_table
from imufield.errors import Reason, RecordingError
from tests.refused import refused

_RNG = np.random.default_rng(5)
ROWS = _RNG.uniform(1000, 9999, (40, 3)) * _RNG.choice([-1, 1], (40, 3))
FORMATS = {
    "MATLAB": (None, " %15.7e %15.7e %15.7e"),
    "fifteen digits": (",", "%+.14e,%+.14e,%+.14e"),
    "small powers": (";", "%+.3e;%+.8E;%+.1e"),
    "one tab": (None, "%+09.5f\t%+09.4f\t%+09.1f"),
    "blanks and a sign": (",", "%12.6f, %12.6f,% .1f"),
    "whole numbers": (None, "% d % d   %6d"),
}


def lines_of(pattern: str, rows: np.ndarray, end: str = "\n") -> bytes:
    return "".join(pattern % tuple(row) + end for row in rows).encode()


def as_python_reads(lines: bytes, delimiter: str | None) -> list[list[float]]:
    """Return the numbers by another route; raises ``ValueError`` where a cell is none."""
    return [[float(cell) for cell in line.split(delimiter)] for line in lines.decode("latin-1").splitlines()]


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_numbers_are_read_to_the_last_bit(kind: str, end: str) -> None:
    delimiter, pattern = FORMATS[kind]
    lines = lines_of(pattern, ROWS, end)
    found = read_alike(lines, delimiter, 3)
    assert found is not None
    assert found.tolist() == as_python_reads(lines, delimiter)


def test_powers_are_exact_at_both_ends() -> None:
    mantissas, powers = ("-9.99999999999999", " 1.00000000000001", " 0.00000000000000"), range(-8, 37)
    lines = "".join(f"{m}e{p:+03d}\n" for m, p in itertools.product(mantissas, powers)).encode()
    found = read_alike(lines, None, 1)
    assert found is not None
    assert found.tolist() == as_python_reads(lines, None)
    assert np.signbit(found[2 * len(powers) :]).sum() == 0
    # The next power of ten is rounded itself.
    assert read_alike(b"1.00000000000001e+37\n", None, 1) is None
    assert read_alike(b"1.00000000000001e-09\n", None, 1) is None


@pytest.mark.parametrize("kind", FORMATS)
def test_a_damaged_byte_never_gives_another_number(kind: str) -> None:
    delimiter, pattern = FORMATS[kind]
    lines, rng, read = lines_of(pattern, ROWS[:4]), np.random.default_rng(1), 0
    for place, byte in itertools.product(range(len(lines)), rng.choice([*b" +-.,;e\n\t#", *b"05nx", 0, 255], 6)):
        damaged = lines[:place] + bytes([byte]) + lines[place + 1 :]
        found = read_alike(damaged, delimiter, 3)
        if found is not None:
            read += 1
            assert found.tolist() == as_python_reads(damaged, delimiter)
    # Another digit is as good as the first.
    assert read > len(lines) / 10


@pytest.mark.parametrize(
    "lines",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(b"1.0 2.0 3.0", id="no end"),
        pytest.param(b"1.0 2.0 3.0\n1.0 2.0\n", id="a short line"),
        pytest.param(b"1.0 2.0\n1.0 2.0\n", id="too few cells"),
        pytest.param(b"1.0 2.0 3.0\n1.0 nan 3.0\n", id="no number"),
        pytest.param(b"1.0 2.0 3.0\n1.0 2.0 3#0\n", id="a comment"),
        pytest.param(b"1.0 2.0 1234567890123456\n", id="sixteen digits"),
        pytest.param(b"1.0 2.0 3\n1.0-2.0 3\n", id="a sign for the only blank"),
        pytest.param(b"\xef\xbb\xbf1.0 2.0 3.0\n", id="a mark of UTF-8"),
    ],
)
def test_other_lines_are_left_to_the_parser(lines: bytes) -> None:
    assert read_alike(lines, None, 3) is None


@pytest.mark.parametrize("heading", ["", "time ax ay\n", "# a note\ntime ax ay\n"])
@pytest.mark.parametrize("last", ["", "  5.0000000e-01  5.0000000e-01  5.0000000e-01", "  5.0000000e-01"])
def test_a_table_is_the_same_whatever_stands_around_its_rows(tmp_path: Path, heading: str, last: str) -> None:
    path = tmp_path / "table.txt"
    path.write_bytes(heading.encode() + lines_of("%15.7e%15.7e%15.7e", ROWS) + last.encode())
    wanted = [[float(f"{value:.7e}") for value in row] for row in ROWS] + [[0.5] * 3] * (len(last.split()) == 3)
    assert open_table(path).read((2, 0)).tolist() == [[row[2], row[0]] for row in wanted]


def test_a_heading_of_more_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_bytes(b"time ax ay az gx\n" + lines_of("%15.7e%15.7e%15.7e", ROWS))
    with refused(RecordingError, Reason.BAD_DATA, str(path), "3 columns", key="table_text.narrow_rows"):
        open_table(path).read((0, 4))
