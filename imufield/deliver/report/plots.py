"""The plots of a report as SVG text."""

from __future__ import annotations

import math

import numpy as np

from imufield.deliver.navigation.drift import QUANTITIES
from imufield.deliver.parameters.printed_numbers import acceleration_unit
from imufield.deliver.parameters.schema import Document
from imufield.deliver.report.correlations import Correlations
from imufield.deliver.report.data import Closure, Convergence
from imufield.deliver.report.gain import Gain
from imufield.deliver.report.over_temperature import TemperatureCurves
from imufield.deliver.report.positions import short_name
from imufield.deliver.report.stillness_trace import Trace
from imufield.drawing.style import BLUE, GREY, INK, ORANGE
from imufield.drawing.svg import FONT_PT, POINTS_PER_INCH, SMALL_PT, Axes, Picture, Scale, text_width
from imufield.earth import MILLI_G_M_S2
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_TALLEST_IN = 8.5  # With title and caption on one sheet.
# Of each error, and the size of its unit.
_LABELS = {
    "latitude_deg": ("latitude, arcmin", 1 / 60),
    "longitude_deg": ("longitude, arcmin", 1 / 60),
    "north_velocity_m_s": ("v north, m/s", 1.0),
    "east_velocity_m_s": ("v east, m/s", 1.0),
    "position_nmi": ("position, nmi", 1.0),
}
LEAST_CORRELATION = 0.1
"""Weaker ones are not drawn: they change no sigma by more than half a per cent."""
_LARGEST_MARKER = 260.0  # Points^2, as matplotlib measures marks.
_POINTS_PER_UNIT = 82.0  # Of the sphere map: its radius.
_DOWN = np.array([1.0, -1.0])  # The map has y upwards, a picture downwards.
_CELL_PT = 12.2  # Of a correlation: a line of names.
_PANEL_FOOT_PT = 30.0  # Below the lowest of two panels.
_ROW_PT = 118.0  # Height of one of several rows of panels.
_ROW_GAP_PT = 4.0  # Above and below the frames in it.
_NUMBERS_PT = 14.0  # Numbers of a horizontal axis.
_LEGEND_ROOM_PT = 26.0  # Above a frame with a legend.
# Just outside the unit circle of the map.
_AXIS_NAMES = (("+x", 1.2, 0.0), ("-x", -1.2, 0.0), ("+y", 0.0, 1.24), ("-y", 0.0, -1.2))
_NAMED = 6  # Positions named on the sphere map, the largest residuals first.


def sphere_map(up: FloatArray, residual_m_s2: FloatArray, names: tuple[str, ...]) -> str:
    """Draw residuals on both halves of the sphere of directions, equal areas, seen along the body's z axis.

    Parameters
    ----------
    up : ndarray, shape (m, 3)
        Direction of "up" in the body frame.
    residual_m_s2 : ndarray, shape (m,)
        NaN where it is not known; such a position has no mark.
    names : tuple of str
    """
    largest = float(np.nanmax(np.abs(residual_m_s2), initial=1e-12))
    named = set(np.argsort(-np.abs(residual_m_s2))[:_NAMED].tolist())
    drawn = Picture(3.7)
    for middle, upper in zip((0.25, 0.75), (True, False), strict=True):
        # The same size of both halves, so that marks of one size mean one residual.
        centre = np.array([middle * drawn.width, 0.52 * drawn.height])
        _hemisphere(drawn, centre, upper)
        rows = np.flatnonzero(((up[:, 2] >= 0) == upper) & np.isfinite(residual_m_s2))
        place = _equal_area(up[rows]) * _POINTS_PER_UNIT
        radius = np.sqrt(12 + _LARGEST_MARKER * np.abs(residual_m_s2[rows]) / largest) / 2
        for at, size, residual in zip(centre + place * _DOWN, radius, residual_m_s2[rows], strict=True):
            drawn.mark(at[0], at[1], size, face=INK if residual >= 0 else "white", edge=INK)
        shown = {row: names[k] for row, k in enumerate(rows) if k in named}
        marks = np.vstack([place, *(np.array(at) * _POINTS_PER_UNIT for _, *at in _AXIS_NAMES)])
        around = np.append(radius, [SMALL_PT / 2] * len(_AXIS_NAMES))
        for row, offset in label_offsets(marks, around, shown).items():
            _label(drawn, centre + place[row] * _DOWN, offset * _DOWN, shown[row])
    unit, size_si = acceleration_unit(largest)
    words = sentence("plots.sphere", largest=largest / size_si, unit=unit)
    drawn.text(drawn.width / 2, drawn.height - FONT_PT, words, size=8)
    return drawn.svg()


