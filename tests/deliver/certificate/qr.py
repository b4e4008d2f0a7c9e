"""A reader of QR codes, versions 2 to 6, level M, one segment of UTF-8 (ISO/IEC 18004): it corrects nothing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Modules = NDArray[np.bool_]

_BLOCKS = {
    2: (1, 28),
    3: (1, 44),
    4: (2, 32),
    5: (2, 43),
    6: (4, 27),
}  # Of a version: blocks, data codewords of each (table 9).
_FORMAT_MASK = 0b101010000010010
_FORMAT_GENERATOR = 0b10100110111
_FIELD = 0b100011101  # x^8 + x^4 + x^3 + x^2 + 1
_BYTES = 0b0100


def decoded(dark: Modules) -> str:
    """Return the text of a code without its quiet zone, dark modules true, shape (n, n); AssertionError where it is none."""
    size = len(dark)
    blocks, data = _BLOCKS[(size - 17) // 4]
    codewords = _codewords(dark ^ _mask(_format(dark) & 0b111, size), _is_function(size))
    codewords = codewords[: len(codewords) // blocks * blocks]
    parts = [codewords[block : blocks * data : blocks] + codewords[blocks * data + block :: blocks] for block in range(blocks)]
    assert all(_is_valid(part, checks=len(part) - data) for part in parts)
    bits = "".join(f"{word:08b}" for part in parts for word in part[:data])
    assert int(bits[:4], 2) == _BYTES
    return bytes(int(bits[at : at + 8], 2) for at in range(12, 12 + 8 * int(bits[4:12], 2), 8)).decode()


def _format(dark: Modules) -> int:
    """Return level and mask: five bits, level M being zero."""
    at = [*((8, x) for x in (0, 1, 2, 3, 4, 5, 7, 8)), *((y, 8) for y in (7, 5, 4, 3, 2, 1, 0))]
    again = [*((-1 - k, 8) for k in range(7)), *((8, k - 8) for k in range(8))]
    bits, other = ("".join(f"{dark[place]:d}" for place in places) for places in (at, again))
    assert bits == other
    rest = found = int(bits, 2) ^ _FORMAT_MASK
    for shift in range(4, -1, -1):
        rest ^= _FORMAT_GENERATOR << shift if rest >> (shift + 10) & 1 else 0
    assert rest == 0
    assert found >> 13 == 0
    return found >> 10


def _mask(number: int, size: int) -> Modules:
    i, j = np.indices((size, size))
    return np.asarray(
        (
            (i + j) % 2,
            i % 2,
            j % 3,
            (i + j) % 3,
            (i // 2 + j // 3) % 2,
            i * j % 2 + i * j % 3,
            (i * j % 2 + i * j % 3) % 2,
            ((i + j) % 2 + i * j % 3) % 2,
        )[number]
        == 0
    )


def _is_function(size: int) -> Modules:
    """Return where finders, formats, timing and the one alignment pattern are."""
    function = np.zeros((size, size), dtype=np.bool_)
    function[:9, :9] = function[:9, -8:] = function[-8:, :9] = True
    function[6] = function[:, 6] = True
    function[-9:-4, -9:-4] = True
    return function


def _codewords(dark: Modules, is_function: Modules) -> list[int]:
    bits = "".join(f"{dark[place]:d}" for place in _zigzag(len(dark)) if not is_function[place])
    return [int(bits[at : at + 8], 2) for at in range(0, len(bits) - 7, 8)]


def _zigzag(size: int) -> Iterator[tuple[int, int]]:
    """Yield the modules in pairs of columns from the right, up and down in turn; the timing column is in no pair."""
    rights = [*range(size - 1, 6, -2), 5, 3, 1]
    for turn, right in enumerate(rights):
        for y in range(size) if turn % 2 else range(size - 1, -1, -1):
            yield from ((y, right), (y, right - 1))


def _is_valid(codewords: list[int], checks: int) -> bool:
    """Return whether the polynomial of the codewords is zero at the powers 0 to ``checks`` - 1 of 2 (Reed and Solomon)."""
    power = 1
    for _ in range(checks):
        value = 0
        for word in codewords:
            value = _product(value, power) ^ word
        if value:
            return False
        power = _product(power, 2)
    return True


def _product(a: int, b: int) -> int:
    total = 0
    while b:
        total ^= a if b & 1 else 0
        a, b = a << 1 ^ (_FIELD if a & 0x80 else 0), b >> 1
    return total
