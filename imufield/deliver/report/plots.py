"""The plots of a report as SVG text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imufield.deliver.navigation.drift import QUANTITIES
from imufield.deliver.parameters.numbers import acceleration_unit
from imufield.deliver.parameters.schema import Document
from imufield.deliver.report.correlations import Correlations
from imufield.deliver.report.data import Closure, Convergence
from imufield.deliver.report.gain import Gain
from imufield.deliver.report.over_temperature import TemperatureCurves
from imufield.deliver.report.positions import short_name
from imufield.deliver.report.trace import Trace
from imufield.drawing.style import BLUE, GREY, INK, ORANGE, figure, plain_ticks, to_svg
from imufield.earth import MILLI_G_M_S2
from imufield.samples import AXES, FloatArray
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from matplotlib.axes import Axes

sentence = Sentences(__package__)

_TALLEST_IN = 8.5  # With title and caption on one sheet.
_LABELS = {
    "latitude_deg": "latitude, deg",
    "longitude_deg": "longitude, deg",
    "north_velocity_m_s": "v north, m/s",
    "east_velocity_m_s": "v east, m/s",
}
LEAST_CORRELATION = 0.1
"""Weaker ones are not drawn: they change no sigma by more than half a per cent."""
_LARGEST_MARKER = 260.0  # Points^2, as matplotlib measures marks.
_LABEL_SIZE = 7.5  # Points; the smallest that is read on paper without a glass.
_POINTS_PER_UNIT = 82.0  # Of the sphere map as it is laid out: labels need no more than a rough idea of it.
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
    names : tuple of str
    """
    largest = float(np.nanmax(np.abs(residual_m_s2), initial=1e-12))
    named = set(np.argsort(-np.abs(residual_m_s2))[:_NAMED].tolist())
    drawn = figure(3.7)
    for axes, upper in zip(drawn.subplots(1, 2), (True, False), strict=True):
        _hemisphere(axes, upper)
        rows = np.flatnonzero((up[:, 2] >= 0) == upper)
        place = _equal_area(up[rows])
        sizes = 12 + _LARGEST_MARKER * np.abs(residual_m_s2[rows]) / largest
        faces = [INK if residual >= 0 else "white" for residual in residual_m_s2[rows]]
        axes.scatter(*place.T, s=sizes, facecolor=faces, edgecolor=INK, linewidth=1.0, alpha=0.85)
        shown = [row for row, k in enumerate(rows) if k in named]
        marks = np.vstack([place, *(at for _, *at in _AXIS_NAMES)]) * _POINTS_PER_UNIT
        radius = np.append(np.sqrt(sizes) / 2, [_LABEL_SIZE / 2] * len(_AXIS_NAMES))
        offsets = label_offsets(marks, radius, {row: names[rows[row]] for row in shown})
        for row, offset in offsets.items():
            axes.annotate(
                names[rows[row]], place[row], xytext=offset, textcoords="offset points", ha="center", va="center",
                fontsize=_LABEL_SIZE, arrowprops={"arrowstyle": "-", "linewidth": 0.4, "color": GREY},
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
            )  # fmt: skip
    unit, size_si = acceleration_unit(largest)
    drawn.supxlabel(sentence("plots.sphere", largest=largest / size_si, unit=unit), fontsize=8)
    return to_svg(drawn, "sphere")


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
        half = np.array([0.29 * len(name), 0.6]) * _LABEL_SIZE
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


def _hemisphere(axes: Axes, upper: bool) -> None:
    angle = np.linspace(0, 2 * np.pi, 181)
    for tilt, style in ((90, "-"), (45, ":")):
        radius = np.sqrt(2) * np.sin(np.radians(tilt) / 2)
        axes.plot(radius * np.cos(angle), radius * np.sin(angle), style, color=GREY, linewidth=0.8)
    for label, x, y in _AXIS_NAMES:
        axes.text(x, y, label, ha="center", va="center", fontsize=8, color=GREY)
    # The same limits on both halves, so that marks of one size mean one residual.
    axes.set(title="z axis up or level" if upper else "z axis down", aspect="equal", xlim=(-1.32, 1.32), ylim=(-1.32, 1.36))
    axes.axis("off")


def _equal_area(up: FloatArray) -> FloatArray:
    """Return Lambert's azimuthal projection about the nearer pole, the equator at radius 1, shape (m, 2)."""
    flat = np.hypot(up[:, 0], up[:, 1])
    radius = np.sqrt(np.maximum(1 - np.abs(up[:, 2]), 0.0))
    direction: FloatArray = up[:, :2] / np.where(flat > 0, flat, 1.0)[:, None]
    return np.asarray(radius[:, None] * direction)


