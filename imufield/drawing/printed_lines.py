"""Lines of words for a terminal: wrapped, or cells below each other. What controls a terminal in them is shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from unicodedata import combining, east_asian_width

from imufield.sentences import printable

Line = list[tuple[str, str]]
"""Words of a line, each with the style that rich gives them on a terminal."""


def columns(text: str) -> int:
    """Return how wide a text is; Chinese and Japanese characters take two columns, marks above a letter none."""
    if text.isascii():
        return len(text)
    return sum(0 if combining(character) else 1 + (east_asian_width(character) in "WF") for character in text)


def wrapped(parts: Line, width: int, indent: int = 0) -> Iterator[Line]:
    """Yield the parts, with blanks between them, in lines of that width: words whole, lines below the first indented."""
    line, column = Line(), 0
    for word, style in [(word, style) for words, style in parts for word in printable(words).split(" ")]:
        if line and column + columns(word) > width:
            yield line
            line, column = [(" " * indent, "")], indent
        before = line.pop()[0] if line and line[-1][1] == style else ""
        line.append((f"{before}{word} ", style))
        column += columns(word) + 1
    yield line


def aligned(rows: Sequence[Line], places: str, least: Sequence[int] | None = None) -> Iterator[Line]:
    """Yield rows with their cells below each other, "<" at the left and ">" at the right, as wide as ``least`` or wider."""
    rows = [[(printable(words), style) for words, style in row] for row in rows]
    least = least or [0] * len(places)
    widths = [max([width, *(columns(row[k][0]) for row in rows if k < len(row))]) for k, width in enumerate(least)]
    for row in rows:
        blanks = [" " * (width - columns(words)) for width, (words, _) in zip(widths, row, strict=False)]
        cells = zip(row, blanks, places, strict=False)
        yield [(f"{words}{blank} " if place == "<" else f"{blank}{words} ", style) for (words, style), blank, place in cells]
