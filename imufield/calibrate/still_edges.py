"""Where a still really ends: an observation need not hold all of it.

An observation stops counting after a while, and guard bands are cut off. For a move every second at rest is a second of noise
for nothing, so the stills are stretched: cells of 0.1 s before and after are compared with the cells inside, and belong to the
still as long as both triads stay within a few of its standard deviations.
"""

from __future__ import annotations

import numpy as np

from imufield.samples import FloatArray, IntArray

CELL_S = 0.1
"""The guide's cell."""
GUARD_CELLS = 10
"""Kept between the stretched still and what looks like motion."""
_SIGMAS = 5.0
"""Of the cells inside the still; what is further off looks like motion."""
_FEWEST = 5
"""Cells inside a still that tell its scatter."""


def stretch_stills(
    slot_start_s: FloatArray, duration_s: FloatArray, turn: FloatArray, force: FloatArray, stills: FloatArray
) -> FloatArray:
    """Return begin and end of each still, stretched, shape (s, 2).

    Parameters
    ----------
    slot_start_s, duration_s : ndarray, shape (k,)
        Slots of the session, in time order.
    turn, force : ndarray, shape (k, 3)
        Integrals over them.
    stills : ndarray, shape (s, 2)
        Begin and end, in time order.
    """
    if not len(slot_start_s):
        return stills
    cell_s, cells = _cells(slot_start_s, duration_s, np.concatenate([turn, force], axis=1))
    low = np.searchsorted(cell_s, stills[:, 0])
    high = np.searchsorted(cell_s, stills[:, 1] - CELL_S)
    stretched = stills.copy()
    for k in range(len(stills)):
        if high[k] - low[k] < _FEWEST:
            continue
        before = int(high[k - 1]) if k else 0
        after = int(low[k + 1]) if k + 1 < len(stills) else len(cell_s)
        left, right = _reach(cells, int(low[k]), int(high[k]), before, after)
        stretched[k, 0] = min(stills[k, 0], cell_s[min(left, len(cell_s) - 1)])
        stretched[k, 1] = max(stills[k, 1], cell_s[min(right, len(cell_s) - 1)])
    return stretched


def _cells(start_s: FloatArray, duration_s: FloatArray, sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the start of each cell, shape (m,), and its mean outputs, shape (m, 6)."""
    number: IntArray = np.floor(start_s / CELL_S + 1e-6).astype(np.int64)
    starts = np.concatenate(([0], np.flatnonzero(np.diff(number)) + 1))
    total = np.maximum(np.add.reduceat(duration_s, starts), 1e-9)
    return start_s[starts], np.add.reduceat(sums, starts) / total[:, None]


def _reach(cells: FloatArray, low: int, high: int, before: int, after: int) -> tuple[int, int]:
    """Return the cells at which a still can begin and end, guard included."""
    inside = cells[low:high]
    centre = inside.mean(axis=0)
    allowed = _SIGMAS * inside.std(axis=0)
    calm = np.all(np.abs(cells[before:after] - centre) <= allowed, axis=1)
    later, earlier = calm[high - before :], calm[: low - before][::-1]
    forward = len(later) if later.all() else int(np.argmin(later))
    backward = len(earlier) if earlier.all() else int(np.argmin(earlier))
    return low - max(backward - GUARD_CELLS, 0), high + max(forward - GUARD_CELLS, 0)
