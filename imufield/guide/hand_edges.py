"""Where a hold in the hand begins and ends, by its own standard.

A turn fades into the sway of the arm, and limits wide enough for any arm let the end of a slow turn pass. How much *this* arm
moves is known once it has held for some seconds: the rms change of force and rate of the cells well inside the stretch. At both
ends, what lies outside the innermost cell that departs by clearly more belongs to the turn.
"""

from __future__ import annotations

import numpy as np

from imufield.guide.cells import Cells
from imufield.samples import FloatArray

SURELY_INSIDE = 20
"""Cells at either end of a stretch that may be of a turn and have no say in the standard; a third of a short stretch."""
FEWEST = 30
DEPARTS = 2.8
"""Times the rms. Sway stays below; a turn is above until 0.3 s before what is left of it is less than the sway, or later."""
_LEAST_SHARE = 0.04
"""Of the hand's limit: the least rms, for a unit that does not move at all."""


def hand_edges(cells: Cells, change_limit: FloatArray) -> slice:
    """Return the rows of a stretch that are of the hold, not of the turns before and after it.

    Parameters
    ----------
    cells : Cells
        Of the stretch, all of them.
    change_limit : ndarray, shape (6,)
        The hand's limits of change, raw rates.
    """
    m = len(cells)
    if m < FEWEST:
        return slice(0, m)
    margin = min(SURELY_INSIDE, m // 3)
    departs = _departure(cells.mean, change_limit, slice(margin, m - margin)) > DEPARTS
    before, after = np.flatnonzero(departs[:margin]), np.flatnonzero(departs[m - margin :])
    start = int(before[-1]) + 1 if len(before) else 0
    stop = m - margin + int(after[0]) if len(after) else m
    return slice(start, stop)


def _departure(mean: FloatArray, change_limit: FloatArray, inside: slice) -> FloatArray:
    """Return the larger change of the two triads from the middle of the stretch over its rms there, shape (m,)."""
    change = np.nan_to_num((mean - np.median(mean[inside], axis=0)) / change_limit)
    size = np.stack([np.linalg.norm(change[:, :3], axis=1), np.linalg.norm(change[:, 3:], axis=1)], axis=1)
    rms = np.sqrt(np.mean(size[inside] ** 2, axis=0))
    result: FloatArray = (size / np.maximum(rms, _LEAST_SHARE)).max(axis=1)
    return result
