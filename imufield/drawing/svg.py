"""Simple plots as the text of an ``<svg>`` element, in the style of ``style``: to import matplotlib takes as long as a report.

Lengths are points of print, x to the right and y downwards, as in SVG; data have y upwards.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from html import escape

import numpy as np

from imufield.dataclass import dataclass, field
from imufield.drawing.style import FEW_DECADES, GREY, INK, WIDTH_IN
from imufield.samples import FloatArray

POINTS_PER_INCH = 72.0
FONT_PT = 9.0
SMALL_PT = 7.5
"""The smallest that is read on paper without a glass."""
_FONTS = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"
_LETTER = 0.58  # Mean width of a letter over the size of its font.
_GRID = "#dddddd"
_MARGIN = 0.05  # Of the range of data, at both ends, so that marks stand inside.
_TICK_PT = 3.0
_LEFT_PT = 46.0  # Numbers and label of a vertical axis.
_RIGHT_PT = 6.0
_BOTTOM_PT = 30.0  # Those of a horizontal one.
_LEGEND_PT = 18.0
_MOST_ACROSS = 10
_MOST_UPWARDS = 6
_LONGEST_NUMBER = 6  # Characters.
_MOST_LEVEL_NAMES = 8  # More are turned, so that they do not touch each other.
_MOST_DECADES = 7  # Numbers of more would touch each other on the lowest of our pictures.


@dataclass(frozen=True, slots=True)
class Scale:
    """Where numbers lie along an axis."""

    low: float
    high: float
    is_logarithmic: bool = False

    @classmethod
    def over(cls, *values: FloatArray, low: float | None = None, is_logarithmic: bool = False) -> Scale:
        """Return a scale for all finite values; ``low`` is where it begins, else below the smallest."""
        known = np.concatenate([np.ravel(some) for some in values])
        known = known[np.isfinite(known)] if np.isfinite(known).any() else np.ones(1)
        ends = np.array([known.min() if low is None else low, known.max()], dtype=np.float64)
        if is_logarithmic:
            ends = np.log10(ends)
        room = _MARGIN * (float(np.ptp(ends)) or max(abs(float(ends[1])), 1.0))
        ends += [0.0 if low is not None else -room, room]
        if is_logarithmic:
            ends = 10**ends
        return cls(float(ends[0]), float(ends[1]), is_logarithmic)

    def share(self, values: FloatArray | float) -> FloatArray:
        """Return 0 at the low end and 1 at the high one."""
        low, high = self.low, self.high
        if self.is_logarithmic:
            values, low, high = np.log10(values), math.log10(low), math.log10(high)
        return np.asarray((values - low) / (high - low), dtype=np.float64)

    def ticks(self, most: int) -> Iterator[tuple[float, str]]:
        """Yield round numbers as they are written: of a logarithmic scale decades, of a short or other one ``most`` at most."""
        if self.is_logarithmic:
            lowest, highest = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
            parts = (1, 2, 5) if self.high < self.low * 10.0**FEW_DECADES else (1,)
            every = 1 + (highest - lowest) // _MOST_DECADES
            numbers = [part * 10.0**decade for decade in range(lowest, highest + 1, every) for part in parts]
            shown = [number for number in numbers if self.low <= number <= self.high]
            # A range so short that it holds fewer is nearly linear.
            if len(shown) > 1:
                yield from ((number, f"{number:g}") for number in shown)
                return
        least = (self.high - self.low) / most
        decade = 10.0 ** math.floor(math.log10(least))
        step = next(part * decade for part in (1, 2, 5, 10) if part * decade >= least)
        digits = max(0, -math.floor(math.log10(step)))
        for count in range(math.ceil(self.low / step), math.floor(self.high / step) + 1):
            text = f"{count * step:.{digits}f}"
            # Longer numbers would cover the label of the axis.
            text = text if len(text.lstrip("-")) <= _LONGEST_NUMBER else f"{count * step:g}"
            yield count * step, text.replace("-", "\N{MINUS SIGN}")


@dataclass(slots=True)
class Picture:
    """A drawing of the page's width, in the order in which its parts are added."""

    height_in: float
    parts: list[str] = field(default_factory=list)

    @property
    def width(self) -> float:
        """In points."""
        return WIDTH_IN * POINTS_PER_INCH

    @property
    def height(self) -> float:
        """In points."""
        return self.height_in * POINTS_PER_INCH

    def line(self, x: FloatArray, y: FloatArray, *, color: str, width: float, dashes: str = "") -> None:
        """Join points; one that is not finite parts the line."""
        path, is_parted = [], True
        for one, other in zip(x.tolist(), y.tolist(), strict=True):
            if math.isfinite(one + other):
                path.append(f"{'M' if is_parted else 'L'}{one:.2f} {other:.2f}")
            is_parted = not math.isfinite(one + other)
        dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
        self.parts.append(f'<path d="{"".join(path)}" fill="none" stroke="{color}" stroke-width="{width:g}"{dashed}/>')

    def area(self, x: FloatArray, low: FloatArray, high: FloatArray, *, face: str, opacity: float) -> None:
        """Fill the area between two lines, as far as both are known."""
        known = np.isfinite(low) & np.isfinite(high)
        x, y = np.concatenate([x[known], x[known][::-1]]), np.concatenate([low[known], high[known][::-1]])
        points = " ".join(f"{across:.2f},{down:.2f}" for across, down in zip(x.tolist(), y.tolist(), strict=True))
        self.parts.append(f'<polygon points="{points}" fill="{face}" fill-opacity="{opacity:g}"/>')

    def mark(self, x: float, y: float, radius: float, *, face: str, edge: str, shape: str = "o", width: float = 1.0) -> None:
        """Put a circle ``o``, a square ``s`` or a cross ``x`` at a point."""
        if shape == "o":
            form = f'circle cx="{x:.2f}" cy="{y:.2f}" r="{radius:.2f}"'
        elif shape == "s":
            form = f'rect x="{x - radius:.2f}" y="{y - radius:.2f}" width="{2 * radius:.2f}" height="{2 * radius:.2f}"'
        else:
            reach = f"l{2 * radius:.2f} {2 * radius:.2f}m0 {-2 * radius:.2f}l{-2 * radius:.2f} {2 * radius:.2f}"
            form = f'path d="M{x - radius:.2f} {y - radius:.2f}{reach}"'
        self.parts.append(f'<{form} fill="{face}" fill-opacity="0.85" stroke="{edge}" stroke-width="{width:g}"/>')

    def box(self, x: float, y: float, width: float, height: float, *, face: str, edge: str = "none") -> None:
        """Fill a rectangle whose upper left corner this is."""
        place = f'x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}"'
        self.parts.append(f'<rect {place} fill="{face}" stroke="{edge}" stroke-width="0.5"/>')

    def text(
        self,
        x: float,
        y: float,
        words: str,
        *,
        size: float = FONT_PT,
        color: str = INK,
        anchor: str = "middle",
        turned: bool = False,
    ) -> None:
        """Write in one line, about the height of its middle; ``turned`` reads upwards."""
        # Half the height of small letters below the middle.
        place = f'transform="translate({x:.2f} {y:.2f}){" rotate(-90)" if turned else ""}" y="{0.35 * size:.2f}"'
        self.parts.append(f'<text {place} text-anchor="{anchor}" font-size="{size:g}" fill="{color}">{escape(words)}</text>')

    def svg(self) -> str:
        """Return the element."""
        view = f"0 0 {self.width:g} {self.height:g}"
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{view}" font-family="{_FONTS}">'
        return "\n".join([head, *self.parts, "</svg>"])