def before_and_after(gained: Gain) -> str:
    """Draw the error of each position before and after, on one scale."""
    drawn = figure(2.1)
    axes = drawn.subplots()
    at = np.arange(len(gained.names))
    before, after = gained.before_m_s2 / MILLI_G_M_S2, gained.after_m_s2 / MILLI_G_M_S2
    axes.vlines(at, after, before, color=GREY, linewidth=0.8)
    axes.plot(at, before, "s", color=ORANGE, markerfacecolor="white", markersize=5, label="before")
    axes.plot(at, after, "o", color=BLUE, markersize=5, label="after")
    axes.axhline(0, color=INK, linewidth=0.8)
    _position_axis(axes, gained.names, "error, mg")
    return to_svg(drawn, "gain")


def left_out(document: Document) -> str:
    """Draw residuals of left-out positions against their forecast."""
    residual, sigma, before = (_numbers(document[key]) for key in ("residual_m_s2", "sigma_m_s2", "before_m_s2"))
    unit, size = acceleration_unit(float(np.nanmax(np.abs(np.concatenate([residual, 2 * sigma])), initial=0.0)))
    drawn = figure(2.5)
    axes = drawn.subplots()
    at = np.arange(len(residual))
    axes.bar(
        at, 4 * sigma / size, bottom=-2 * sigma / size, width=0.8, color="#eeeeee", edgecolor=GREY, hatch="////", linewidth=0.5,
        label="forecast, ±2 sigma",
    )  # fmt: skip
    axes.plot(at, residual / size, "o", color=INK, markersize=5, label="residual")
    axes.axhline(0, color=INK, linewidth=0.8)
    inside = np.abs(before) <= 1.5 * max(np.nanmax(np.abs(residual), initial=0.0), np.nanmax(2 * sigma, initial=0.0))
    if np.all(inside):
        axes.plot(at, before / size, "x", color=ORANGE, markersize=5, label="before")
    # Bars hold the axis at their ends; with a margin one sees that they end there.
    axes.use_sticky_edges = False
    axes.margins(y=0.08)
    _position_axis(axes, tuple(document["name"]), unit)
    return to_svg(drawn, "heldout")


def _position_axis(axes: Axes, names: tuple[str, ...], unit: str) -> None:
    axes.set_xticks(
        np.arange(len(names)), [short_name(name) for name in names], rotation=90 if len(names) > 8 else 0, fontsize=7
    )
    # Room for eight at least: three marks alone would stand at the margins.
    axes.set(xlim=(-0.7, max(len(names), 8) - 0.3), ylabel=unit)
    axes.legend(loc="upper left", bbox_to_anchor=(0, 1.22), ncols=3)


def stillness(trace: Trace, start_s: FloatArray, duration_s: FloatArray) -> str:
    """Draw how still the instrument was, and where positions were taken."""
    with_rate = bool(np.isfinite(trace.rate_rad_s).any())
    drawn = figure(3.2 if with_rate else 2.2)
    panels = drawn.subplots(2 if with_rate else 1, 1, sharex=True, squeeze=False)[:, 0]
    minutes = trace.time_s / 60
    end_s = start_s + duration_s
    sides = np.column_stack([start_s, start_s, end_s, end_s, end_s])
    panels[0].plot(minutes, np.maximum(trace.scatter_m_s2 / MILLI_G_M_S2, 1e-3), color=INK, linewidth=0.8)
    panels[0].set_ylabel("scatter, mg")
    if with_rate:
        rate = np.degrees(trace.rate_rad_s)
        panels[1].plot(minutes, np.maximum(rate, 1e-3), color=INK, linewidth=0.8)
        panels[1].set_ylabel("turning, °/s")
    for axes in panels:
        axes.set_yscale("log")
        plain_ticks(axes.yaxis)
        # One shape, parted by NaN: a PDF takes as long again for each shape with dots of its own.
        look = {"facecolor": "#e4edf6", "edgecolor": GREY, "hatch": "....", "linewidth": 0.3, "zorder": 0}
        axes.fill(sides.ravel() / 60, np.tile([0, 1, 1, 0, np.nan], len(sides)), transform=axes.get_xaxis_transform(), **look)
    panels[-1].set_xlabel("minutes; shaded: taken as a position")
    return to_svg(drawn, "stillness")


def convergence(runs: tuple[Convergence, ...]) -> str:
    """Draw how the methods of the papers came down to their best cost."""
    drawn = figure(2.3)
    axes = drawn.subplots()
    for run, style, color in zip(runs, ("-", "--", ":"), (INK, BLUE, ORANGE), strict=False):
        label = f"{run.method}, {run.evaluations} evaluations"
        # The last excess is zero, which a logarithm cannot show.
        axes.plot(np.arange(1.0, len(run.excess) + 1), np.maximum(run.excess, 1e-9), style, color=color, label=label)
    axes.set(xscale="log", yscale="log", xlabel="iteration", ylabel="cost over best, less 1")
    plain_ticks(axes.xaxis, axes.yaxis)
    axes.legend(loc="lower left")
    return to_svg(drawn, "convergence")


