"""Columns of numbers as lines of text: that of ``repr`` and ``str``, byte for byte, empty where there is none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import itemgetter
from typing import TypeAlias

import numpy as np
import orjson
from numpy.typing import NDArray

from imufield.samples import FloatArray, IntArray

Cell: TypeAlias = float | orjson.Fragment

_PLAIN_FROM, _PLAIN_BELOW = 1e-4, 1e16
"""Sizes that ``repr`` writes without an exponent: there the shortest digits are the whole text, whoever writes them."""
_EMPTY = orjson.Fragment(b"")
_INSIDE = itemgetter(slice(1, -1))


def float_column(values: FloatArray) -> list[Cell]:
    """Return the cells of doubles, empty where they are NaN."""
    missing, size = np.isnan(values), np.abs(values)
    if missing.all():
        return [_EMPTY] * len(values)
    cells: list[Cell] = values.tolist()
    with_exponent = np.flatnonzero(((size < _PLAIN_FROM) & (size > 0)) | (size >= _PLAIN_BELOW))
    for row, text in zip(with_exponent.tolist(), map(repr, values[with_exponent].tolist()), strict=True):
        cells[row] = orjson.Fragment(text.encode())
    for row in np.flatnonzero(missing).tolist():
        cells[row] = _EMPTY
    return cells


def integer_column(values: IntArray, missing: NDArray[np.bool_]) -> list[Cell]:
    """Return the cells of integers, empty where they are missing."""
    cells: list[Cell] = values.tolist()
    for row in np.flatnonzero(missing).tolist():
        cells[row] = _EMPTY
    return cells


def table_text(columns: Iterable[Sequence[Cell]]) -> bytes:
    """Return the lines of a table, with commas between."""
    # Rows are JSON arrays without their brackets; the last line ends, too. A loop in Python takes a tenth more.
    return b"\n".join([*map(_INSIDE, map(orjson.dumps, zip(*columns, strict=True))), b""])
