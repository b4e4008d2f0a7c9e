"""The few kinds of plot that the studies use; matplotlib is loaded only when one is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from imufield.drawing.style import legend_beside, plain_ticks
from imufield.samples import FloatArray
from imufield.study.report import Draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def convergence(panels: dict[str, dict[str, FloatArray]], ylabel: str, *, xlabel: str = "iteration", log: bool = True) -> Draw:
    """Return a drawing of curves over iterations, one panel each."""

    def draw(figure: Figure) -> None:
        for ax, (title, curves) in zip(_panels(figure, len(panels)), panels.items(), strict=True):
            for label, curve in curves.items():
                ax.plot(np.arange(1, len(curve) + 1), curve, label=label)
            ax.set(title=title, xlabel=xlabel, ylabel=ylabel, yscale="log" if log else "linear")
            _finish(ax)

    return draw


def over_time(panels: dict[str, dict[str, tuple[FloatArray, FloatArray]]]) -> Draw:
    """Return a drawing of curves over hours, one panel each: label -> (hours, values)."""

    def draw(figure: Figure) -> None:
        for ax, (ylabel, curves) in zip(_panels(figure, len(panels)), panels.items(), strict=True):
            for label, (hours, values) in curves.items():
                ax.plot(hours, values, label=label)
            ax.set(xlabel="hours", ylabel=ylabel)
            _finish(ax)

    return draw


def runs(series: dict[str, FloatArray], ylabel: str, *, xlabel: str = "run", log: bool = False) -> Draw:
    """Return a drawing of one value per run."""

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        for label, values in series.items():
            ax.plot(np.arange(1, len(values) + 1), values, ".-", label=label, linewidth=0.7, markersize=4)
        ax.set(xlabel=xlabel, ylabel=ylabel, yscale="log" if log else "linear")
        _finish(ax)

    return draw


def bars(labels: Sequence[str], series: dict[str, FloatArray], ylabel: str, *, log: bool = False) -> Draw:
    """Return a drawing of groups of bars."""

    def draw(figure: Figure) -> None:
        ax = figure.subplots()
        # A group has 0.8 of the space between two labels, its middle above the label.
        width = 0.8 / len(series)
        for k, (label, values) in enumerate(series.items()):
            ax.bar(np.arange(len(labels)) + (k - (len(series) - 1) / 2) * width, values, width, label=label)
        ax.set_xticks(range(len(labels)), labels, rotation=45, ha="right", fontsize=8)
        ax.set(ylabel=ylabel, yscale="log" if log else "linear")
        _finish(ax)

    return draw


def _panels(figure: Figure, count: int) -> Iterator[Axes]:
    """Yield ``count`` axes in two columns, one where there is one; switch off the one that is left over."""
    columns = 1 if count == 1 else 2
    axes = np.atleast_1d(figure.subplots(-(-count // columns), columns)).ravel()
    for ax in axes[count:]:
        ax.set_axis_off()
    yield from axes[:count]


def _finish(ax: Axes) -> None:
    if ax.get_yscale() == "log":
        plain_ticks(ax.yaxis)
    # One alone is named by its axis.
    if len(ax.get_legend_handles_labels()[0]) > 1:
        legend_beside(ax)
