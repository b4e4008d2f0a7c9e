"""Slots: the output of a gyroscope as integrals over 5 ms, from which it is integrated with any parameters.

The gyroscope has to be integrated with parameters that are not known yet, again and again while they are fitted. Keeping
every sample would do; keeping integrals over short slots (5 ms) is as good and does not grow with the sample rate. With raw
output ``N(t)`` over a slot of duration ``T``, ``alpha(t)`` its integral from the start of the slot::

    turn    alpha(T)                          moment   integral of alpha dt
    force   integral of the accelerometer     area     integral of alpha x N dt

For *any* linear model ``w = A (N - e)`` the rotation vector of the slot is, to second order [1]_,

    A (turn - e T) + 1/2 cof(A) (area + (T turn - 2 moment) x e),    cof(A) = det(A) A^-T

because ``A x  x  A y = cof(A) (x x y)``. The second term is coning. What is left out is of third order: 1e-8 rad a slot for a
hand at 4 rad/s. Neighbouring slots join exactly in the same order (``join_slots``), so quiet stretches of a long recording are
kept as slots of 0.1 s. ``moves.MoveCollector`` makes them of samples.

References
----------
.. [1] J. E. Bortz, "A new mathematical formulation for strapdown inertial navigation", IEEE Trans. AES-7(1), 1971.
"""

from __future__ import annotations

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.rotation import cross
from imufield.dataclass import dataclass, fields
from imufield.samples import CELL_S, FloatArray, IntArray, interval_of

SHORTEST_SLOT_S = 1e-9
"""Instead of nothing, for a slot of a clock that stood."""

SLOT_S = 0.005
"""Length of a slot."""
PLATEAU = 4
"""Equal values in a row at an end of the range that make it a saturated axis."""


class SlotFlag(IntFlag):
    """What happened in a slot."""

    BRIDGED = 1
    LOST = 2
    CLOCK_JUMP = 4
    SATURATED = 8
    INVALID = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Slots:
    """Integrals over k short slots, in time order; raw rates, see the module.

    Attributes
    ----------
    start_s, duration_s : ndarray, shape (k,)
    turn, moment, area, force : ndarray, shape (k, 3)
    bridge : ndarray, shape (k,)
        Variance of the turn that bridged losses leave, raw unit squared.
    flags : ndarray of uint8, shape (k,)
        ``SlotFlag``.
    plateau : ndarray, shape (k, 3)
        Output that repeated itself ``PLATEAU`` times; NaN where none did.
    """

    start_s: FloatArray
    duration_s: FloatArray
    turn: FloatArray
    moment: FloatArray
    area: FloatArray
    force: FloatArray
    bridge: FloatArray
    flags: NDArray[np.uint8]
    plateau: FloatArray

    def __len__(self) -> int:
        return len(self.start_s)

    def __getitem__(self, rows: slice | IntArray | NDArray[np.bool_]) -> Slots:
        return Slots(**{name: getattr(self, name)[rows] for name in _SLOT_FIELDS})


_SLOT_FIELDS = tuple(field.name for field in fields(Slots))


def stack_slots(parts: list[Slots]) -> Slots:
    """Put slots one after the other; at least one part is needed."""
    if len(parts) == 1:
        return parts[0]
    return Slots(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in _SLOT_FIELDS})


def no_slots() -> Slots:
    """Return zero slots."""
    vectors = ("turn", "moment", "area", "force", "plateau")
    arrays = {name: np.empty((0, 3) if name in vectors else 0) for name in _SLOT_FIELDS if name != "flags"}
    return Slots(flags=np.empty(0, np.uint8), **arrays)


def join_slots(slots: Slots, starts: IntArray) -> Slots:
    """Join each run of slots that begins at one of ``starts`` into one slot, exactly to second order."""
    length = np.diff(np.append(starts, len(slots)))
    before = np.cumsum(slots.turn, axis=0) - slots.turn
    before -= np.repeat(before[starts], length, axis=0)
    moment = slots.moment + before * slots.duration_s[:, None]
    area = slots.area + cross(before, slots.turn)
    sums = {"duration_s": slots.duration_s, "turn": slots.turn, "moment": moment, "area": area, "force": slots.force}
    return Slots(
        start_s=slots.start_s[starts],
        **{name: np.add.reduceat(values, starts, axis=0) for name, values in sums.items()},
        bridge=np.add.reduceat(slots.bridge, starts),
        flags=np.bitwise_or.reduceat(slots.flags, starts),
        plateau=np.fmax.reduceat(slots.plateau, starts, axis=0),
    )


def slot_sums(slots: Slots) -> FloatArray:
    """Return duration, turn and force of each slot, shape (k, 7): what cells are made of."""
    return np.column_stack([slots.duration_s, slots.turn, slots.force])


def sum_cells(start_s: FloatArray, sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return begin and sums of the cells that rows in time order belong to, of slots or of parts of cells."""
    starts = run_starts(interval_of(start_s, CELL_S))
    return start_s[starts], np.add.reduceat(sums, starts)


def run_starts(number: IntArray) -> IntArray:
    """Return where runs of one number begin, the first included."""
    return np.append(0, np.flatnonzero(number[1:] != number[:-1]) + 1)


def join_cells(slots: Slots, cell_s: FloatArray, which: NDArray[np.bool_]) -> Slots:
    """Return slots with those in some of the cells, which begin at ``cell_s``, joined."""
    starts = run_starts(cell := interval_of(slots.start_s, CELL_S))
    return join_runs(slots, starts, which[np.searchsorted(interval_of(cell_s, CELL_S), cell[starts])])


def join_runs(slots: Slots, starts: IntArray, which: NDArray[np.bool_]) -> Slots:
    """Return slots with some of the runs that begin at ``starts`` joined."""
    keep = ~np.repeat(which, np.diff(np.append(starts, len(slots))))
    keep[starts] = True
    return join_slots(slots, np.flatnonzero(keep))
