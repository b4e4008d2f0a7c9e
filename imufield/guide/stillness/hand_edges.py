"""Begin and end of a hold in the hand, where the turn fades into the sway of this arm.

A turn fades into the sway of the arm, and limits wide enough for any arm let the end of a slow turn pass. How much *this* arm
moves is known once it has held for some seconds: the rms change of force and rate of the cells well inside the stretch. At both
ends, cells that depart by clearly more belong to the turn: a turn continues without a pause up to the hold, and a single swing
of the arm has calm cells on both sides. Next to the turn a smaller departure is enough, since the unit certainly moves there;
a slow turn in a hand that sways much begins below the occasional swings of this hand.

This finds where the turn becomes visible, not where it begins. The cells well inside these edges show the sway of this hand,
and against it a smooth turn is fitted to the cells at either end: see ``turn_fit``. Its begin is used, limited to one cell less
than the visible turn and to what a hold of this length shows of its sway.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.turn_fit import REACH, cells_of_turn, sway_of
from imufield.samples import FloatArray, median

# Cells at either end of a stretch that may be of a turn and do not count for the standard; a third of a short stretch.
_SURELY_INSIDE = 20
FEWEST = 30  # A shorter stretch leaves less than one swing of the arm in the middle: too little to set a standard.
# Cells that show the sway in any case: between turns that reach far into both ends of a short stretch there may be none at all.
_FEWEST_OF_SWAY = 20
# Cells of a hold for each that the fit may add to those in which a turn is visible: a short one hides how slow its sway is.
_SHOWN = 15
_FADES = 5  # Cells beside those in which a turn is visible that may hold more of it.
# Times the rms. Sway stays below but for rare swings; a turn is above until less of it is left than of the sway.
_DEPARTS = 2.8
_DEPARTS_BESIDE = 2.2  # The same for a cell beside the turn, or at the very edge of the stretch, where a turn certainly begins.
_CALM = 5  # After more cells than these below the limit, what departs farther inside is the arm's own.
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
    margin = min(_SURELY_INSIDE, m // 3)
    middle = slice(margin, m - margin)
    # The larger change of the two triads from the middle of the stretch, over its rms there.
    change = np.nan_to_num((cells.mean - median(cells.mean[middle])) / change_limit)
    size = np.stack([np.linalg.norm(change[:, :3], axis=1), np.linalg.norm(change[:, 3:], axis=1)], axis=1)
    departs = (size / np.maximum(np.sqrt(np.mean(size[middle] ** 2, axis=0)), _LEAST_SHARE)).max(axis=1)
    # The rms of a short middle is known badly, so that more departs by chance.
    departs /= math.sqrt(1 + _SLOW / (m - 2 * margin))
    visible = _visible_turn(departs[:margin]), _visible_turn(departs[::-1][:margin])
    start, stop = visible[0] + _FADES, m - visible[1] - _FADES
    short = max(_FEWEST_OF_SWAY - (stop - start) + 1, 0) // 2
    inside = slice(max(start - short, 0), min(stop + short, m))
    rate = np.nan_to_num(cells.mean[:, 3:] / change_limit[3:])
    rate -= rate[inside].mean(axis=0)
    hold = rate[inside]
    sway, reach = sway_of(hold), min(REACH, m - m // 3)
    first, last = (
        _combined(cells_of_turn(outward, sway, _LEAST_SHARE / math.sqrt(3)), cells_visible, len(hold))
        for outward, cells_visible in zip((rate[::-1][-reach:], rate[-reach:]), visible, strict=True)
    )
    return slice(first, max(m - last, first + 1))


def _combined(fitted: float | None, visible: int, shown: int) -> int:
    """Return the cells of a turn from those that the fit found, the visible ones, and the cells that show the sway."""
    if fitted is None:
        return visible
    cells = math.floor(fitted + 0.5)
    # Beyond the fit one cell may still depart; more is a swing that the limit mistook for the turn.
    least = min(visible, cells + 1)
    # A short hold hides how slow its sway is: the fit adds little to the visible cells.
    most = visible + max(shown // _SHOWN, 1)
    return min(max(cells, least), most)


def _visible_turn(departs: FloatArray) -> int:
    """Return the number of cells of the turn, counted from the edge inwards; departures in the same order, shape (k,)."""
    cut = 0
    for row, size in enumerate(departs.tolist()):
        if size > (_DEPARTS_BESIDE if row == cut else _DEPARTS):
            cut = row + 1
        elif row - cut >= _CALM:
            break
    return cut
