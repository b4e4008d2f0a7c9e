"""From samples as they arrive to even rows: what an Allan deviation needs.

Lost samples are bridged by a straight line where no more than a second is missing, and counted; longer losses and clocks that
jump back begin a new run of rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.samples import FloatArray, IntArray

BRIDGED_S = 1.0
"""A longer hole ends the stretch."""


@dataclass(frozen=True, slots=True)
class EvenRows:
    """Rows one sample interval apart."""

    start_s: float
    rows: FloatArray
    bridged: int
    """How many of them are on a straight line between samples."""
    broken: bool
    """They do not follow the rows before."""


class EvenGrid:
    """Puts samples onto an even grid, block by block.

    Parameters
    ----------
    interval_s : float
    """

    def __init__(self, interval_s: float) -> None:
        self.interval_s = interval_s
        self._last: tuple[float, FloatArray] | None = None

    def feed(self, time_s: FloatArray, values: FloatArray) -> list[EvenRows]:
        """Return the even rows of n samples, shape (n,) and (n, c), in runs."""
        continues = self._last is not None
        if self._last is not None:
            time_s = np.concatenate([[self._last[0]], time_s])
            values = np.concatenate([self._last[1][None], values])
        self._last = (float(time_s[-1]), values[-1])
        between = np.diff(time_s)
        steps = np.rint(between / self.interval_s).astype(np.int64)
        breaks = np.flatnonzero((between > BRIDGED_S) | (between <= 0)) + 1
        runs = []
        for number, rows in enumerate(np.split(np.arange(len(time_s)), breaks)):
            even, bridged = bridge(values[rows], steps[rows[:-1]])
            # The first row of a continued run was handed out with the block before.
            skip = 1 if continues and number == 0 else 0
            if len(even) > skip:
                start_s = float(time_s[rows[0]]) + skip * self.interval_s
                runs.append(EvenRows(start_s, even[skip:], bridged, number > 0))
        return runs


def bridge(values: FloatArray, steps: IntArray) -> tuple[FloatArray, int]:
    """Return rows with straight lines over what is missing, and how many those are.

    Parameters
    ----------
    values : ndarray, shape (n, c)
    steps : ndarray of int, shape (n - 1,)
        Sample intervals from each row to the next; fewer than 1 count as 1.
    """
    steps = np.maximum(steps, 1)
    missing = int(np.sum(steps - 1))
    if not missing:
        return values, 0
    place = np.concatenate([[0], np.cumsum(steps)])
    grid = np.arange(place[-1] + 1)
    return np.stack([np.interp(grid, place, column) for column in values.T], axis=1), missing