def _label(drawn: Picture, mark: FloatArray, offset: FloatArray, words: str) -> None:
    """Write a name beside a mark, with a line to it."""
    (x, y), half = mark + offset, text_width(words, SMALL_PT) / 2
    drawn.line(np.array([mark[0], x]), np.array([mark[1], y]), color=GREY, width=0.4)
    drawn.box(x - half, y - SMALL_PT / 2, 2 * half, SMALL_PT, face="white")
    drawn.text(x, y, words, size=SMALL_PT)


def label_offsets(place: FloatArray, radius: FloatArray, names: dict[int, str]) -> dict[int, FloatArray]:
    """Return where to put the middle of each name beside its mark, so that it covers no mark and no other name.

    Parameters
    ----------
    place : ndarray, shape (n, 2)
        Marks, in points of print.
    radius : ndarray, shape (n,)
        Of the marks, points.
    names : dict
        Of some of the rows.
    """
    taken = [np.array([*(at - half), *(at + half)]) for at, half in zip(place, radius, strict=True)]
    offsets: dict[int, FloatArray] = {}
    # Above and below first, where names of one line cover least; then ever further aside.
    angles = np.radians(90 + 30 * np.array([0, 6, 1, -1, 5, -5, 2, -2, 4, -4, 3, -3]))
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    for row, name in names.items():
        half = np.array([text_width(name, SMALL_PT) / 2, 0.6 * SMALL_PT])
        best, least = np.zeros(2), np.inf
        # Points beside the mark; the first that covers nothing is taken.
        for reach in (1.0, 8.0, 16.0, 28.0):
            for direction in directions:
                offset = direction * (radius[row] + reach + half)
                box = np.array([*(place[row] + offset - half), *(place[row] + offset + half)])
                covered = sum(_overlap(box, other) for other in taken)
                if covered < least:
                    best, least = offset, covered
        offsets[row] = best
        taken.append(np.array([*(place[row] + best - half), *(place[row] + best + half)]))
    return offsets


def _overlap(a: FloatArray, b: FloatArray) -> float:
    """Return the area that two boxes (left, bottom, right, top) share."""
    sides = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    return float(np.prod(np.maximum(sides, 0.0)))


def _hemisphere(drawn: Picture, centre: FloatArray, upper: bool) -> None:
    angle = np.linspace(0, 2 * np.pi, 181)
    for tilt, dashes in ((90, ""), (45, "1 2")):
        radius = _POINTS_PER_UNIT * np.sqrt(2) * np.sin(np.radians(tilt) / 2)
        circle = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
        drawn.line(*circle, color=GREY, width=0.8, dashes=dashes)
    for label, x, y in _AXIS_NAMES:
        at = centre + np.array([x, y]) * _DOWN * _POINTS_PER_UNIT
        drawn.text(at[0], at[1], label, size=8, color=GREY)
    drawn.text(centre[0], FONT_PT, "z axis up or level" if upper else "z axis down")


def _equal_area(up: FloatArray) -> FloatArray:
    """Return Lambert's azimuthal projection about the nearer pole, the equator at radius 1, shape (m, 2)."""
    flat = np.hypot(up[:, 0], up[:, 1])
    radius = np.sqrt(np.maximum(1 - np.abs(up[:, 2]), 0.0))
    direction: FloatArray = up[:, :2] / np.where(flat > 0, flat, 1.0)[:, None]
    return np.asarray(radius[:, None] * direction)


def before_and_after(gained: Gain) -> str:
    """Draw the error of each position before and after, on one scale."""
    at = np.arange(float(len(gained.names)))
    before, after = gained.before_m_s2 / MILLI_G_M_S2, gained.after_m_s2 / MILLI_G_M_S2
    drawn = Picture(2.1)
    axes = _position_axes(drawn, gained.names, "error, mg", Scale.over(before, after, np.zeros(1)))
    axes.stems(at, after, before)
    axes.level(0.0)
    axes.marks(at, before, "s", ORANGE, is_filled=False)
    axes.marks(at, after, "o", BLUE, is_filled=True)
    axes.legend([("before", ORANGE, "s"), ("after", BLUE, "o")])
    return drawn.svg()


