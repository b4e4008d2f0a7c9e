"""What a source hands to a clock: samples without a time yet, and how frames are put together to samples.

Serial frames, lines of text and CAN frames end in one kind of block, ``RawBlock``; what a wire does not have (a time stamp of
each frame, a place in a stream of bytes) is an empty array there.

A sample may take several frames: acceleration in one, angular rate in the next. It begins with one kind of frame and is
complete when each kind it needs has come. A serial stream has no time stamps, but it shows where bytes are missing: behind
a gap nothing tells which frames belong together, so ``FrameJoin`` begins anew there. A bus shows no gaps, but when each frame
came: ``can_assembly`` goes by that, and by counters. Both end in one table, ``frame_table``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import attrgetter, or_
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.frame_schema import JoinRule
from imufield.acquire.protocol.layout import MessageValue
from imufield.dataclass import dataclass, field, fields, replace
from imufield.samples import INSTRUMENT_STATUS_SHIFT, FloatArray, IntArray, unknown

Flags = NDArray[np.bool_]
Message = Mapping[str, MessageValue]
"""Something that is no sample: its "kind", and its fields by name."""
Keep = Callable[[Message], None]
"""Is given every message."""
Ticks = NDArray[np.int64 | np.float64]
"""Time stamps as sent."""

NO_TICKS = np.iinfo(np.int64).min
"""Time stamp of a sample that has none, where others have whole numbers; NaN where others have fractions."""
ABSENT = np.empty(0)
"""What the wire does not have."""
_ABSENT_COUNTS = np.empty(0, dtype=np.int64)
NO_FRAME = -1
"""Place of a frame that is missing."""


@dataclass(slots=True)  # One for each read: a frozen one takes five times as long to make.
class RawBlock:
    """n samples that have no time yet. NaN where a value is not available; shape (0,) for what the wire does not have."""

    accelerometer: FloatArray
    """Shape (n, 3)."""
    gyroscope: FloatArray
    """Shape (n, 3)."""
    temperature_degc: FloatArray
    """Shape (n,)."""
    counter: IntArray
    """As sent; ``NO_COUNTER`` where there is none. Shape (n,)."""
    status: NDArray[np.uint32]
    """Shape (n,)."""
    ticks: Ticks = field(default_factory=lambda: ABSENT)
    """Time stamp of the instrument as sent. Shape (n,), or (0,) where the protocol has none."""
    stamp_s: FloatArray = field(default_factory=lambda: ABSENT)
    """Time stamp that the host or the adapter gave to the frame the sample begins with. Shape (n,), of a bus only."""
    lost_before: IntArray = field(default_factory=lambda: _ABSENT_COUNTS)
    """Samples known to be lost just before this one, whatever the counter says (bad lines). Shape (n,), not of a bus."""
    skipped_before: FloatArray = field(default_factory=lambda: ABSENT)
    """Bytes passed over just before this sample, as a number of samples. Shape (n,), not of a bus."""
    stream_end: IntArray = field(default_factory=lambda: _ABSENT_COUNTS)
    """Offset in the stream just behind the last byte that must be there to know this sample. Shape (n,), not of a bus."""

    sensor_temperature_degc: FloatArray = field(default_factory=lambda: ABSENT)
    """Of the thermometers of the axes, shape (n, 6), or (0,) where no frame has any."""

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, rows: slice | Flags | NDArray[np.intp]) -> RawBlock:
        return RawBlock(*[part[rows] if len(part) else part for part in _parts_of(self)])


# Blocks are cut and joined for every read: this is twice as fast as one getattr after another.
_parts_of = attrgetter(*(part.name for part in fields(RawBlock)))


def join(blocks: Sequence[RawBlock]) -> RawBlock:
    """Join at least one block."""
    if len(blocks) == 1:
        return blocks[0]
    columns = list(zip(*map(_parts_of, blocks), strict=True))
    # Frames of some kinds only have the temperatures of the axes, the last column.
    own_degc = columns[-1]
    if any(part.ndim > 1 for part in own_degc):
        missing = (unknown((len(block), 6)) for block in blocks)
        columns[-1] = tuple(part if part.ndim > 1 else other for part, other in zip(own_degc, missing, strict=True))
    # Of one wire: what else the first block lacks no other has.
    return RawBlock(*[np.concatenate(parts) if len(parts[0]) else parts[0] for parts in columns])


class Source(Protocol):
    """Turns the bytes of a wire into samples without a time."""

    def feed(self, data: bytes) -> RawBlock | None:
        """Return the samples that are settled now, None if there are none."""
        ...

    def finish(self) -> RawBlock | None:
        """Return what was kept back; nothing will follow."""
        ...


def frame_table(kinds: NDArray[np.signedinteger], sample: IntArray, places: IntArray, *, shape: tuple[int, int]) -> IntArray:
    """Return where the frame of each kind stands in each sample, ``NO_FRAME`` where there is none.

    Parameters
    ----------
    kinds, sample, places : ndarray, shape (n,)
        Kind of each frame, number of the sample it belongs to, and what to return for it. Of several frames of one kind the
        last one given stays.
    shape : tuple of int
        Number of samples and of kinds.
    """
    table = np.full(shape[0] * shape[1], NO_FRAME)
    # By one index: with two NumPy chooses the order in which equal ones are written.
    table[sample * shape[1] + kinds] = places
    return table.reshape(shape)


def instrument_bits(raw: IntArray, shift: int) -> NDArray[np.uint32]:
    """Return a status field of the instrument as the upper bits of a sample's status. Shape (n,)."""
    return ((raw << (INSTRUMENT_STATUS_SHIFT + shift)) & 0xFFFF0000).astype(np.uint32)


