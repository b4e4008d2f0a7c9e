"""The values that the outputs took in one hold, as far as holds are compared by them: ends, noise, the commonest value."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from imufield.dataclass import dataclass
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.noise_floor import measure_floor
from imufield.samples import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldOutput:
    """The outputs of a hold: accelerometer x, y, z, gyroscope x, y, z in raw rates, NaN where absent.

    Attributes
    ----------
    cells, samples : int
    low, high : ndarray, shape (6,)
    at_low, at_high : ndarray of int64, shape (3,)
        Samples of the accelerometer at these ends.
    sigma : ndarray, shape (6,)
        Of single samples.
    independent : ndarray, shape (6,)
        Samples that would scatter the means of the cells as much, were they independent; cells where nothing scatters.
    run : ndarray of int64, shape (6,)
        Cells in a row, the most, through which the output did not change.
    run_of_all : int
        The same of all outputs together.
    commonest : ndarray, shape (6,)
        The value that most of the cells begin with: ten draws a second from the histogram of the output, which repeats of one
        reading do not touch.
    begun_with_it : ndarray of int64, shape (6,)
        Cells that do.
    """

    cells: int
    samples: int
    low: FloatArray
    high: FloatArray
    at_low: IntArray
    at_high: IntArray
    sigma: FloatArray
    independent: FloatArray
    run: IntArray
    run_of_all: int
    commonest: FloatArray
    begun_with_it: IntArray

    @classmethod
    def of(cls, cells: Cells) -> HoldOutput:
        """Return the outputs of the cells of a hold, two at least."""
        low, high = np.fmin.reduce(cells.low), np.fmax.reduce(cells.high)
        floor = measure_floor(cells)
        flat = cells.low == cells.high
        # With the cell before; an absent output, NaN, never does.
        unchanged = np.concatenate([np.zeros((1, 6), dtype=np.bool_), flat[1:] & flat[:-1] & (cells.low[1:] == cells.low[:-1])])
        runs = _longest_runs(np.column_stack([unchanged, (unchanged | np.isnan(low)).all(axis=1)]))
        commonest = [_commonest(column[np.isfinite(column)]) for column in cells.first.T]
        return cls(
            cells=len(cells),
            samples=int(cells.count.sum()),
            low=low,
            high=high,
            at_low=np.where(cells.low[:, :3] == low[:3], cells.at_low, 0).sum(axis=0),
            at_high=np.where(cells.high[:, :3] == high[:3], cells.at_high, 0).sum(axis=0),
            sigma=floor.sigma,
            independent=len(cells) * np.divide(floor.sigma, floor.cell_sigma, out=np.ones(6), where=floor.sigma > 0) ** 2,
            run=runs[:6],
            run_of_all=int(runs[6]),
            commonest=np.array([value for value, _ in commonest]),
            begun_with_it=np.array([count for _, count in commonest]),
        )

    @property
    def still(self) -> NDArray[np.bool_]:
        """Which outputs did not change at all, shape (6,)."""
        return np.asarray(self.low == self.high)


def _longest_runs(unchanged: NDArray[np.bool_]) -> IntArray:
    """Return the most cells in a row that are all the same, the first of them included, of each column: (m, k) to (k,)."""
    # One column behind the other; each begins with a change.
    column, row = np.nonzero(~unchanged.T)
    length = np.diff(column * len(unchanged) + row, append=unchanged.size)
    return np.asarray(np.maximum.reduceat(length, np.flatnonzero(row == 0)))


def _commonest(values: FloatArray) -> tuple[float, int]:
    """Return the value that comes most often, the smallest of several, and how often."""
    # Of a hundred values, in a third of the time that NumPy takes.
    counts = Counter(values.tolist())
    most = max(counts.values(), default=0)
    return min((value for value, count in counts.items() if count == most), default=math.nan), most
