"""Is the instrument warm? The slope of the temperature that it reports."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from imufield.guide.stillness.cells import CELL_S, Cells

_WINDOW_CELLS = 300  # Half a minute: a longer one still sees a warm-up that is over.
_FEWEST_CELLS = 60  # Six seconds tell a slope of 1 degC/min from a step of 0.01 degC.


class Warmth:
    """Follows the temperature over the last half minute."""

    def __init__(self) -> None:
        self._degc: deque[float] = deque(maxlen=_WINDOW_CELLS)

    def follow(self, cells: Cells, row: int) -> None:
        """Add one cell; a NaN temperature is ignored."""
        value = float(cells.temperature_degc[row])
        if math.isfinite(value):
            self._degc.append(value)

    def clear(self) -> None:
        """Forget the temperatures: time has passed that was not observed."""
        self._degc.clear()

    @property
    def slope_degc_min(self) -> float:
        """Slope of a straight line less twice its sigma towards zero, degC per minute; 0 while not known."""
        window = np.array(self._degc)
        if len(window) < _FEWEST_CELLS:
            return 0.0
        time_min = (np.arange(len(window)) - (len(window) - 1) / 2) * CELL_S / 60
        spread = float(time_min @ time_min)
        slope = float(time_min @ window) / spread
        residual = window - window.mean() - slope * time_min
        # Readings come in steps and repeat from cell to cell: a tenth of them counts.
        sigma = math.sqrt(float(residual @ residual) / max(len(window) / 10 - 2, 1) / spread)
        return math.copysign(max(abs(slope) - 2 * sigma, 0.0), slope)
