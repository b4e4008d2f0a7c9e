"""The control chart of an instrument: every number of every calibration, its mean, and how far days may lie from it.

The limits are those of the one test of the whole history (``calibrate.sessions.changes``), about the mean of the calibrations
before the first change: what lies outside, or was found as a change, is filled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from imufield.calibrate.sessions.changes import LargestChange
from imufield.calibrate.sessions.kinds import kind_of
from imufield.dataclass import dataclass
from imufield.deliver.judged_history import JudgedHistory
from imufield.deliver.parameters.gauge_free import unit_of
from imufield.drawing.style import BLUE, INK, ORANGE, figure, plot_style, title, to_svg
from imufield.samples import FloatArray
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from matplotlib.dates import AutoDateLocator

sentence = Sentences(__package__)

_COLUMNS = 3  # Axes.
_PANEL_IN = 1.35  # Height.
_MOST_DATES = 4  # Below a panel, without one over the other.


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """One number over h calibrations."""

    name: str
    unit: str
    time: tuple[datetime, ...]
    values: FloatArray
    """About the mean, shape (h,)."""
    sigma: FloatArray
    half_width: FloatArray
    """Of the limits, NaN where days are not known, shape (h,)."""
    is_news: tuple[bool, ...]


def charts(history: JudgedHistory) -> list[Chart]:
    """Return the chart of each number that two calibrations have, or the only one."""
    fewest = min(2, len(history.entries))
    changes = {change.name: change for change in history.judged.changes}
    return [
        _chart(history, name, changes.get(name))
        for name in history.sessions[-1].names
        if sum(name in session.names for session in history.sessions) >= fewest
    ]


def _chart(history: JudgedHistory, name: str, change: LargestChange | None) -> Chart:
    shown = [(k, session, session.names.index(name)) for k, session in enumerate(history.sessions) if name in session.names]
    values = np.array([session.values[row] for _, session, row in shown])
    sigma = np.sqrt([session.covariance[row, row] for _, session, row in shown])
    daily = history.repeatability.get(kind_of(name))
    first = change.first_after if change is not None and change.is_news else None
    before = np.array([first is None or k < first for k, _, _ in shown])
    total = np.hypot(sigma, 0.0 if daily is None else daily.sigma)
    weight = before / total**2
    limit = math.nan if change is None else change.limit_sigma
    off = values - np.sum(weight * values) / np.sum(weight)
    is_news = np.abs(off) > limit * total
    if change is not None and change.is_news:
        is_news |= ~before
    return Chart(
        name=name,
        unit=unit_of(name),
        time=tuple(history.entries[k].time for k, _, _ in shown),
        values=off,
        sigma=sigma,
        half_width=limit * total,
        is_news=tuple(is_news.tolist()),
    )


def plot_history(history: JudgedHistory) -> bytes:
    """Return the control chart as an SVG file, one panel a number.

    Raises
    ------
    UsageError
        If matplotlib is not installed.
    """
    found = charts(history)
    rows = [row for kind in dict.fromkeys(kind_of(chart.name) for chart in found) for row in _rows(found, kind)]
    with plot_style():
        from matplotlib.dates import ConciseDateFormatter

        drawn = figure(_PANEL_IN * max(len(rows), 1) + 0.6)
        panels = drawn.subplots(max(len(rows), 1), _COLUMNS, sharex=True, squeeze=False)
        dates = date_locator()
        panels[0, 0].xaxis.set_major_locator(dates)
        panels[0, 0].xaxis.set_major_formatter(ConciseDateFormatter(dates))  # type: ignore[no-untyped-call]  # the same
        for axes in panels.flat:
            axes.set_axis_off()
        for of_row, row in zip(panels, rows, strict=False):
            for axes, chart in zip(of_row, row, strict=False):
                axes.set_axis_on()
                axes.axhline(0.0, color=BLUE, linewidth=0.8)
                time = np.array(chart.time)
                axes.fill_between(time, -chart.half_width, chart.half_width, color=BLUE, alpha=0.12, linewidth=0)
                axes.errorbar(
                    time, chart.values, yerr=chart.sigma, fmt="o", color=INK, capsize=2, markersize=3.5, markerfacecolor="white"
                )
                news = np.array(chart.is_news)
                axes.plot(time[news], chart.values[news], "s", color=ORANGE, markersize=5)
                axes.set_title(f"{chart.name}, {chart.unit}", fontsize=8)
                axes.tick_params(axis="x", rotation=30)
        has_limits = any(np.isfinite(chart.half_width).any() for chart in found)
        key = "control_chart.title" if has_limits else "control_chart.title_alone"
        title(drawn, sentence(key, title=history.instrument.title, sessions=len(history.entries)))
        return to_svg(drawn, "history").encode("utf-8")


def date_locator() -> AutoDateLocator:
    """Return what finds dates for an axis of any length."""
    from matplotlib.dates import HOURLY, MINUTELY, MONTHLY, SECONDLY, AutoDateLocator

    dates = AutoDateLocator(minticks=2, maxticks=_MOST_DATES)  # type: ignore[no-untyped-call]  # not in its stubs
    # With so few dates its own steps leave gaps, and it warns there: 100 minutes are no two hours, and more than 3 x 30.
    for unit, step in ((MONTHLY, 12), (HOURLY, 24), (MINUTELY, 60), (SECONDLY, 60)):
        dates.intervald[unit] = [*dates.intervald[unit], step]
    return dates


def _rows(found: Sequence[Chart], kind: str) -> list[list[Chart]]:
    of_kind = [chart for chart in found if kind_of(chart.name) == kind]
    return [of_kind[k : k + _COLUMNS] for k in range(0, len(of_kind), _COLUMNS)]