def _filled(values: FloatArray, others: FloatArray) -> FloatArray:
    """Return values, those of others where there are none."""
    return np.where(np.isnan(values), others, values)


class FrameJoin:
    """Joins frames of several kinds, in the order of the stream.

    Parameters
    ----------
    rule : JoinRule
    """

    def __init__(self, rule: JoinRule) -> None:
        self.kinds = rule.needs  # Kinds that take part; their place here is their number.
        self._start = rule.needs.index(rule.starts_with)
        # Where several kinds have a value, that of the first one here counts.
        self._order = sorted(range(len(rule.needs)), key=lambda kind: kind != self._start)
        # Frames of a sample that is not complete yet, at most one of each kind.
        self._open: tuple[IntArray, RawBlock] | None = None
        self._lost = 0  # Samples that were not completed since the last good one.
        self._was_complete = False  # Whether the newest frame belongs to a complete sample.

    def add(self, kinds: IntArray, block: RawBlock) -> RawBlock | None:
        """Return the samples that are complete now.

        Parameters
        ----------
        kinds : ndarray, shape (n,)
            Number of the kind of each frame.
        block : RawBlock
            What each of the n frames has; NaN for what it has not.
        """
        carried = 0
        if self._open is not None:
            carried = len(self._open[0])
            kinds, block = np.concatenate([self._open[0], kinds]), join([self._open[1], block])
            self._open = None
        begins = kinds == self._start
        gaps = (block.skipped_before > 0) & ~begins
        # The gap before frames carried over was taken note of when they came.
        gaps[:carried] = False
        group = np.cumsum(begins | gaps)
        group -= group[0]
        rows = frame_table(kinds, group, np.arange(len(kinds)), shape=(int(group[-1]) + 1, len(self.kinds)))
        begun, behind_gap = np.zeros((2, len(rows)), dtype=np.bool_)
        begun[group[begins]] = True
        behind_gap[group[gaps]] = True
        complete = begun & (rows != NO_FRAME).all(axis=1)
        if begun[-1] and not complete[-1]:
            last = np.flatnonzero(group == group[-1])
            self._open = (kinds[last], block[last])
        lost = self._count_lost(begun, behind_gap, complete)
        return self._samples(block, rows[complete], lost) if complete.any() else None

    def add_cycles(self, numbers: Sequence[int], parts: Sequence[RawBlock], has: Sequence[tuple[bool, ...]]) -> RawBlock | None:
        """Return the same as ``add`` for frames whose kinds come one after the other, again and again, and nothing between.

        Parameters
        ----------
        numbers : sequence of int
            Number of the kind of each of the first frames, which the others repeat.
        parts : sequence of RawBlock
            The frames of each of these kinds.
        has : sequence of tuple of bool
            Whether each of these kinds has acceleration, rate and temperature at all.
        """
        begin = numbers.index(self._start)
        cycle = [*numbers[begin:], *numbers[:begin]]
        open_kinds: list[int] = [] if self._open is None else self._open[0].tolist()
        if self._lost or [*open_kinds, *numbers][: len(cycle)] != cycle:
            # In the order of the stream again: the first frames stand as the kinds do.
            places = [place + len(numbers) * np.arange(len(part)) for place, part in enumerate(parts)]
            order = np.argsort(np.concatenate(places))
            return self.add(np.repeat(numbers, [len(part) for part in parts])[order], join(parts)[order])
        by_kind = dict(zip(numbers, parts, strict=True))
        if self._open is not None:
            kept = self._open[1]
            by_kind |= {kind: join([kept[row : row + 1], by_kind[kind]]) for row, kind in enumerate(open_kinds)}
        count = len(by_kind[cycle[-1]])
        still_open = [kind for kind in cycle if len(by_kind[kind]) > count]
        self._open = (np.array(still_open), join([by_kind[kind][count:] for kind in still_open])) if still_open else None
        self._was_complete = not still_open
        if still_open:
            by_kind = {kind: part[:count] for kind, part in by_kind.items()}
        return self._samples_of(by_kind, dict(zip(numbers, has, strict=True)), cycle) if count else None

    def _samples_of(self, by_kind: dict[int, RawBlock], has: dict[int, tuple[bool, ...]], cycle: list[int]) -> RawBlock:
        """Return one sample for each row of the kinds; as ``_samples``, but what a kind never has is not looked at."""
        first = by_kind[self._start]

        def first_that_has(column: int, name: str) -> FloatArray:
            there = [getattr(by_kind[kind], name) for kind in self._order if has[kind][column]]
            return reduce(_filled, there or [getattr(first, name)])

        return RawBlock(
            accelerometer=first_that_has(0, "accelerometer"),
            gyroscope=first_that_has(1, "gyroscope"),
            temperature_degc=first_that_has(2, "temperature_degc"),
            counter=first.counter,
            status=reduce(or_, [part.status for part in by_kind.values()]),
            ticks=first.ticks,
            lost_before=first.lost_before,
            skipped_before=first.skipped_before,
            stream_end=by_kind[cycle[-1]].stream_end,
            sensor_temperature_degc=first.sensor_temperature_degc,
        )

    def _count_lost(self, begun: Flags, behind_gap: Flags, complete: Flags) -> IntArray:
        """Return how many samples were lost before each complete one, and keep the count of those behind the last."""
        state = complete.copy()
        state[0] |= self._was_complete & ~(begun[0] | behind_gap[0])
        previous = np.append(self._was_complete, state[:-1])
        # What follows a gap without a beginning is the rest of the sample before, unless that one was complete.
        failed = (begun & ~complete) | (behind_gap & previous)
        if self._open is not None:
            failed[-1] = False
        self._was_complete = bool(state[-1])
        total = np.append(0, np.cumsum(failed) + self._lost)
        at = np.append(0, np.flatnonzero(complete) + 1)
        self._lost = int(total[-1] - total[at[-1]])
        return np.asarray(np.diff(total[at]))

    def _samples(self, block: RawBlock, rows: IntArray, lost: IntArray) -> RawBlock:
        """Return one sample for each row: of each value the first frame that has it, flags of all."""
        first = block[rows[:, self._start]]
        values = {name: getattr(first, name) for name in ("accelerometer", "gyroscope", "temperature_degc")}
        status = first.status
        for kind in range(len(self.kinds)):
            if kind != self._start:
                own = rows[:, kind]
                values = {name: _filled(value, getattr(block, name)[own]) for name, value in values.items()}
                status = status | block.status[own]
        return replace(
            first,
            **values,
            status=status,
            lost_before=lost,
            skipped_before=lost.astype(np.float64),
            stream_end=block.stream_end[rows.max(axis=1)],
        )
