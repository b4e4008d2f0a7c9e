"""Numbers as text, a block at a time, by NumPy alone: that of ``repr`` and ``str``, byte for byte.

The text is built of words of 8 bytes that hold up to 8 characters, the first in the lowest byte; a byte of 0 stands for none
and is taken out at the end. The words of a column of numbers are its cell. Digits come from tables, four at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from imufield.deliver.samples.shortest import BELOW, MOST_DECIMALS, shortest_decimals
from imufield.samples import FloatArray, IntArray, UIntArray

Cell = list[UIntArray]

_EXPONENT_BELOW = 1e-4  # ``repr`` writes an exponent below this, and from ``BELOW`` on.
_SEPARATOR = ord(",")  # Lowest byte of a cell's first word; the sign is in the next.
_MINUS = ord("-") << 8
_LINE_END = ord("\n")
_LAST_ZERO = ord("0") << 56
_HALF_WORD = np.uint64(32)
_GROUP = np.uint64(10**4)
_EIGHT_DIGITS = np.uint64(10**8)
_SIXTEEN_DIGITS = np.uint64(10**16)
_HEAD_BELOW = 100  # Integer parts that are in one word, the head, with point and first decimal.
_DECIMALS = 17  # The first, and 16 in the two words behind.
_MOST_ZEROS = 3  # Behind the point and before these decimals: those of 1e-4.
_PADDED_HEADS = 10 * (_HEAD_BELOW + _MOST_ZEROS)  # Index of the first head that follows other digits.
_ROWS_JOINED = 1024  # 200 kB of words: more would be given back to the system each time, and asked from it again.


@dataclass(frozen=True, slots=True)
class _Texts:
    """Words by what they say; groups of four digits, in the lower half of a word, by their number."""

    heads: UIntArray
    """Text up to the first decimal d, from the third byte on: "i.d" at 10 i + d, then the others."""
    padded: UIntArray
    leading: UIntArray
    """Without zeros in front; 0 is empty."""
    trailing: UIntArray
    """Without zeros at the end."""
    exponents: UIntArray
    first_head: IntArray
    """Index of the head of numbers with k decimals, integer part and first decimal being 0."""
    shift: UIntArray
    """What makes k decimals ``_DECIMALS``, or as many as follow the zeros of the head."""


@cache
def _texts() -> _Texts:
    heads = [
        *(f"{tenths // 10}.{tenths % 10}" for tenths in range(10 * _HEAD_BELOW)),
        *(f"0.{'0' * zeros}{digit}" for zeros in range(1, _MOST_ZEROS + 1) for digit in range(10)),
        *(f"{tenths // 10:02d}.{tenths % 10}" for tenths in range(10 * _HEAD_BELOW)),
    ]
    groups = [f"{number:04d}" for number in range(int(_GROUP))]
    zeros = np.arange(MOST_DECIMALS + 1) - _DECIMALS
    return _Texts(
        heads=_words_of(heads) << np.uint64(16),
        padded=_words_of(groups),
        leading=_words_of([group.lstrip("0").rjust(4, "\0") for group in groups]),
        trailing=_words_of([group.rstrip("0") for group in groups]),
        exponents=_words_of([f"e-{number:02d}" for number in range(MOST_DECIMALS)]),
        first_head=np.where((zeros > 0) & (zeros <= _MOST_ZEROS), 10 * (_HEAD_BELOW + zeros - 1), 0),
        shift=np.array([10 ** max(-number, 0) for number in zeros.tolist()], dtype=np.uint64),
    )


def _words_of(texts: Sequence[str]) -> UIntArray:
    return np.array(texts, dtype="S8").view("<u8").astype(np.uint64)


def table_text(cells: Sequence[Cell]) -> bytes:
    """Return the lines of a table whose columns are the cells, with commas between."""
    first, *others = [words for cell in cells for words in cell]
    # Each line begins with the end of the one before, in the place of its first separator.
    first = first ^ np.uint64(_SEPARATOR ^ _LINE_END)
    first[:1] ^= np.uint64(_LINE_END)
    parts = []
    for start in range(0, len(first), _ROWS_JOINED):
        words = np.array([column[start : start + _ROWS_JOINED] for column in (first, *others)], dtype="<u8")
        parts.append(words.tobytes("F").translate(None, b"\0"))
    return b"".join([*parts, b"\n"]) if parts else b""


def integer_cell(values: IntArray, missing: NDArray[np.bool_]) -> Cell:
    """Return the cell of integers, empty where they are missing."""
    size = np.abs(values).view(np.uint64)
    cell = _integer_words(size, _signs(values < 0))
    cell[-1] |= (size == 0) * np.uint64(_LAST_ZERO)
    _empty(cell, np.flatnonzero(missing))
    return cell


def float_cells(columns: FloatArray) -> list[Cell]:
    """Return the cells of columns of doubles of one kind, shape (columns, rows); empty where they are NaN."""
    cell = _float_cell(columns.ravel())
    return [[words.reshape(columns.shape)[column] for words in cell] for column in range(len(columns))]


def _float_cell(values: FloatArray) -> Cell:
    size = np.abs(values)
    outside = np.flatnonzero(~(size < BELOW))  # NaN, too.
    missing = outside[np.isnan(values[outside])]
    if len(missing) == len(values):
        return [np.full(len(values), _SEPARATOR, dtype=np.uint64)]
    size[outside] = 0.0
    cell, undecided = _ordinary_cell(size, _signs(np.signbit(values)))
    undecided[outside] = True
    undecided[missing] = False
    _empty(cell, missing)
    rows = np.flatnonzero(undecided)
    if len(rows):
        # A sign, 17 digits, point and exponent are 24 characters at most.
        texts = np.array([f",{value!r}" for value in values[rows].tolist()], dtype="S32").view("<u8").reshape(len(rows), 4)
        cell += [np.zeros(len(values), dtype=np.uint64) for _ in range(4 - len(cell))]
        for number, words in enumerate(cell):
            words[rows] = texts[:, number] if number < 4 else 0
    return cell


def _ordinary_cell(size: FloatArray, signs: UIntArray) -> tuple[Cell, NDArray[np.bool_]]:
    """Return the cell of doubles whose size is less than ``BELOW``, and in which rows it is to be replaced."""
    texts = _texts()
    digits, decimals, undecided = shortest_decimals(size)
    small = np.flatnonzero(size < _EXPONENT_BELOW)
    small = small[size[small] > 0]
    digits_of_small = digits[small]
    digits *= texts.shift.take(decimals)
    head = texts.first_head.take(decimals)
    first: Cell = []
    if size.max(initial=0.0) >= _HEAD_BELOW:
        hundreds = size.astype(np.uint64) // np.uint64(_HEAD_BELOW)
        # Both products are modulo 2**64, the difference is below that.
        digits -= hundreds * np.uint64(_HEAD_BELOW * 10**_DECIMALS)
        head += (hundreds > 0) * np.int64(_PADDED_HEADS)
        first, signs = _integer_words(hundreds, signs), np.zeros_like(signs)
    tenths = digits // _SIXTEEN_DIGITS
    digits -= tenths * _SIXTEEN_DIGITS
    head += tenths.view(np.int64)
    cell = [texts.heads.take(head) | signs, *_words_of_sixteen(digits)]
    for words, of_small in zip(cell, _exponent_words(digits_of_small, decimals[small], signs[small]), strict=True):
        words[small] = of_small
    return first + cell, undecided


def _exponent_words(digits: UIntArray, decimals: IntArray, signs: UIntArray) -> Cell:
    """Return the words of ``digits / 10**decimals`` with an exponent."""
    is_short = digits < _SIXTEEN_DIGITS
    digits = np.where(is_short, digits * np.uint64(10), digits)
    lead = digits // _SIXTEEN_DIGITS
    digits -= lead * _SIXTEEN_DIGITS
    head = signs | (lead + np.uint64(ord("0"))) << np.uint64(16) | (digits > 0) * np.uint64(ord(".") << 24)
    # Four bytes are left there: all digits move up by as many, and the exponent fits behind them.
    first, second = _words_of_sixteen(digits)
    exponent = _texts().exponents.take(decimals - 16 + is_short)
    return [
        head | first << _HALF_WORD,
        first >> _HALF_WORD | second << _HALF_WORD,
        second >> _HALF_WORD | exponent << _HALF_WORD,
    ]


def _words_of_sixteen(digits: UIntArray) -> Cell:
    """Return the words of 16 digits, without zeros at the end."""
    padded, trailing = _texts().padded, _texts().trailing
    upper = digits // _EIGHT_DIGITS
    (a, b), (c, d) = (_groups(half.astype(np.uint32)) for half in (upper, digits - upper * _EIGHT_DIGITS))
    first = padded.take(a) | padded.take(b) << _HALF_WORD
    second = padded.take(c) | trailing.take(d) << _HALF_WORD
    rows = np.flatnonzero(d == 0)
    second[rows] = trailing.take(c[rows])
    rows = rows[c[rows] == 0]
    first[rows] = padded.take(a[rows]) | trailing.take(b[rows]) << _HALF_WORD
    rows = rows[b[rows] == 0]
    first[rows] = trailing.take(a[rows])
    return [first, second]


def _groups(digits: NDArray[np.uint32]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    upper = digits // np.uint32(_GROUP)
    return upper, digits - upper * np.uint32(_GROUP)


def _integer_words(size: UIntArray, signs: UIntArray) -> Cell:
    """Return the words of integers that are not negative behind their signs; 0 has no digit."""
    texts = _texts()
    groups: list[UIntArray] = []
    # The sign and the first group, then two groups in a word.
    while not len(groups) % 2 or size.any():
        rest = size // _GROUP
        group = (size - rest * _GROUP).view(np.int64)
        groups.append(np.where(rest > 0, texts.padded.take(group), texts.leading.take(group)))
        size = rest
    words = [signs, *groups[::-1]]
    return [lower | upper << _HALF_WORD for lower, upper in zip(words[::2], words[1::2], strict=True)]


def _signs(is_negative: NDArray[np.bool_]) -> UIntArray:
    """Return the first characters of a cell."""
    return is_negative * np.uint64(_MINUS) + np.uint64(_SEPARATOR)


def _empty(cell: Cell, rows: NDArray[np.intp]) -> None:
    for words in cell:
        words[rows] = 0
    cell[0][rows] = _SEPARATOR
