"""The few kinds of plot the studies use; matplotlib comes in only when one is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imufield.samples import FloatArray
from imufield.study.report import Draw


def convergence(panels: dict[str, dict[str, FloatArray]], ylabel: str, *, xlabel: str = "iteration", log: bool = True) -> Draw:
    """Return a drawing of curves over iterations, one panel each."""

    def draw(figure: Any) -> None:
        columns = 1 if len(panels) == 1 else 2
        rows = -(-len(panels) // columns)
        axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
        for ax, (title, curves) in zip(axes, panels.items(), strict=False):
            for label, curve in curves.items():
                ax.plot(np.arange(1, len(curve) + 1), curve, label=label, linewidth=1)
            ax.set(title=title, xlabel=xlabel, ylabel=ylabel)
            if log:
                ax.set_yscale("log")
            ax.legend(fontsize=7)
        for ax in axes[len(panels) :]:
            ax.set_axis_off()

    return draw


def runs(series: dict[str, FloatArray], ylabel: str, *, xlabel: str = "run", log: bool = False) -> Draw:
    """Return a drawing of one value per run."""

    def draw(figure: Any) -> None:
        ax = figure.subplots()
        for label, values in series.items():
            ax.plot(np.arange(1, len(values) + 1), values, ".-", label=label, linewidth=0.7, markersize=4)
        ax.set(xlabel=xlabel, ylabel=ylabel)
        if log:
            ax.set_yscale("log")
        ax.legend(fontsize=8)

    return draw


def bars(labels: Sequence[str], series: dict[str, FloatArray], ylabel: str, *, log: bool = False) -> Draw:
    """Return a drawing of groups of bars."""

    def draw(figure: Any) -> None:
        ax = figure.subplots()
        width = 0.8 / len(series)
        for k, (label, values) in enumerate(series.items()):
            ax.bar(np.arange(len(labels)) + (k - (len(series) - 1) / 2) * width, values, width, label=label)
        ax.set_xticks(range(len(labels)), labels, rotation=45, ha="right", fontsize=8)
        ax.set_ylabel(ylabel)
        if log:
            ax.set_yscale("log")
        ax.legend(fontsize=8)

    return draw


def over_time(panels: dict[str, dict[str, tuple[FloatArray, FloatArray]]]) -> Draw:
    """Return a drawing of curves over hours, one panel each: label -> (hours, values)."""

    def draw(figure: Any) -> None:
        columns = 1 if len(panels) == 1 else 2
        axes = np.atleast_1d(figure.subplots(-(-len(panels) // columns), columns)).ravel()
        for ax, (ylabel, curves) in zip(axes, panels.items(), strict=False):
            for label, (hours, values) in curves.items():
                ax.plot(hours, values, label=label, linewidth=1)
            ax.set(xlabel="hours", ylabel=ylabel)
            ax.legend(fontsize=7)

    return draw
