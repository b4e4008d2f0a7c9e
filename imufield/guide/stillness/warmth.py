"""Is the instrument warm? The slope of its temperature, from what it says itself."""

from __future__ import annotations

import math

import numpy as np

from imufield.guide.stillness.cells import Cells

WINDOW_CELLS = 300
FEWEST_CELLS = 60
"""Six seconds tell a slope of 1 degC/min from a step of 0.01 degC."""


class Warmth:
    """Follows the temperature over the last half minute.

    Parameters
    ----------
    cell_s : float
    """

    def __init__(self, cell_s: float) -> None:
        self._cell_s = cell_s
        self._degc: list[float] = []

    def follow(self, cells: Cells, row: int) -> None:
        """Take one cell; NaN temperatures are passed over."""
        value = float(cells.temperature_degc[row])
        if math.isfinite(value):
            self._degc.append(value)
            if len(self._degc) > 2 * WINDOW_CELLS:
                del self._degc[:-WINDOW_CELLS]

    def clear(self) -> None:
        """Forget: time has passed that was not seen."""
        self._degc.clear()

    @property
    def slope_degc_min(self) -> float:
        """Slope of a straight line less twice its sigma towards zero, degC per minute; 0 while not known."""
        window = np.array(self._degc[-WINDOW_CELLS:])
        if len(window) < FEWEST_CELLS:
            return 0.0
        time_min = (np.arange(len(window)) - (len(window) - 1) / 2) * self._cell_s / 60
        spread = float(time_min @ time_min)
        slope = float(time_min @ window) / spread
        residual = window - window.mean() - slope * time_min
        # Readings come in steps and repeat from cell to cell: a tenth of them counts.
        sigma = math.sqrt(float(residual @ residual) / max(len(window) / 10 - 2, 1) / spread)
        return math.copysign(max(abs(slope) - 2 * sigma, 0.0), slope)
