"""The ends of a gyroscope's range, as its outputs show them: where turns stand, and neither a rest nor a rate table does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.samples import FloatArray

# Times the samples of the next value that make the largest an end of the range: the top of a turn, a parabola, has 2.4 times.
_LONGER = 3
_MORE = 5  # And so many more: of few samples, one and two differ by chance.
# A whole turn by hand beyond 120 deg/s, the smallest range there is, takes less. A table holds its rate for longer, and so does
# a slow turn that saturates: the other axes tell them apart.
_LONGEST_TURN_S = 3.0
# Largest spread of another axis on a table, between its quartiles: this share of the largest range of rates, or one step of the
# output where that is more.
_STEADY_SHARE = 0.01
_HOLE_S = 0.25  # A longer one ends a stretch: noise may reach the next code, and quiet slots are joined into cells of 0.1 s.


class LargestOutputs:
    """The two largest outputs so far, of the axes and of the axes reversed, and how often they came."""

    def __init__(self) -> None:
        self._largest, self._times = np.full((6, 2), -np.inf), np.zeros((6, 2), dtype=np.int64)

    @property
    def ends(self) -> FloatArray:
        """Lowest and highest output of each axis that is an end of its range, shape (2, 3); NaN for the top of a turn."""
        is_end = self._times[:, 0] > _LONGER * self._times[:, 1] + _MORE
        high, low = np.where(is_end, self._largest[:, 0], np.nan).reshape(2, 3)
        return np.stack([-low, high])

    def count(self, N: FloatArray) -> None:
        """Count the outputs of some samples, shape (3, n)."""
        values = np.hstack([self._largest, np.vstack([N, -N])])
        times = np.hstack([self._times, np.ones((6, N.shape[1]), dtype=np.int64)])
        largest = values.max(axis=1, keepdims=True)
        self._largest = np.hstack([largest, np.where(values < largest, values, -np.inf).max(axis=1, keepdims=True)])
        self._times = np.stack([np.sum(times, axis=1, where=values == value[:, None]) for value in self._largest.T], axis=1)


def without_table_rates(
    ends: FloatArray | float, time_s: FloatArray, rate: FloatArray, plateau: FloatArray, is_rest: NDArray[np.bool_]
) -> FloatArray | float:
    """Return ends, shape (2, 3), with NaN for those at which an axis stands at rest, or as only a table turns it.

    A table holds its rate for longer than a turn by hand takes, and whenever an axis stands at this end, the others are steady:
    of a turn that saturates one axis, they show how its rate goes on to change.

    Parameters
    ----------
    ends : ndarray or float
        NaN where there is none.
    time_s, rate, plateau : ndarray, shape (k,), (k, 3), (k, 3)
        Begin of each slot, in time order, its mean output, and the output that repeats itself there.
    is_rest : ndarray of bool, shape (k,)
        Whether it is of a still.
    """
    reached = plateau[:, None] == ends
    # Without ``numpy.unique``, which imports NumPy's masked arrays.
    steps = np.diff(np.sort(plateau[np.isfinite(plateau)]))
    step = steps.min(initial=np.inf, where=steps > 0)
    most = max(_STEADY_SHARE * np.ptp(rate, axis=0).max(), step if np.isfinite(step) else 0.0)
    # An axis that was never turned one way ends there at what it reads at rest.
    is_none = np.any(reached[is_rest], axis=0)
    for end, axis in np.argwhere(reached.any(axis=0)):
        rows = np.flatnonzero(reached[:, end, axis])
        stretches = np.split(rows, np.flatnonzero(np.diff(time_s[rows]) > _HOLE_S) + 1)
        if any(time_s[stretch[-1]] - time_s[stretch[0]] > _LONGEST_TURN_S for stretch in stretches):
            others = np.delete(rate, axis, axis=1)
            is_none[end, axis] |= all(_are_steady(others[stretch], most) for stretch in stretches)
    return np.where(is_none, np.nan, ends)


def _are_steady(rates: FloatArray, most: float) -> bool:
    """Whether axes, shape (k, 2), stay within ``most`` between their quartiles."""
    low, high = np.quantile(rates, [0.25, 0.75], axis=0)
    return bool(np.all(high - low <= most))