@dataclass(slots=True, kw_only=True)
class Axes:
    """A pair of axes in a picture, and what is drawn by their numbers."""

    picture: Picture
    x: Scale
    y: Scale
    top: float = _LEGEND_PT
    bottom: float = _BOTTOM_PT
    """Distances of the frame from the edges of the picture."""
    side: tuple[float, float] = (0.0, 1.0)
    """From where to where it reaches across the picture."""

    @property
    def _floor(self) -> float:
        return self.picture.height - self.bottom

    @property
    def _left(self) -> float:
        return self.side[0] * self.picture.width + _LEFT_PT

    @property
    def _right(self) -> float:
        return self.side[1] * self.picture.width - _RIGHT_PT

    def place(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points of the picture."""
        return self.across(x), self.down(y)

    def across(self, x: FloatArray | float) -> FloatArray:
        """Return where numbers stand along the picture."""
        return self._left + (self._right - self._left) * self.x.share(x)

    def down(self, y: FloatArray | float) -> FloatArray:
        """Return how far numbers are from the top of the picture."""
        return self._floor - (self._floor - self.top) * self.y.share(y)

    def frame(self, x_label: str, y_label: str, *, names: Sequence[str] | None = None, with_numbers: bool = True) -> None:
        """Draw grid, axes and their numbers; ``names`` stand for the numbers 0, 1, ... of the horizontal one."""
        left, right = self._left, self._right
        ticks = self.x.ticks(round(_MOST_ACROSS * (self.side[1] - self.side[0]))) if names is None else enumerate(names)
        is_turned = names is not None and len(names) > _MOST_LEVEL_NAMES
        for number, words in ticks:
            at = float(self.across(number))
            self._rule(at, self.top, at, self._floor, color=_GRID)
            self._rule(at, self._floor, at, self._floor + _TICK_PT, color=INK)
            if with_numbers:
                size, below = (FONT_PT, 10.0) if names is None else (SMALL_PT, 5.0 if is_turned else 8.0)
                anchor = "end" if is_turned else "middle"
                self.picture.text(at, self._floor + below, words, size=size, anchor=anchor, turned=is_turned)
        for number, words in self.y.ticks(_MOST_UPWARDS):
            at = float(self.down(number))
            self._rule(left, at, right, at, color=_GRID)
            self._rule(left - _TICK_PT, at, left, at, color=INK)
            self.picture.text(left - 5, at, words, anchor="end")
        self._rule(left, self.top, left, self._floor, color=INK)
        self._rule(left, self._floor, right, self._floor, color=INK)
        self.picture.text(left - _LEFT_PT + FONT_PT / 2 + 1, (self.top + self._floor) / 2, y_label, turned=True)
        self.picture.text((left + right) / 2, self.picture.height - FONT_PT / 2 - 2, x_label)

    def _rule(self, x: float, y: float, to_x: float, to_y: float, *, color: str) -> None:
        self.picture.line(np.array([x, to_x]), np.array([y, to_y]), color=color, width=0.6)

    def curve(self, x: FloatArray, y: FloatArray, *, color: str, width: float = 1.3, dashes: str = "") -> None:
        """Join points."""
        self.picture.line(*self.place(x, y), color=color, width=width, dashes=dashes)

    def band(self, x: FloatArray, low: FloatArray, high: FloatArray, *, color: str, opacity: float = 0.12) -> None:
        """Shade the area between two curves."""
        self.picture.area(self.across(x), self.down(low), self.down(high), face=color, opacity=opacity)

    def stems(self, x: FloatArray, low: FloatArray, high: FloatArray) -> None:
        """Draw upright lines."""
        gap = np.full_like(low, np.nan)
        self.curve(np.repeat(x, 3), np.column_stack([low, high, gap]).ravel(), color=GREY, width=0.8)

    def marks(self, x: FloatArray, y: FloatArray, shape: str, color: str, *, is_filled: bool) -> None:
        """Put marks at points that are known."""
        for one, other in zip(*self.place(x, y), strict=True):
            if math.isfinite(other):
                self.picture.mark(one, other, 2.4, face=color if is_filled else "white", edge=color, shape=shape)

    def bars(self, x: FloatArray, low: FloatArray, high: FloatArray) -> None:
        """Draw bars about numbers one apart."""
        (left, top), (right, bottom) = self.place(x - 0.4, high), self.place(x + 0.4, low)
        for corner in np.column_stack([left, top, right - left, bottom - top])[np.isfinite(high)]:
            self.picture.box(*corner, face="#eeeeee", edge=GREY)

    def level(self, value: float) -> None:
        """Draw a line across."""
        self.curve(np.array([self.x.low, self.x.high]), np.full(2, value), color=INK, width=0.8)

    def shade(self, low: FloatArray, high: FloatArray) -> None:
        """Shade ranges of x over the whole height."""
        for begin, end in zip(self.across(low), self.across(high), strict=True):
            self.picture.box(begin, self.top, end - begin, self._floor - self.top, face="#dbe6f2", edge=GREY)

    def legend(self, entries: Iterable[tuple[str, str, str]]) -> None:
        """Say above the frame what is what: words, color, and a shape of ``Picture.mark``, "bar" or dashes."""
        at, y = self._left + 8.0, self.top - _LEGEND_PT / 2
        for words, color, look in entries:
            if look in ("o", "s", "x"):
                self.picture.mark(at + 8, y, 2.4, face="white" if look == "s" else color, edge=color, shape=look)
            elif look == "bar":
                self.picture.box(at, y - 4, 16, 8, face="#eeeeee", edge=color)
            else:
                self.picture.line(np.array([at, at + 16]), np.array([y, y]), color=color, width=1.3, dashes=look)
            self.picture.text(at + 21, y, words, size=8, anchor="start")
            at += 36 + text_width(words, 8)


def text_width(words: str, size: float) -> float:
    """Return about how long a text is, in points."""
    return _LETTER * size * len(words)