def left_out(document: Document) -> str:
    """Draw residuals of left-out positions against their forecast."""
    residual, sigma, before = (_numbers(document[key]) for key in ("residual_m_s2", "sigma_m_s2", "before_m_s2"))
    unit, size = acceleration_unit(float(np.nanmax(np.abs(np.concatenate([residual, 2 * sigma])), initial=0.0)))
    inside = np.abs(before) <= 1.5 * max(np.nanmax(np.abs(residual), initial=0.0), np.nanmax(2 * sigma, initial=0.0))
    with_before = bool(np.all(inside))
    values = (residual, 2 * sigma, -2 * sigma, *([before] if with_before else []))
    at = np.arange(float(len(residual)))
    drawn = Picture(2.5)
    axes = _position_axes(drawn, tuple(document["name"]), unit, Scale.over(*(some / size for some in values)))
    axes.bars(at, -2 * sigma / size, 2 * sigma / size)
    axes.level(0.0)
    axes.marks(at, residual / size, "o", INK, is_filled=True)
    entries = [("forecast, ±2 sigma", GREY, "bar"), ("residual", INK, "o")]
    if with_before:
        axes.marks(at, before / size, "x", ORANGE, is_filled=False)
        entries.append(("before", ORANGE, "x"))
    axes.legend(entries)
    return drawn.svg()


def _position_axes(drawn: Picture, names: tuple[str, ...], unit: str, y: Scale) -> Axes:
    short = [short_name(name) for name in names]
    # Room for eight at least: three marks alone would stand at the margins.
    axes = Axes(
        picture=drawn,
        x=Scale(-0.7, max(len(names), 8) - 0.3),
        y=y,
        bottom=10 + max((text_width(name, SMALL_PT) for name in short), default=0.0),
    )
    axes.frame("", unit, names=short)
    return axes


def stillness(trace: Trace, start_s: FloatArray, duration_s: FloatArray) -> str:
    """Draw how still the instrument was, and where positions were taken."""
    with_rate = bool(np.isfinite(trace.rate_rad_s).any())
    drawn = Picture(3.2 if with_rate else 2.2)
    minutes = trace.time_s / 60
    panels = [("scatter, mg", trace.scatter_m_s2 / MILLI_G_M_S2)]
    if with_rate:
        panels.append(("turning, °/s", np.degrees(trace.rate_rad_s)))
    height = (drawn.height - _PANEL_FOOT_PT) / len(panels)
    for number, (label, values) in enumerate(panels):
        shown = np.maximum(values, 1e-3)
        is_last = number == len(panels) - 1
        axes = Axes(
            picture=drawn,
            x=Scale.over(minutes),
            y=Scale.over(shown, is_logarithmic=True),
            top=number * height + 4,
            bottom=_PANEL_FOOT_PT + (len(panels) - 1 - number) * height,
        )
        axes.shade(start_s / 60, (start_s + duration_s) / 60)
        axes.frame("minutes; shaded: taken as a position" if is_last else "", label, with_numbers=is_last)
        axes.curve(minutes, shown, color=INK, width=0.8)
    return drawn.svg()


def convergence(run: Convergence) -> str:
    """Draw how a method of the papers came down to its best cost."""
    drawn = Picture(2.3)
    # The last excess is zero, which a logarithm cannot show.
    excess = np.maximum(run.excess, 1e-9)
    iterations = np.arange(1.0, len(excess) + 1)
    axes = Axes(picture=drawn, x=Scale.over(iterations, is_logarithmic=True), y=Scale.over(excess, is_logarithmic=True))
    axes.frame("iteration", "cost over best, less 1")
    axes.curve(iterations, excess, color=INK)
    axes.legend([(f"{run.method}, {run.evaluations} evaluations", INK, "")])
    return drawn.svg()


def closure(moves: Closure) -> str:
    """Draw how far each move ends from where gravity says."""
    minutes, with_before = moves.start_s / 60, bool(np.isfinite(moves.before_deg).all())
    drawn = Picture(2.3)
    shown = [moves.after_deg, *([moves.before_deg] if with_before else [])]
    # From zero: the height of a mark is to be read as the error itself.
    axes = Axes(picture=drawn, x=Scale.over(minutes), y=Scale.over(*shown, low=0.0))
    axes.frame("minutes, start of the move", "closing error, °")
    if with_before:
        axes.stems(minutes, moves.before_deg, moves.after_deg)
        axes.marks(minutes, moves.before_deg, "s", ORANGE, is_filled=False)
    axes.marks(minutes, moves.after_deg, "o", INK, is_filled=True)
    axes.legend([*([("before", ORANGE, "s")] if with_before else []), ("after", INK, "o")])
    return drawn.svg()


