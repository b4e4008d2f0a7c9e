"""Read tables of fixed width, digit below digit, as MATLAB, Octave and ``printf`` write them.

A place of all lines is an array, so that NumPy reads them several times as fast as its parser of text does. The numbers
are the same to the last bit: fifteen digits and a power of ten up to 22 are exact, so that their product is rounded once
(Clinger 1990, "How to read floating point numbers accurately").
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imufield.samples import FloatArray

# A blank before a number may be a sign in another line.
_NUMBER = re.compile(rb"(?: *(?P<sign>[ +-]))?(?P<whole>\d+)\.?(?P<decimals>\d*)(?:[eE](?P<power_sign>[+-])(?P<power>\d\d))?")
_EXACT_DIGITS = 15
_POWERS = 10.0 ** np.arange(23)


def read_alike(lines: bytes, delimiter: str | None, width: int) -> FloatArray | None:
    """Return the numbers of lines that have their digits in the same places as the first.

    Parameters
    ----------
    lines : bytes
        Whole lines, each with its end.
    delimiter : str or None
        None for blanks and tabs.
    width : int
        Number of columns.

    Returns
    -------
    ndarray, shape (n, width), or None
        Where the lines differ, or hold anything but so many numbers of at most 15 digits.
    """
    length = lines.find(b"\n") + 1
    line = lines[:length].rstrip(b"\r\n")
    mark = re.escape((delimiter or "").encode())
    # One blank parts cells, more of them belong to the number.
    cell = re.compile(rb"(?:^|%b)([^%b]*)" % (mark, mark) if mark else rb"(?:^|[ \t])([ \t]*[^ \t]+)")
    found = [_NUMBER.fullmatch(line, *match.span(1)) for match in cell.finditer(line)]
    numbers = [number for number in found if number is not None]
    if not length or len(lines) % length or not len(numbers) == len(found) == width:
        return None
    # As contiguous arrays the places of all lines are compared and added up at once.
    places = np.frombuffer(lines, np.uint8).reshape(-1, length).T.copy()
    try:
        values = np.column_stack([_values(places, number) for number in numbers])
        _refuse_unlike(places, numbers)
    except ValueError:
        return None
    return values


def _values(places: NDArray[np.uint8], number: re.Match[bytes]) -> FloatArray:
    decimals = [*range(*number.span("decimals"))]
    digits = [*range(*number.span("whole")), *decimals]
    power = _signs(places, number, "power_sign") * _whole(places, [*range(*number.span("power"))]) - len(decimals)
    if len(digits) > _EXACT_DIGITS or (np.abs(power) >= len(_POWERS)).any():
        raise ValueError("not exact")
    whole = _signs(places, number, "sign") * _whole(places, digits)
    scale = _POWERS[np.abs(power).astype(np.intp)]
    return np.where(power < 0, whole / scale, whole * scale)


def _whole(places: NDArray[np.uint8], digits: Sequence[int]) -> FloatArray:
    found = places[digits] - ord("0")
    if (found > 9).any():
        raise ValueError("no digit")
    # Not as a product of matrices, which would make an array of floats of every digit.
    return np.asarray(np.einsum("i,ij->j", _POWERS[: len(digits)][::-1], found))


def _signs(places: NDArray[np.uint8], number: re.Match[bytes], name: str) -> FloatArray | float:
    if not number[name]:
        return 1.0
    found = places[number.start(name)]
    minus, *others = (found == character for character in (b"-+" if name == "power_sign" else b"-+ "))
    if not np.logical_or.reduce([minus, *others]).all():
        raise ValueError("no sign")
    return np.where(minus, -1.0, 1.0)


def _refuse_unlike(places: NDArray[np.uint8], numbers: Sequence[re.Match[bytes]]) -> None:
    variable = {place for number in numbers for name in _NUMBER.groupindex for place in range(*number.span(name))}
    fixed = [place for place in range(len(places)) if place not in variable]
    if (places[fixed] != places[fixed, :1]).any():
        raise ValueError("other lines")
