"""The values that the outputs took in one hold, as far as holds are compared by them: ends, noise, the commonest value."""

from __future__ import annotations

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
        # As the cell before; an absent output, NaN, never is.
        unchanged = flat[1:] & flat[:-1] & (cells.low[1:] == cells.low[:-1])
        run, _ = _longest_runs(np.column_stack([unchanged, (unchanged | np.isnan(low)).all(axis=1)]))
        ordered = np.sort(cells.first, axis=0)
        begun_with_it, place = _longest_runs(ordered[1:] == ordered[:-1])
        commonest = ordered[place, range(6)]
        return cls(
            cells=len(cells),
            samples=int(cells.count.sum()),
            low=low,
            high=high,
            at_low=np.where(cells.low[:, :3] == low[:3], cells.at_low, 0).sum(axis=0),
            at_high=np.where(cells.high[:, :3] == high[:3], cells.at_high, 0).sum(axis=0),
            sigma=floor.sigma,
            independent=len(cells) * np.divide(floor.sigma, floor.cell_sigma, out=np.ones(6), where=floor.sigma > 0) ** 2,
            run=run[:6],
            run_of_all=int(run[6]),
            commonest=commonest,
            begun_with_it=np.where(np.isnan(commonest), 0, begun_with_it),
        )

    @property
    def still(self) -> NDArray[np.bool_]:
        """Which outputs did not change at all, shape (6,)."""
        return np.asarray(self.low == self.high)


def _longest_runs(as_before: NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
    """Return the most rows in a row that are as the one before, the first of them included, and the first place of so many.

    Of each column, shape (k,); ``as_before`` is that of all rows but the first, shape (m - 1, k).
    """
    # One column behind the other; each begins with another value.
    is_other = np.concatenate([np.ones((1, as_before.shape[1]), dtype=np.bool_), ~as_before])
    column, row = np.nonzero(is_other.T)
    length = np.diff(column * len(is_other) + row, append=is_other.size)
    begins = np.flatnonzero(row == 0)
    longest = np.maximum.reduceat(length, begins)
    return longest, np.minimum.reduceat(np.where(length == longest[column], row, len(as_before)), begins)