def over_temperature(curves: TemperatureCurves) -> str:
    """Draw how bias and scale of a triad change with temperature, what sessions found, and where a new day will be."""
    drawn = Picture(2.6)
    styles = list(zip(AXES, (INK, BLUE, ORANGE), ("", "6 3", "1.5 2"), "osx", strict=True))
    for quantity, side in ((curves.bias, (0.0, 0.5)), (curves.scale, (0.5, 1.0))):
        half = quantity.factor * quantity.sigma
        reach = (quantity.change - half, quantity.change + half, quantity.change, quantity.sessions)
        across = Scale.over(curves.temperature_degc, curves.sessions_degc)
        axes = Axes(picture=drawn, x=across, y=Scale.over(*reach), side=side)
        axes.frame("temperature, °C", f"{quantity.quantity}, {quantity.unit}")
        axes.stems(np.array([curves.reference_degc]), np.array([axes.y.low]), np.array([axes.y.high]))
        for axis, (_, color, dashes, shape) in enumerate(styles):
            axes.band(curves.temperature_degc, reach[0][:, axis], reach[1][:, axis], color=color)
            axes.curve(curves.temperature_degc, quantity.change[:, axis], color=color, dashes=dashes)
            axes.marks(curves.sessions_degc, quantity.sessions[:, axis], shape, color, is_filled=False)
        if quantity is curves.bias:
            axes.legend([(name, color, dashes) for name, color, dashes, _ in styles])
    return drawn.svg()


def correlations(pairs: Correlations) -> str:
    """Draw the correlation of each pair of parameters below the diagonal."""
    n = len(pairs.names)
    room = 8 + max(text_width(name, SMALL_PT) for name in pairs.names)
    cell = min(_CELL_PT, (_TALLEST_IN * POINTS_PER_INCH - room) / n)
    drawn = Picture((n * cell + room) / POINTS_PER_INCH)
    left, side = (drawn.width - n * cell + room) / 2, n * cell
    for k, name in enumerate(pairs.names):
        at = (k + 0.5) * cell
        drawn.line(np.array([left + at, left + at]), np.array([0, side]), color="#dddddd", width=0.5)
        drawn.line(np.array([left, left + side]), np.array([at, at]), color="#dddddd", width=0.5)
        drawn.text(left - 5, at, name, size=SMALL_PT, anchor="end")
        drawn.text(left + at, side + 5, name, size=SMALL_PT, anchor="end", turned=True)
    drawn.line(np.array([left, left, left + side]), np.array([0, side, side]), color=INK, width=0.6)
    for row, column in zip(*np.tril_indices(n, -1), strict=True):
        value = pairs.matrix[row, column]
        if abs(value) >= LEAST_CORRELATION:
            place = left + (column + 0.5) * cell, (row + 0.5) * cell
            drawn.mark(*place, math.sqrt(40 * abs(value)) / 2, face=INK if value > 0 else "white", edge=INK, width=0.6)
    return drawn.svg()


def navigation(document: Document) -> str:
    """Draw the errors of static navigation and the band they should be in."""
    drawn, forecast = Picture(5.4), document.get("forecast")
    # The set under test is the last: it gets the full line, and the one before it the broken.
    styles = list(zip(reversed(document["drift"].items()), ((INK, ""), (ORANGE, "6 3")), strict=False))
    for number, quantity in enumerate((*QUANTITIES, "position_nmi")):
        label, size = _LABELS[quantity]
        is_last = quantity == "position_nmi"
        curves = [(_numbers(drift["time_s"]) / 3600, _numbers(drift[quantity]) / size, *style) for (_, drift), style in styles]
        hours = low = high = np.empty(0)
        if forecast is not None:
            hours, high = _numbers(forecast["time_s"]) / 3600, _numbers(forecast["position_95_nmi"])
            low = np.zeros_like(high)
            if not is_last:
                low, high = (_numbers(forecast[end][quantity]) / size for end in ("low", "high"))
        axes = Axes(
            picture=drawn,
            x=Scale.over(hours, *(time_h for time_h, *_ in curves)),
            y=Scale.over(low, high, *(values for _, values, *_ in curves)),
            top=_ROW_PT * (number // 2) + (_LEGEND_ROOM_PT if is_last else _ROW_GAP_PT),
            bottom=_PANEL_FOOT_PT if is_last else drawn.height - _ROW_PT * (number // 2 + 1) + _ROW_GAP_PT + _NUMBERS_PT,
            side=(0.0, 1.0) if is_last else (number % 2 / 2, number % 2 / 2 + 0.5),
        )
        axes.frame("hours" if is_last else "", label)
        if forecast is not None:
            axes.band(hours, low, high, color=GREY)
        for time_h, values, color, dashes in curves:
            axes.curve(time_h, values, color=color, dashes=dashes)
        if is_last:
            bands = [] if forecast is None else [("95 % forecast", GREY, "bar")]
            axes.legend([*((name, *style) for (name, _), style in styles), *bands])
    return drawn.svg()


def _numbers(values: list[float | None]) -> FloatArray:
    """Return an array of values from JSON, where null stands for NaN."""
    return np.array(values, dtype=np.float64)
