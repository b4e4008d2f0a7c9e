"""Where a hold in the hand begins and ends, by its own standard.

A turn fades into the sway of the arm, and limits wide enough for any arm let the end of a slow turn pass. How much *this* arm
moves is known once it has held for some seconds: the rms change of force and rate of the cells well inside the stretch. At both
ends, what departs by clearly more belongs to the turn, seen from outside: a turn goes on without a pause up to the hold, and
a single swing of the arm has calm cells on both sides. Next to the turn a smaller departure is enough, since something moves
there for certain; a slow turn in a hand that sways much begins below what this hand does now and then.

That is where the turn is seen, not where it begins. What lies well inside these edges shows the sway of this hand, and against
it a smooth turn is fitted to the cells at either end: see ``turn_fit``. Its begin stands, but for one cell that departs, and as
far as the hold is long enough to show its sway.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.turn_fit import REACH, cells_of_turn, sway_of
from imufield.samples import FloatArray

SURELY_INSIDE = 20
"""Cells at either end of a stretch that may be of a turn and have no say in the standard; a third of a short stretch."""
FEWEST = 30
"""Of a shorter stretch too few cells are left in the middle, less than one swing of the arm, to set a standard."""
FEWEST_OF_SWAY = 20
"""Cells that show the sway in any case: between turns seen far into both ends of a short stretch there may be none at all."""
# Cells of a hold for each that the fit may add to those in which a turn is seen: a short one hides how slow its sway is.
_SHOWN = 15
_FADES = 5  # Cells beside those in which a turn is seen that may hold more of it.
DEPARTS = 2.8
"""Times the rms. Sway stays below but for rare swings; a turn is above until less of it is left than of the sway."""
DEPARTS_BESIDE = 2.2
"""The same for a cell beside the turn, or at the very edge of the stretch, where a turn begins for certain."""
CALM = 5
"""More cells than these below the limit, and what comes farther inside is the arm's own."""
_SLOW = 10  # Cells of one swing of the arm: over n cells its rms is known only to a share of sqrt(10 / n), or so.
_LEAST_SHARE = 0.04  # Of the hand's limit: the least rms, for a unit that does not move at all.


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
    departs = _departure(cells.mean, change_limit, slice(margin, m - margin))
    departs /= math.sqrt(1 + _SLOW / (m - 2 * margin))
    seen = _of_the_turn(departs[:margin]), _of_the_turn(departs[::-1][:margin])
    rate = np.nan_to_num(cells.mean[:, 3:] / change_limit[3:])
    inside = _well_inside(seen, m)
    rate -= rate[inside].mean(axis=0)
    hold = rate[inside]
    sway, reach = sway_of(hold), min(REACH, m - m // 3)
    first, last = (
        _settled(cells_of_turn(outward, sway, _LEAST_SHARE / math.sqrt(3)), rule, len(hold))
        for outward, rule in zip((rate[::-1][-reach:], rate[-reach:]), seen, strict=True)
    )
    return slice(first, max(m - last, first + 1))


def _well_inside(seen: tuple[int, int], m: int) -> slice:
    """Return the rows that show the sway: what lies between the turns as far as they are seen, and what fades left out."""
    start, stop = seen[0] + _FADES, m - seen[1] - _FADES
    short = max(FEWEST_OF_SWAY - (stop - start) + 1, 0) // 2
    return slice(max(start - short, 0), min(stop + short, m))


def _settled(fitted: float | None, seen: int, shown: int) -> int:
    """Return the cells of a turn from those that the fit found, those where it is seen, and the cells that show the sway."""
    if fitted is None:
        return seen
    cells = math.floor(fitted + 0.5)
    # Beyond the fit one cell may still depart; more is a swing that the limit took for the turn.
    least = min(seen, cells + 1)
    # A short hold hides how slow its sway is: the fit adds little to what is seen.
    most = seen + max(shown // _SHOWN, 1)
    return min(max(cells, least), most)


def _of_the_turn(departs: FloatArray) -> int:
    """Return how many cells, counted from the edge inwards, are of the turn; departures from the edge inwards, shape (k,)."""
    cut = 0
    for row, size in enumerate(departs.tolist()):
        if size > (DEPARTS_BESIDE if row == cut else DEPARTS):
            cut = row + 1
        elif row - cut >= CALM:
            break
    return cut


def _departure(mean: FloatArray, change_limit: FloatArray, inside: slice) -> FloatArray:
    """Return the larger change of the two triads from the middle of the stretch over its rms there, shape (m,)."""
    change = np.nan_to_num((mean - np.median(mean[inside], axis=0)) / change_limit)
    size = np.stack([np.linalg.norm(change[:, :3], axis=1), np.linalg.norm(change[:, 3:], axis=1)], axis=1)
    rms = np.sqrt(np.mean(size[inside] ** 2, axis=0))
    result: FloatArray = (size / np.maximum(rms, _LEAST_SHARE)).max(axis=1)
    return result
