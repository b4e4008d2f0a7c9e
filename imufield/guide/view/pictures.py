"""Pictures of the unit and big letters, drawn with characters.

The picture is the box of ``imufield.drawing``, as the unit is now or as it should be. From frame to frame it turns by the
shortest way, and the goal is the shortest way from there.

Lines are drawn on the 2 x 4 dots of a Braille character where the terminal knows Unicode, else on whole characters.
Big letters are readable from three metres: five by seven dots, two columns and one row each.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import tomli
from numpy.typing import NDArray

from imufield.drawing.box import HALF_SIZE, ONLOOKER, visible_faces
from imufield.samples import AXES, FloatArray

_DOTS = 6  # Of a letter, side by side: five and a gap.
_DOT_WIDTH = 2  # A character is twice as high as wide.
LETTER_WIDTH = _DOTS * _DOT_WIDTH
LETTERS = 6
"""Of the longest words."""
ROWS = 7


@cache
def _letters() -> dict[str, bytes]:
    """Return five columns of each letter, the lowest bit on top, and the gap after it."""
    table = tomli.loads((Path(__file__).parent / "letters.toml").read_text(encoding="utf-8"))
    return {letter: bytes.fromhex(columns) + b"\0" for letter, columns in table.items()}


def big_lines(text: str, width: int, times: int = 1) -> list[str]:
    """Return a word in big letters, cut off at the width; a character without a shape becomes a space.

    Parameters
    ----------
    text : str
    width : int
        Characters of the screen.
    times : int
        Size, in that of the smallest letters.
    """
    # Narrow letters are better than a word without its end.
    dot_width = _DOT_WIDTH * times if width >= LETTERS * LETTER_WIDTH else 1
    letters = text.upper()[: width // (_DOTS * dot_width)]
    dots = b"".join(_letters().get(letter, bytes(_DOTS)) for letter in letters)
    dot, blank = "#" * dot_width, " " * dot_width
    lines = ["".join(dot if column >> row & 1 else blank for column in dots).rstrip() for row in range(ROWS)]
    return [line for line in lines for _ in range(times)]


_BRAILLE = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_REACH = 1.42  # Screen units from the middle to the edge: half the diagonal of the box and room for the cable.
_CABLE_LENGTH = 0.55
_LABEL_WIDTH = 3  # Columns from one name to the next.


def draw_box(attitude: FloatArray, width: int, height: int, *, cable: str | None = None, ascii_only: bool = False) -> list[str]:
    """Return the lines of a picture of the box.

    Parameters
    ----------
    attitude : ndarray, shape (3, 3)
        See ``imufield.drawing.box.turn_shortest``.
    width, height : int
        Characters.
    cable : str, optional
        Face where the cable leaves, e.g. "-x".
    ascii_only : bool
        Draw with ASCII.
    """
    canvas = _Canvas(width, height, dots=not ascii_only)
    for face in visible_faces(attitude):
        for start, end in zip(face.corners, np.roll(face.corners, -1, axis=0), strict=True):
            canvas.line(start, end)
        canvas.label(face.corners.mean(axis=0), face.name)
    if cable is not None:
        view = ONLOOKER @ attitude
        axis, sign = AXES.index(cable[1]), 1.0 if cable[0] == "+" else -1.0
        foot = np.eye(3)[axis] * sign * HALF_SIZE[axis]
        end = foot + np.eye(3)[axis] * sign * _CABLE_LENGTH
        hidden = (view @ foot)[1] > 0
        canvas.line(view @ foot, view @ end, dashed=hidden)
        canvas.label(view @ end, "cable", free=True)
    return canvas.lines()


def characters(dots: NDArray[np.bool_], down: int) -> list[list[str]]:
    """Return dots as characters: 4 by 2 of them as one of Braille where ``down`` is 4, else a point each."""
    if down == 1:
        return [["." if dot else " " for dot in row] for row in dots]
    blocks = dots.reshape(dots.shape[0] // 4, 4, dots.shape[1] // 2, 2)
    codes = np.einsum("rdcs,ds->rc", blocks, np.array(_BRAILLE))
    return [[chr(0x2800 + int(code)) if code else " " for code in row] for row in codes]


class _Canvas:
    """Dots and labels on a grid of characters."""

    def __init__(self, width: int, height: int, *, dots: bool) -> None:
        self._across, self._down = (2, 4) if dots else (1, 1)
        self._shape = (height * self._down, width * self._across)
        self._dots = np.zeros(self._shape, dtype=bool)
        self._width, self._height = width, height
        self._labels: list[tuple[int, int, str]] = []
        # A character is twice as high as wide: with 2 x 4 dots they are square, without, they are not.
        self._aspect = 1.0 if dots else 2.0
        self._scale = min(self._shape[1] / 2 / self._aspect, self._shape[0] / 2) / _REACH

    def _place(self, point: FloatArray) -> tuple[float, float]:
        row = (self._shape[0] - 1) / 2 - point[2] * self._scale
        column = (self._shape[1] - 1) / 2 + point[0] * self._scale * self._aspect
        return row, column

    def line(self, start: FloatArray, end: FloatArray, *, dashed: bool = False) -> None:
        (r0, c0), (r1, c1) = self._place(start), self._place(end)
        steps = int(max(abs(r1 - r0), abs(c1 - c0))) + 1
        part = np.linspace(0, 1, steps + 1)
        if dashed:
            part = part[np.arange(len(part)) % 4 < 2]
        rows = np.rint(r0 + (r1 - r0) * part).astype(int)
        columns = np.rint(c0 + (c1 - c0) * part).astype(int)
        inside = (rows >= 0) & (rows < self._shape[0]) & (columns >= 0) & (columns < self._shape[1])
        self._dots[rows[inside], columns[inside]] = True

    def label(self, point: FloatArray, text: str, *, free: bool = False) -> None:
        row, column = self._place(point)
        line = min(max(round((row - self._down / 2 + 0.5) / self._down), 0), self._height - 1)
        place = min(max(round(column / self._across - len(text) / 2), 0), self._width - len(text))
        # A name that has no room is left out; one that stands beside the box moves to the next line.
        for there in (line, line + 1, line - 1) if free else (line,):
            beside = [begin for other, begin, _ in self._labels if other == there]
            taken = any(begin - len(text) <= place < begin + _LABEL_WIDTH for begin in beside)
            if 0 <= there < self._height and not taken:
                self._labels.append((there, place, text))
                return

    def lines(self) -> list[str]:
        rows = characters(self._dots, self._down)
        for row, column, text in self._labels:
            rows[row][column : column + len(text)] = text
        return ["".join(row) for row in rows]
