"""The six signals of the live feed as traces, one strip each, drawn with characters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.guide.lead.live import SPAN_S, Signals
from imufield.guide.stillness.cells import cells_in
from imufield.guide.view.pictures import characters
from imufield.samples import AXES, FloatArray, IntArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_VALUE_WIDTH = 9  # Name and newest value on the left, ends of the scale on the right.
# Least height of a strip, in the unit shown: what is smaller is noise, and the bar of stillness judges it.
_LEAST = {"m/s^2": 0.5, "deg/s": 2.0}


def signals_title(signals: Signals | None) -> str:
    """Return the heading of the strips: units and time."""
    force, rate = ("-", "-") if signals is None else map(_shown_unit, signals.units)
    return sentence("traces.title", force=force, rate=rate, span_s=SPAN_S)


def draw_signals(signals: Signals, width: int, height: int, *, ascii_only: bool = False) -> list[str]:
    """Return the lines of the strips; a signal that the instrument does not have has none.

    Parameters
    ----------
    signals : Signals
    width, height : int
        Characters, of all strips.
    ascii_only : bool
        Draw with ASCII.
    """
    across, down = (1, 1) if ascii_only else (2, 4)
    columns = min(width - 2 * _VALUE_WIDTH, cells_in(SPAN_S) // across)
    place = np.rint((1 - signals.age_s / SPAN_S) * (columns * across - 1)).astype(int)
    present = [k for k in range(6) if np.isfinite(signals.mean[:, k]).any()]
    rows = height // max(len(present), 1)
    lines: list[str] = []
    for k in present:
        unit = signals.units[k // 3]
        factor = math.degrees(1) if unit == "rad/s" else 1.0
        low, high, mean = (factor * values[:, k] for values in (signals.low, signals.high, signals.mean))
        bottom, top = float(np.nanmin(low)), float(np.nanmax(high))
        middle, half = (bottom + top) / 2, max(top - bottom, _LEAST.get(_shown_unit(unit), 0.0)) / 2 or 1.0
        dots = _strip((low - middle) / half, (high - middle) / half, place, (rows * down, columns * across))
        left, right = [""] * rows, [""] * rows
        left[0], left[-1] = f"{'acc' if k < 3 else 'gyro'} {AXES[k % 3]}", _number(float(mean[-1]))
        right[0], right[-1] = _number(middle + half), _number(middle - half)
        drawn = zip(left, characters(dots, down), right, strict=True)
        lines += [f"{name:{_VALUE_WIDTH}}{''.join(row)}{end:>{_VALUE_WIDTH}}" for name, row, end in drawn]
    return lines


def _shown_unit(unit: str) -> str:
    return "deg/s" if unit == "rad/s" else unit


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:+z.2f}" if abs(value) < 1000 else f"{value:+.3g}"


def _strip(low: FloatArray, high: FloatArray, place: IntArray, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the dots of a strip: from the lowest to the highest value of each column, -1 to 1, joined to the column before."""
    lowest, highest = np.full(shape[1], np.inf), np.full(shape[1], -np.inf)
    known = (place >= 0) & np.isfinite(low) & np.isfinite(high)
    np.minimum.at(lowest, place[known], low[known])
    np.maximum.at(highest, place[known], high[known])
    # Beside an empty column nothing is joined: infinite ends do not reach it.
    before_low, before_high = np.append(np.inf, lowest[:-1]), np.append(-np.inf, highest[:-1])
    joined = np.isfinite(lowest) & np.isfinite(before_low)
    lowest, highest = (
        np.where(joined, np.minimum(lowest, before_high), lowest),
        np.where(joined, np.maximum(highest, before_low), highest),
    )
    row = np.linspace(1, -1, shape[0])[:, None]
    margin = 1 / max(shape[0] - 1, 1)
    return (row <= highest + margin) & (row >= lowest - margin)