def closure(moves: Closure) -> str:
    """Draw how far each move ends from where gravity says."""
    drawn = figure(2.3)
    axes = drawn.subplots()
    minutes = moves.start_s / 60
    if np.isfinite(moves.before_deg).all():
        axes.vlines(minutes, moves.before_deg, moves.after_deg, color=GREY, linewidth=0.8)
        axes.plot(minutes, moves.before_deg, "s", color=ORANGE, markerfacecolor="white", markersize=4.5, label="before")
    axes.plot(minutes, moves.after_deg, "o", color=INK, markersize=4.5, label="after")
    # From zero: the height of a mark is to be read as the error itself.
    axes.set(ylim=(0, None), xlabel="minutes, start of the move", ylabel="angle error, °")
    axes.legend(loc="upper left", bbox_to_anchor=(0, 1.2), ncols=2)
    return to_svg(drawn, "closure")


def over_temperature(curves: TemperatureCurves) -> str:
    """Draw how bias and scale of a triad change with temperature, what sessions found, and where a new day will be."""
    drawn = figure(2.6)
    panels = drawn.subplots(1, 2)
    for axes, quantity in zip(panels, (curves.bias, curves.scale), strict=True):
        for axis, (name, style, mark, color) in enumerate(zip(AXES, ("-", "--", ":"), "os^", (INK, BLUE, ORANGE), strict=True)):
            change, half = quantity.change[:, axis], quantity.half_95[:, axis]
            axes.fill_between(curves.temperature_degc, change - half, change + half, color=color, alpha=0.12, linewidth=0)
            axes.plot(curves.temperature_degc, change, style, color=color, label=name)
            axes.plot(
                curves.sessions_degc, quantity.sessions[:, axis], mark, color=color, markerfacecolor="white", markersize=5
            )
        axes.axvline(curves.reference_degc, color=GREY, linewidth=0.8)
        axes.set(xlabel="temperature, °C", ylabel=quantity.label)
    panels[0].legend(loc="upper left", bbox_to_anchor=(0, 1.18), ncols=3)
    return to_svg(drawn, f"temperature-{curves.triad}")


def correlations(pairs: Correlations) -> str:
    """Draw the correlation of each pair of parameters below the diagonal."""
    n = len(pairs.names)
    drawn = figure(min(0.17 * n + 1.4, _TALLEST_IN))
    axes = drawn.subplots()
    rows, columns = np.tril_indices(n, -1)
    values = pairs.matrix[rows, columns]
    shown = np.abs(values) >= LEAST_CORRELATION
    for positive, face in ((True, INK), (False, "white")):
        chosen = shown & ((values > 0) == positive)
        axes.scatter(
            columns[chosen], rows[chosen], 40 * np.abs(values[chosen]), facecolor=face, edgecolor=INK, linewidth=0.6, zorder=2
        )
    axes.set_xticks(range(n), pairs.names, rotation=90, fontsize=_LABEL_SIZE)
    axes.set_yticks(range(n), pairs.names, fontsize=_LABEL_SIZE)
    # Downwards, as a matrix is written.
    axes.set(ylim=(n - 0.5, -0.5), xlim=(-0.5, n - 0.5), aspect="equal")
    return to_svg(drawn, "correlations")


def navigation(document: Document) -> str:
    """Draw the errors of static navigation and the band they should be in."""
    drawn = figure(5.0)
    grid = drawn.add_gridspec(3, 2)
    forecast = document.get("forecast")
    for number, quantity in enumerate(QUANTITIES):
        axes = drawn.add_subplot(grid[number // 2, number % 2])
        if forecast is not None:
            _band(axes, forecast, _numbers(forecast["low"][quantity]), _numbers(forecast["high"][quantity]))
        _curves(axes, document["drift"], quantity)
        axes.set_ylabel(_LABELS[quantity])
    axes = drawn.add_subplot(grid[2, :])
    if forecast is not None:
        most = _numbers(forecast["position_95_nmi"])
        _band(axes, forecast, np.zeros_like(most), most)
    _curves(axes, document["drift"], "position_nmi")
    axes.set(ylabel="position, nmi", xlabel="hours")
    axes.legend(loc="upper left", ncols=3)
    return to_svg(drawn, "navigation")


def _band(axes: Axes, forecast: Document, low: FloatArray, high: FloatArray) -> None:
    hours = _numbers(forecast["time_s"]) / 3600
    axes.fill_between(hours, low, high, facecolor="#e4edf6", edgecolor=GREY, hatch="////", linewidth=0.5, label="95 % forecast")


def _curves(axes: Axes, drifts: Document, quantity: str) -> None:
    # The set under test is the last: it gets the full line, and the one before it the broken.
    for (name, drift), style, color in zip(reversed(drifts.items()), ("-", "--"), (INK, ORANGE), strict=False):
        axes.plot(_numbers(drift["time_s"]) / 3600, _numbers(drift[quantity]), style, color=color, label=name)


def _numbers(values: list[float | None]) -> FloatArray:
    """Return an array of values from JSON, where null stands for NaN."""
    return np.array(values, dtype=np.float64)
