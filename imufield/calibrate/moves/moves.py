"""Moves between still positions, as compact sums (``slots``) that a stream can produce in bounded memory.

Between two samples the output is taken as the first sample's value for half of the time and the second's for the other half:
for samples that are the mean turn over their own interval, or increments, the product of their turns is then exact. Where
samples were lost, the straight line between their neighbours bridges up to 30 ms; longer losses drop the move, except
within a hold in the hand, in whose middle moves begin and end.

Where a still ends: an observation stops counting after a while, and guard bands are cut off. For a move every second at rest
adds a second of noise and nothing else, so the stills are stretched: cells of 0.1 s before and after are compared with those
inside, and belong to the still as long as both triads stay within a few of its standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.rotation import cross
from imufield.calibrate.moves.range_ends import LargestOutputs, without_table_rates
from imufield.calibrate.moves.slots import (
    PLATEAU,
    SHORTEST_SLOT_S,
    SLOT_S,
    SlotFlag,
    Slots,
    join_cells,
    join_runs,
    no_slots,
    run_starts,
    slot_sums,
    stack_slots,
    sum_cells,
)
from imufield.dataclass import dataclass, replace
from imufield.samples import (
    CELL_S,
    EDGE_MARGIN,
    LARGEST_OUTPUT,
    FloatArray,
    IntArray,
    Samples,
    SampleUnits,
    Status,
    concatenate,
    every,
    interval_of,
    median,
)
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_GUARD_CELLS = 10  # Kept between the stretched still and what looks like motion.
_SIGMAS = 5.0  # Of the cells inside the still; what is further off looks like motion.
_FEWEST = 5  # Cells inside a still that tell its scatter.
_BRIDGED_S = 0.03  # Longest loss of samples that a straight line bridges: a hand at 2 Hz and 1 rad/s then strays by 0.4 mrad.
_BRIDGED_INTERVALS = 3.5  # The same for slow instruments: two lost samples.
_LONGEST_MOVE_S = 300.0  # The noise of a longer one says nothing any more.
_INTERRUPTED_S = 1.0  # A hole as long is no loss on the wire: the session was broken off and resumed, or the cable was out.
_LOST_INTERVALS = 1.5  # Between one interval, however unsteady the clock, and the two of a lost sample.
_COMPACT_AT = 1_000_000  # Slots before quiet stretches are joined: 83 minutes, 170 MB.
_JOINED_AT_ONCE = 16  # Parts of slots that are joined at once: as much as stays in the cache.


def stretch_stills(cell_s: FloatArray, sums: FloatArray, *, stills: FloatArray, in_hand: NDArray[np.bool_]) -> FloatArray:
    """Return begin and end of each still, stretched, shape (s, 2).

    Parameters
    ----------
    cell_s, sums : ndarray, shape (m,), (m, 7)
        Begin of each cell of the session and ``slot_sums`` in it, in time order.
    stills : ndarray, shape (s, 2)
        Begin and end, in time order.
    in_hand : ndarray of bool, shape (s,)
        Which of them are of a unit in the hand; they stay as they are.
    """
    cells = sums[:, 1:] / np.maximum(sums[:, :1], SHORTEST_SLOT_S)
    low = np.searchsorted(cell_s, stills[:, 0])
    high = np.searchsorted(cell_s, stills[:, 1] - CELL_S)
    stretched = stills.copy()
    for k in range(len(stills)):
        if in_hand[k] or high[k] - low[k] < _FEWEST:
            continue
        before = int(high[k - 1]) if k else 0
        after = int(low[k + 1]) if k + 1 < len(stills) else len(cell_s)
        # Cells near the mean of those inside look calm; the stretch ends a guard before the first that does not.
        inside = cells[low[k] : high[k]]
        calm = np.all(np.abs(cells[before:after] - inside.mean(axis=0)) <= _SIGMAS * inside.std(axis=0), axis=1)
        later, earlier = calm[high[k] - before :], calm[: low[k] - before][::-1]
        forward = len(later) if later.all() else int(np.argmin(later))
        backward = len(earlier) if earlier.all() else int(np.argmin(earlier))
        left = int(low[k]) - max(backward - _GUARD_CELLS, 0)
        right = int(high[k]) + max(forward - _GUARD_CELLS, 0)
        stretched[k, 0] = min(stills[k, 0], cell_s[min(left, len(cell_s) - 1)])
        stretched[k, 1] = max(stills[k, 1], cell_s[min(right, len(cell_s) - 1)])
    # Two that met in the calm between them leave it to the move.
    met = np.flatnonzero(stretched[:-1, 1] > stretched[1:, 0])
    stretched[met, 1], stretched[met + 1, 0] = stills[met, 1], stills[met + 1, 0]
    return stretched


# What the status of a sample says of the intervals beside it.
_OF_STATUS = {
    Status.GYROSCOPE_SATURATED: SlotFlag.SATURATED,
    Status.GYROSCOPE_INVALID | Status.INSTRUMENT_FAULT: SlotFlag.INVALID,
}


class MoveCollector:
    """Collects the moves of a recording from a stream of samples, as slots; the still intervals are given at the end.

    The result does not depend on how the samples were cut into blocks.

    Parameters
    ----------
    units : SampleUnits
        ``interval_s`` tells losses; where it is not known, the median interval of the first block does.
    """

    def __init__(self, units: SampleUnits) -> None:
        self.interval_s = units.interval_s
        self._parts: list[Slots] = []
        self._count = 0
        self._compact_at = _COMPACT_AT
        self._pending: Samples | None = None
        self._flat = np.zeros(3, dtype=np.int64)
        self._largest = LargestOutputs()

    def feed(self, samples: Samples) -> None:
        """Take the next samples."""
        # What is missing, or no instrument has sent, would be summed up: such a sample is a lost one.
        sound = (np.abs(samples.gyroscope) <= LARGEST_OUTPUT) & (np.abs(samples.accelerometer) <= LARGEST_OUTPUT)
        samples = samples if every(sound) else samples[np.flatnonzero(sound.all(axis=1))]
        if not len(samples):
            return
        self._largest.count(samples.gyroscope_rate().T)
        if self._pending is not None:
            samples = concatenate([self._pending, samples])
        if self.interval_s is None and len(samples) > 2:
            steps = np.diff(samples.time_s)
            self.interval_s = float(median(steps[steps > 0])) if (steps > 0).any() else None
        if self.interval_s is None:
            self._pending = samples
            return
        starts = self._slot_starts(samples)
        cut = int(starts[-1])  # the last slot may go on in the next block
        if cut:
            self._parts.append(self._measure(samples[: cut + 1], starts[:-1]))
            self._count += len(self._parts[-1])
            if self._count > self._compact_at:
                self._compact()
        self._pending = samples[cut:]

    def slots(self) -> Slots:
        """Return the slots of all samples so far."""
        return stack_slots(self._all() or [no_slots()])

    def joined_slots(self, start_s: FloatArray, duration_s: FloatArray, middle_s: FloatArray | None = None) -> Slots:
        """Return the same with those inside stretched stills joined into cells; moves are cut at cells, so they stay the same.

        Still intervals are given as to ``finish``. Some parts are joined at a time: all slots at once are as much memory again.
        """
        parts = self._all()
        if not parts or not np.isfinite(start_s).all():
            return self.slots()
        latest_s = np.maximum.accumulate([part.start_s.max() for part in parts])
        # A clock that jumps back must not hide what lies behind the jump.
        rising = [
            replace(part, start_s=np.maximum.accumulate(np.maximum(part.start_s, before_s)))
            for part, before_s in zip(parts, [-np.inf, *latest_s.tolist()], strict=False)
        ]
        in_parts = [sum_cells(part.start_s, slot_sums(part)) for part in rising]
        cell_s, sums = sum_cells(*(np.concatenate(each) for each in zip(*in_parts, strict=True)))
        order = np.argsort(start_s, kind="stable")
        stills = np.stack([start_s, start_s + duration_s], axis=1)[order]
        stills = stretch_stills(cell_s, sums, stills=stills, in_hand=np.isfinite(_middles(middle_s, order)))
        # The last still that begins before each cell: whole cells of it are joined.
        still = np.searchsorted(stills[:, 0], cell_s + EDGE_MARGIN, side="right") - 1
        next_s = np.append(cell_s[1:], np.inf)
        inside = (still >= 0) & (next_s <= stills[still, 1] + EDGE_MARGIN) if len(stills) else np.zeros(len(cell_s), np.bool_)
        groups = [rising[at : at + _JOINED_AT_ONCE] for at in range(0, len(rising), _JOINED_AT_ONCE)]
        joined = [join_cells(group, cell_s, inside) for group in map(stack_slots, groups)]
        # Where a group ended in the middle of a cell.
        return joined[0] if len(joined) == 1 else join_cells(stack_slots(joined), cell_s, inside)

    def finish(self, start_s: FloatArray, duration_s: FloatArray, middle_s: FloatArray | None = None) -> Moves:
        """Return the moves between still intervals (sample clock, shape (s,), in any order); see ``cut_moves``."""
        slots = self.joined_slots(start_s, duration_s, middle_s)
        return cut_moves(slots, start_s, duration_s, self.ends, middle_s=middle_s)

    @property
    def ends(self) -> FloatArray:
        """Lowest and highest output of each axis that is an end of its range, shape (2, 3); NaN for the top of a turn."""
        return self._largest.ends

    def _all(self) -> list[Slots]:
        if self._pending is None or len(self._pending) < 2 or not self.interval_s:
            return self._parts
        # The unfinished slot is the last one.
        return [*self._parts, self._measure(self._pending, self._slot_starts(self._pending))]

    def _slot_starts(self, samples: Samples) -> IntArray:
        """Return in which of the intervals between the samples a slot begins, the first included."""
        return run_starts(interval_of(samples.time_s[:-1], SLOT_S))

    def _measure(self, samples: Samples, starts: IntArray) -> Slots:
        """Return the slots that begin at ``starts`` of n intervals between n + 1 samples."""
        # One row for each axis: loops of NumPy over three numbers cost more than the numbers.
        N, a = (np.ascontiguousarray(values.T) for values in (samples.gyroscope_rate(), samples.accelerometer_rate()))
        dt = np.diff(samples.time_s)
        stood = dt == 0
        if stood.any():
            # A sample that was sent twice adds nothing to a turn; of a clock that stands nobody knows how long it did.
            twice = np.all(np.diff(np.vstack([N, a]), axis=1) == 0, axis=0)
            stood &= ~twice | np.append(False, stood[:-1])
        flags, bridge = self._flags(samples.status, dt, stood), np.zeros(len(dt))
        lost = (flags & np.uint8(SlotFlag.BRIDGED)) != 0
        if lost.any():
            # Over a loss the rate changed; when it did so is unknown, and moves the turn by up to half of this.
            bridge[lost] = np.sum(np.diff(N, axis=1)[:, lost] ** 2, axis=0) * dt[lost] ** 2 / 16
        dt = np.where(flags & np.uint8(SlotFlag.CLOCK_JUMP), 0.0, dt)
        half = 0.5 * dt
        first, second, force = half * N[:, :-1], half * N[:, 1:], half * (a[:, :-1] + a[:, 1:])
        turn = first + second
        # alpha in the middle of each interval: there it has turned by N_k for dt/2, and turns by N_k+1 for the other half.
        middle = np.cumsum(turn, axis=1) - turn
        middle -= np.repeat(middle[:, starts], np.diff(np.append(starts, len(dt))), axis=1)
        middle += first
        # Of both halves: N_k dt/2 is what leads to the middle, so its product with either end of it is the same.
        area = cross(middle.T, turn.T).T
        moment = dt * middle + 0.5 * half * (second - first)
        sums = np.add.reduceat(np.vstack([dt, turn, moment, area, force]), starts, axis=1).T.copy()
        return Slots(
            start_s=samples.time_s[starts],
            duration_s=sums[:, 0],
            turn=sums[:, 1:4],
            moment=sums[:, 4:7],
            area=sums[:, 7:10],
            force=sums[:, 10:],
            bridge=np.add.reduceat(bridge, starts),
            flags=np.bitwise_or.reduceat(flags, starts),
            plateau=self._plateau(N, starts),
        )

    def _flags(self, status: NDArray[np.uint32], dt: FloatArray, stood: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """Return the flags of the intervals ``dt`` between samples of this status, in some of which the clock stood."""
        interval_s, flags = self.interval_s or 0.0, np.zeros(len(dt), dtype=np.uint8)
        flags[dt > _LOST_INTERVALS * interval_s] |= np.uint8(SlotFlag.BRIDGED)
        flags[dt > max(_BRIDGED_S, _BRIDGED_INTERVALS * interval_s)] |= np.uint8(SlotFlag.LOST)
        is_set = (status[1:] & np.uint32(Status.CLOCK_SET)) != 0
        flags[(dt < 0) | stood | is_set] |= np.uint8(SlotFlag.CLOCK_JUMP)
        # An interval has the flags of both of its samples.
        for what, flag in _OF_STATUS.items():
            seen = (status & np.uint32(what)) != 0
            if seen.any():
                flags[seen[:-1] | seen[1:]] |= np.uint8(flag)
        return flags

    def _plateau(self, N: FloatArray, starts: IntArray) -> FloatArray:
        """Return the largest output (of shape (3, n + 1)) in each slot that was repeated often enough, NaN elsewhere."""
        place = np.arange(1, N.shape[1])
        last_change = np.maximum.accumulate(np.where(np.diff(N, axis=1) == 0, 0, place), axis=1)
        run = place - last_change + np.where(last_change == 0, self._flat[:, None], 0)
        self._flat = run[:, -1]
        return np.fmax.reduceat(np.where(run >= PLATEAU - 1, N[:, 1:], np.nan), starts, axis=1).T

    def _compact(self) -> None:
        """Join the slots of the quieter half of the recording into cells of 0.1 s."""
        slots = stack_slots(self._parts)
        cell_starts = run_starts(interval_of(slots.start_s, CELL_S))
        rate = slots.turn / np.maximum(slots.duration_s, SHORTEST_SLOT_S)[:, None]
        swing = np.max(np.maximum.reduceat(rate, cell_starts) - np.minimum.reduceat(rate, cell_starts), axis=1)
        quiet = swing <= 2 * median(swing[swing > 0]) if np.any(swing > 0) else np.ones(len(swing), dtype=np.bool_)
        joined = join_runs(slots, cell_starts, quiet)
        self._parts, self._count = [joined], len(joined)
        self._compact_at = max(_COMPACT_AT, 2 * self._count)


@dataclass(frozen=True, slots=True, kw_only=True)
class Moves:
    """m moves between still intervals.

    Attributes
    ----------
    before, after : ndarray of int, shape (m,)
        Rows of the still intervals at both ends, as they were given.
    start_s, end_s : ndarray, shape (m,)
    first : ndarray of int, shape (m,)
        Row of the first slot of each move.
    slots : Slots
        Slots of all moves, one after the other.
    dropped : tuple of Sentence
        Of each stretch between two stills that cannot be used, why.
    """

    before: IntArray
    after: IntArray
    start_s: FloatArray
    end_s: FloatArray
    first: IntArray
    slots: Slots
    dropped: tuple[Sentence, ...] = ()

    def __len__(self) -> int:
        return len(self.before)

    @property
    def length(self) -> IntArray:
        """Slots of each move, shape (m,)."""
        return np.diff(np.append(self.first, len(self.slots)))

    @property
    def duration_s(self) -> FloatArray:
        """Time that the slots of each move cover, shape (m,)."""
        return np.add.reduceat(self.slots.duration_s, self.first)

    def without(self, out: NDArray[np.bool_], why: Sequence[Sentence]) -> Moves:
        """Return the moves without some of them, shape (m,), and why each of these cannot be used."""
        names, length = ("before", "after", "start_s", "end_s"), self.length[~out]
        kept = {name: getattr(self, name)[~out] for name in names}
        slots = self.slots[~np.repeat(out, self.length)]
        return replace(self, **kept, first=np.cumsum(length) - length, slots=slots, dropped=(*self.dropped, *why))


def cut_moves(
    slots: Slots,
    start_s: FloatArray,
    duration_s: FloatArray,
    ends: FloatArray | float = np.nan,
    resumed_s: FloatArray | None = None,
    *,
    middle_s: FloatArray | None = None,
) -> Moves:
    """Cut slots at still intervals; ``ends`` are those of the range of the outputs, shape (2, 3), NaN where it has none.

    Before an operator went on with the session, the last samples have the times ``resumed_s``, shape (k,). A unit in the hand
    sways: moves begin and end at ``middle_s``, shape (s,), NaN for one that lies still.
    """
    # Means that somebody else averaged have no time: nothing is known of what lies between them.
    order = np.argsort(start_s, kind="stable") if np.isfinite(start_s).all() else np.empty(0, dtype=np.int64)
    # A clock that jumps back must not hide what lies behind the jump; the move with the jump is dropped.
    rising_s, pauses_s = np.maximum.accumulate(slots.start_s), np.empty(0) if resumed_s is None else resumed_s
    stills, middles = np.stack([start_s, start_s + duration_s], axis=1)[order], _middles(middle_s, order)
    in_hand = np.isfinite(middles)
    if len(slots) and len(stills):
        latest = np.searchsorted(stills[:, 0], rising_s, side="right") - 1
        rate = slots.turn / np.maximum(slots.duration_s, SHORTEST_SLOT_S)[:, None]
        ends = without_table_rates(ends, rising_s, rate, slots.plateau, (latest >= 0) & (rising_s < stills[latest, 1]))
        stills = stretch_stills(*sum_cells(rising_s, slot_sums(slots)), stills=stills, in_hand=in_hand)
    edges = np.where(in_hand[:, None], middles[:, None], stills)
    kept: list[tuple[int, int, float, float, IntArray]] = []  # Stills before and after, begin and end, rows of the slots.
    dropped: list[Sentence] = []
    for k, (before, after) in enumerate(pairwise(order)):
        between = float(stills[k, 1]), float(stills[k + 1, 0])
        begin, end = float(edges[k, 1]), float(edges[k + 1, 0])
        low, high = (int(row) for row in np.searchsorted(rising_s, [begin - EDGE_MARGIN, end - EDGE_MARGIN]))
        fault = _fault(slots[low:high], begin, end, ends, between=between)
        # Where the operator had stopped there is nothing to check.
        if fault and fault.key == "moves.interrupted" and np.any((pauses_s >= begin - CELL_S) & (pauses_s <= end)):
            fault = sentence("moves.resumed", **fault.values)
        if fault is None:
            kept.append((int(before), int(after), begin, end, np.arange(low, high)))
        else:
            dropped.append(fault)
    before, after, begin_s, end_s, rows = zip(*kept, strict=True) if kept else ([],) * 5
    length = np.array([len(part) for part in rows], dtype=np.int64)
    return Moves(
        before=np.array(before, dtype=np.int64),
        after=np.array(after, dtype=np.int64),
        start_s=np.array(begin_s, dtype=np.float64),
        end_s=np.array(end_s, dtype=np.float64),
        first=np.cumsum(length) - length,
        slots=slots[np.concatenate(rows)] if kept else slots[:0],
        dropped=tuple(dropped),
    )


def _middles(middle_s: FloatArray | None, order: IntArray) -> FloatArray:
    return np.full(len(order), np.nan) if middle_s is None else middle_s[order]


def _fault(
    slots: Slots, begin: float, end: float, ends: FloatArray | float, *, between: tuple[float, float]
) -> Sentence | None:
    """Return why a move cannot be used, None if it can; outside ``between`` a hand holds the unit."""
    span = {"begin_s": begin, "end_s": end}
    if end - begin > _LONGEST_MOVE_S:
        return sentence("moves.too_long", longest_s=_LONGEST_MOVE_S, **span)
    if not len(slots):
        return sentence("moves.no_samples", **span)
    flags = int(np.bitwise_or.reduce(slots.flags))
    covered = float(slots.duration_s.sum())
    if flags & SlotFlag.CLOCK_JUMP:
        return sentence("moves.clock_jump", **span)
    in_hold = (slots.start_s < between[0]) | (slots.start_s >= between[1])
    # Within a hold in the hand sway is slow, and two lost cells have ended it.
    is_lost = ((slots.flags & np.uint8(SlotFlag.LOST)) != 0) & ~in_hold
    hole_s = float(slots.duration_s[is_lost].sum())
    if hole_s or covered < end - begin - _BRIDGED_S - CELL_S:
        missing_s = max(hole_s, end - begin - covered)
        key = "moves.interrupted" if missing_s >= _INTERRUPTED_S else "moves.lost_samples"
        return sentence(key, missing_s=missing_s, bridged_s=_BRIDGED_S, intervals=_BRIDGED_INTERVALS, **span)
    # An output that repeats itself at the end of its range is saturated too.
    if flags & SlotFlag.SATURATED or np.any(slots.plateau[:, None] == ends):
        return sentence("moves.saturated", **span)
    return sentence("moves.invalid_samples", **span) if flags & SlotFlag.INVALID else None
