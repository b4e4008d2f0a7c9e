"""The live feed of a session: where up is, and the six signals of the last half minute, whoever draws them.

It keeps the cells that the guide has anyway, and works them out only when somebody looks.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from imufield.dataclass import dataclass
from imufield.guide.stillness.cells import Cells, cells_in, join_cells
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import CELL_S, FloatArray, Samples, Status

_NEWEST_S = 0.02  # As long as links gather samples anyway; vibration is averaged out.
SPAN_S = 30.0
"""Time that the feed reaches back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Signals:
    """Accelerometer x, y, z and gyroscope x, y, z in blocks of 0.1 s, the newest last.

    Attributes
    ----------
    newest_s : float
        Sample clock of the newest block.
    age_s : ndarray, shape (n,)
        Time from each block to the newest; samples that are missing leave a gap.
    mean, low, high : ndarray, shape (n, 6)
        Of each block, NaN where nothing usable arrived; rough, as the calibration is not known yet.
    units : tuple of str
        Of both triads: m/s^2 and rad/s, or "raw unit" where the scale is not known.
    """

    newest_s: float
    age_s: FloatArray
    mean: FloatArray
    low: FloatArray
    high: FloatArray
    units: tuple[str, str]


class LiveFeed:
    """The newest cells of a session, no more than ``SPAN_S``."""

    def __init__(self) -> None:
        self._blocks: deque[Cells] = deque()
        self._count = 0
        self._last: Samples | None = None  # The newest, behind what is in the cells.

    def hear(self, samples: Samples) -> None:
        """Keep the newest samples: a cell is 0.1 s old before it is whole, and a hand sees that."""
        self._last = samples

    def add(self, cells: Cells) -> None:
        """Append cells."""
        cells = cells[-cells_in(SPAN_S) :]
        self._blocks.append(cells)
        self._count += len(cells)
        while self._count - len(self._blocks[0]) >= cells_in(SPAN_S):
            self._count -= len(self._blocks.popleft())

    def newest(self, count: int) -> Cells | None:
        """Return a number of cells at most, None before the first."""
        return join_cells([*self._blocks][-count:])[-count:] if self._blocks else None

    def up(self, scale: RoughScale) -> FloatArray:
        """Return where up is in the body by the newest samples, unit vector (3,), NaN while not known."""
        if (last := self._last) is None:
            return np.full(3, np.nan)
        newest = last.accelerometer_rate()[last.time_s > last.time_s[-1] - _NEWEST_S]
        known = newest[np.isfinite(newest).all(axis=1)]
        if not len(known) or not scale.accelerometer:
            return np.full(3, np.nan)
        return scale.up(known.mean(axis=0))

    def signals(self, scale: RoughScale) -> Signals | None:
        """Return the six signals in the units of a scale, None before the first."""
        cells = self.newest(cells_in(SPAN_S))
        if cells is None:
            return None
        # Asked again and again of a feed that grows cell by cell.
        self._blocks, self._count = deque([cells]), len(cells)
        slot, starts_up = cells.slot, cells.flags[:, np.newaxis] & np.uint32(Status.START_UP)
        # What an instrument sends before it is ready would make the scale of a picture.
        values = [np.where(starts_up, np.nan, value) for value in (cells.mean, cells.low, cells.high)]
        # A clock that was set back leaves cells of the future.
        kept = slot <= slot[-1]
        (_, force_unit, force), (_, rate_unit, rate) = scale.triads
        zero, factor = np.append(scale.raw_zero, np.zeros(3)), np.repeat([force, rate], 3)
        mean, low, high = ((value[kept] - zero) / factor for value in values)
        return Signals(
            newest_s=float(slot[-1]) * CELL_S,
            age_s=(slot[-1] - slot[kept]) * CELL_S,
            mean=mean,
            low=low,
            high=high,
            units=(force_unit, rate_unit),
        )
