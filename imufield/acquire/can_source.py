"""CAN frames to samples without a time: the part of the decoder that knows a bus.

A block of packed frames is sorted by kind, grouped into samples, and read kind by kind with NumPy. Frames of samples that are
not settled yet are put back and read again in front of the next block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.can_assembly import NO_FRAME, Assembler, SampleFrames
from imufield.acquire.can_dbc import CanSignal
from imufield.acquire.can_frames import ERROR, REMOTE, CanFrames, Unpacker
from imufield.acquire.can_protocol import (
    ANY_ADDRESS,
    TEMPERATURE,
    CanFlag,
    CanKind,
    CanRule,
    Column,
    with_source_address,
)
from imufield.acquire.statistics import DecoderStatistics
from imufield.samples import INSTRUMENT_STATUS_SHIFT, NO_COUNTER, FloatArray, IntArray, Status

_NO_KIND, _SHORT = -1, -2
_VALUES = TEMPERATURE + 1
_ACCELEROMETER, _GYROSCOPE = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True)
class CanBlock:
    """n samples that have no time yet."""

    values: FloatArray
    """Accelerometer x, y, z, gyroscope x, y, z, temperature; NaN where not available. Shape (n, 7)."""
    status: NDArray[np.uint32]
    counter: IntArray
    """As sent; ``NO_COUNTER`` where there is none."""
    ticks: FloatArray
    """Time stamp of the instrument as sent; NaN where there is none. Shape (n,), or (0,) where the protocol has none."""
    stamp_s: FloatArray
    """Time stamp of the frame the sample begins with. Shape (n,)."""

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> CanBlock:
        ticks = self.ticks[rows] if len(self.ticks) else self.ticks
        return CanBlock(self.values[rows], self.status[rows], self.counter[rows], ticks, self.stamp_s[rows])


def join_blocks(blocks: list[CanBlock]) -> CanBlock:
    """Join at least one block."""
    if len(blocks) == 1:
        return blocks[0]
    return CanBlock(
        np.concatenate([block.values for block in blocks]),
        np.concatenate([block.status for block in blocks]),
        np.concatenate([block.counter for block in blocks]),
        np.concatenate([block.ticks for block in blocks]),
        np.concatenate([block.stamp_s for block in blocks]),
    )


class CanSource:
    """Reads packed frames.

    Parameters
    ----------
    rule : CanRule
    statistics : DecoderStatistics
    keep : callable
        Given every message that is no sample.
    """

    def __init__(self, rule: CanRule, statistics: DecoderStatistics, keep: Callable[[dict[str, Any]], None]) -> None:
        self._rule = rule
        self._statistics = statistics
        self._keep = keep
        self._unpacker = Unpacker()
        self._put_back = 0
        """Frames of the next block that were counted before."""
        self._address = rule.source_address
        self._kinds = [_KindReader(kind) for kind in rule.kinds]
        self._match_address()
        inertial = [any(column.place < TEMPERATURE for column in kind.columns) for kind in rule.kinds]
        self._assembler = Assembler(rule.assembly, len(rule.kinds), inertial)
        self._skipped = 0

    def feed(self, data: bytes) -> CanBlock | None:
        """Return the samples that are settled, None if there are none."""
        return self._read(self._unpacker.feed(data), last=False)

    def finish(self) -> CanBlock | None:
        """Return what was held back; nothing will follow."""
        return self._read(self._unpacker.feed(b"", last=True), last=True)

    def _read(self, frames: CanFrames, *, last: bool) -> CanBlock | None:
        new_from, self._put_back = self._put_back, 0
        kind = self._kinds_of(frames)
        self._count(frames, kind, new_from)
        places = np.flatnonzero(kind >= 0)
        if len(places) == 0:
            self._note_skipped(0)
            return None
        sample_frames = self._sample_frames(frames, kind, places)
        groups = self._assembler.group(sample_frames, last=last)
        if groups.keep_from < len(places):
            first = int(places[groups.keep_from])
            self._put_back = len(frames) - first
            self._unpacker.put_back(frames, first)
        self._note_skipped(groups.left_out)
        rows = np.where(groups.rows == NO_FRAME, NO_FRAME, places[groups.rows]) if len(groups.rows) else groups.rows
        return self._values(frames, rows) if len(rows) else None

    def _kinds_of(self, frames: CanFrames) -> NDArray[np.int64]:
        """Return the number of the kind of each frame, ``_NO_KIND`` for those of no sample. Shape (n,)."""
        if self._address == ANY_ADDRESS and len(frames):
            self._choose_address(frames)
        kind = np.full(len(frames), _NO_KIND)
        for number, reader in enumerate(self._kinds):
            hit = (frames.can_id & reader.mask) == reader.can_id
            if reader.selectors and hit.any():
                hit[hit] = reader.is_selected(frames, np.flatnonzero(hit))
            kind[hit] = number
        return kind

    def _choose_address(self, frames: CanFrames) -> None:
        """Stay with the first J1939 node that sends samples: two instruments mixed would be no instrument."""
        heard = np.zeros(len(frames), dtype=np.bool_)
        for reader in self._kinds:
            if reader.kind.message.is_j1939:
                heard |= (frames.can_id & reader.mask) == reader.can_id
        if heard.any():
            self._address = int(frames.can_id[int(np.argmax(heard))]) & 0xFF
            self._match_address()

    def _match_address(self) -> None:
        for reader in self._kinds:
            message = with_source_address(reader.kind.message, self._address)
            reader.mask, reader.can_id = np.uint32(message.mask | ERROR | REMOTE), np.uint32(message.can_id)

    def _count(self, frames: CanFrames, kind: NDArray[np.int64], new_from: int) -> None:
        """Drop frames that are too short; count the new frames by kind and hand out messages."""
        is_new = np.arange(len(frames)) >= new_from
        lacking = 0
        for number, reader in enumerate(self._kinds):
            own = kind == number
            short = own & (frames.size < reader.bytes_needed)
            if short.any():
                kind[short] = _SHORT
                own &= ~short
                here = int(np.count_nonzero(short & is_new))
                self._add(f"{reader.kind.name}, too short", here)
                lacking += here
            self._add(reader.kind.name, int(np.count_nonzero(own[new_from:])))
        self._statistics.frames += len(frames) - new_from - lacking
        self._statistics.frames_bad_checksum += lacking
        others = np.flatnonzero(kind[new_from:] == _NO_KIND) + new_from
        if len(others):
            self._count_others(frames, others)

    def _count_others(self, frames: CanFrames, others: IntArray) -> None:
        can_id = frames.can_id[others]
        errors = (can_id & np.uint32(ERROR)) != 0
        if errors.any():
            self._add("error frame", int(np.count_nonzero(errors)))
        taken = errors
        for message in self._rule.messages:
            bits = np.uint32(message.mask | ERROR | REMOTE)
            hit = (can_id & bits) == np.uint32(message.can_id)
            taken = taken | hit
            for place in others[hit].tolist():
                self._hand_out(frames, place, message.name)
        self._add("other", int(len(others) - np.count_nonzero(taken)))

    def _hand_out(self, frames: CanFrames, place: int, name: str) -> None:
        size = int(frames.size[place])
        data = frames.data(np.array([place]), 64)[0, :size].tobytes()
        self._add(name, 1)
        address = {"source_address": int(frames.can_id[place]) & 0xFF} if int(frames.can_id[place]) >> 31 else {}
        self._keep({"kind": name, **address, **self._rule.dbc.describe(name, data)})

    def _add(self, name: str, count: int) -> None:
        if count:
            self._statistics.by_kind[name] = self._statistics.by_kind.get(name, 0) + count

    def _note_skipped(self, left_out: int) -> None:
        self._add("without a sample", left_out)
        self._statistics.bytes_skipped = self._unpacker.bytes_skipped

    def _sample_frames(self, frames: CanFrames, kind: NDArray[np.int64], places: IntArray) -> SampleFrames:
        whole = len(places) == len(frames)
        own = kind if whole else kind[places]
        same = np.zeros(len(places), dtype=np.bool_)
        if len(self._kinds) > 1:
            unit = frames.unit if whole else frames.unit[places]
            data = frames.units[unit, 16:].view(np.uint64)[:, 0] if len(unit) else np.empty(0, dtype=np.uint64)
            same[1:] = (data[1:] == data[:-1]) & (own[1:] == own[:-1])
        group = None
        if self._rule.assembly.by_counter:
            group = np.zeros(len(places), dtype=np.int64)
            for number, reader in enumerate(self._kinds):
                mine = own == number
                if reader.kind.group is not None and mine.any():
                    group[mine] = reader.kind.group.raw(reader.data(frames, places[mine])).astype(np.int64)
        return SampleFrames(own, frames.time_s if whole else frames.time_s[places], same, group)

    def _values(self, frames: CanFrames, rows: IntArray) -> CanBlock:
        """Read the frames of n samples; ``rows`` has one column per kind."""
        n = len(rows)
        values = np.full((n, _VALUES), np.nan)
        status = np.zeros(n, dtype=np.uint32)
        counter = np.full(n, NO_COUNTER, dtype=np.int64)
        ticks = np.full(n if any(kind.time for kind in self._rule.kinds) else 0, np.nan)
        for number, reader in enumerate(self._kinds):
            there = rows[:, number] != NO_FRAME
            if there.all():
                reader.read(frames, rows[:, number], slice(None), values, status, counter, ticks)
            elif there.any():
                reader.read(frames, rows[there, number], there, values, status, counter, ticks)
        self._flag_gaps(values, status)
        first = np.where(rows == NO_FRAME, np.iinfo(np.int64).max, rows).min(axis=1) if rows.shape[1] > 1 else rows[:, 0]
        block = CanBlock(values, status, counter, ticks, frames.time_s[first])
        # What carries neither acceleration nor rate is no sample.
        empty = np.isnan(values[:, :TEMPERATURE]).all(axis=1) if (rows == NO_FRAME).any() else np.zeros(n, dtype=np.bool_)
        return block if not empty.any() else block[~empty]

    def _flag_gaps(self, values: FloatArray, status: NDArray[np.uint32]) -> None:
        for has, columns, flag in (
            (self._rule.has_accelerometer, _ACCELEROMETER, Status.ACCELEROMETER_INVALID),
            (self._rule.has_gyroscope, _GYROSCOPE, Status.GYROSCOPE_INVALID),
        ):
            # A sum is NaN if one of the three is: cheaper than asking each.
            gap = np.isnan(values[:, columns].sum(axis=1)) if has else None
            if gap is not None and gap.any():
                status[gap] |= np.uint32(flag)


class _KindReader:
    """Reads all frames of one kind."""

    def __init__(self, kind: CanKind) -> None:
        self.kind = kind
        self.selectors = kind.message.selectors
        self.bytes_needed = kind.bytes_needed
        self.mask = np.uint32(kind.message.mask)
        self.can_id = np.uint32(kind.message.can_id)
        self._triads, self._columns = _find_triads(kind.columns)

    def data(self, frames: CanFrames, which: IntArray) -> NDArray[np.uint8]:
        """Return the data of some frames."""
        return frames.data(which, 8 if self.bytes_needed <= 8 else 64)

    def is_selected(self, frames: CanFrames, which: IntArray) -> NDArray[np.bool_]:
        """Return which of the frames are of this multiplexed form."""
        data = self.data(frames, which)
        chosen = np.ones(len(which), dtype=np.bool_)
        for signal, allowed in self.selectors:
            chosen &= np.isin(signal.raw(data), allowed)
        return chosen

    def read(
        self,
        frames: CanFrames,
        which: IntArray,
        into: Any,
        values: FloatArray,
        status: NDArray[np.uint32],
        counter: IntArray,
        ticks: FloatArray,
    ) -> None:
        """Write values, flags, counter and time stamps of frames ``which`` into the rows ``into`` of a block."""
        data = self.data(frames, which)
        for triad in self._triads:
            self._read_triad(data, triad, into, values, status)
        for column in self._columns:
            raw = column.signal.raw(data)
            scaled = np.multiply(raw, column.factor, dtype=np.float64) + column.offset
            missing, fault = column.signal.gaps(raw)
            scaled[missing] = np.nan
            values[into, column.place] = scaled
            if column.place < TEMPERATURE:
                status[into] |= np.where(fault, np.uint32(Status.INSTRUMENT_FAULT), np.uint32(0))
        for flag in self.kind.flags:
            status[into] |= _flagged(flag, data)
        for signal, shift in self.kind.status:
            upper = signal.raw(data).astype(np.int64) << (INSTRUMENT_STATUS_SHIFT + shift)
            status[into] |= (upper & 0xFFFF0000).astype(np.uint32)
        if self.kind.counter is not None:
            counter[into] = self.kind.counter.raw(data).astype(np.int64)
        if self.kind.time is not None:
            ticks[into] = self.kind.time.raw(data).astype(np.float64)

    @staticmethod
    def _read_triad(data: NDArray[np.uint8], triad: _Triad, into: Any, values: FloatArray, status: NDArray[np.uint32]) -> None:
        raw = data[:, triad.at : triad.at + triad.size].view(triad.kind)
        scaled = np.multiply(raw, triad.factor, dtype=np.float64)
        if triad.has_offset:
            scaled += triad.offset
        # One comparison for all three finds out that there is nothing to do, which is nearly always so.
        if triad.codes_from is not None and (raw >= triad.codes_from).any():
            for place, signal in enumerate(triad.signals):
                missing, fault = signal.gaps(raw[:, place])
                scaled[missing, place] = np.nan
                status[into] |= np.where(fault, np.uint32(Status.INSTRUMENT_FAULT), np.uint32(0))
        values[into, triad.columns] = scaled[:, triad.order]


@dataclass(frozen=True, slots=True)
class _Triad:
    """Three neighbouring numbers of one type, read as one."""

    at: int
    size: int
    kind: str
    signals: tuple[CanSignal, ...]
    """In the order of the bytes, as are the following."""
    factor: FloatArray
    offset: FloatArray
    has_offset: bool
    order: IntArray
    """Which of the three is x, y, z."""
    columns: slice
    codes_from: float | None


def _find_triads(columns: list[Column]) -> tuple[list[_Triad], list[Column]]:
    """Return the triads among the columns, and what is left."""
    triads, left = [], list(columns)
    for first in (0, 3):
        three = sorted((column for column in left if first <= column.place < first + 3), key=lambda one: one.signal.start)
        if len(three) == 3 and (triad := _triad(three, first)) is not None:
            triads.append(triad)
            left = [column for column in left if column not in three]
    return triads, left


def _triad(three: list[Column], first: int) -> _Triad | None:
    kind, size = three[0].signal.number_type, three[0].signal.length // 8
    at = [column.signal.first_byte for column in three]
    same = all(column.signal.number_type == kind and column.signal.codes == three[0].signal.codes for column in three)
    if kind is None or kind[1] == "f" or not same or at != [at[0], at[0] + size, at[0] + 2 * size]:
        return None
    codes = three[0].signal.codes
    places = [column.place - first for column in three]
    offset = np.array([column.offset for column in three])
    return _Triad(
        at[0],
        3 * size,
        kind,
        tuple(column.signal for column in three),
        np.array([column.factor for column in three]),
        offset,
        bool(offset.any()),
        np.argsort(places),
        slice(first, first + 3),
        min(code.low for code in codes) if codes else None,
    )


def _flagged(flag: CanFlag, data: NDArray[np.uint8]) -> NDArray[np.uint32]:
    raw = flag.signal.raw(data).astype(np.int64)
    hit = np.isin(raw, flag.values) if flag.values else (raw & flag.mask) != 0
    return np.where(hit ^ flag.when_clear, np.uint32(flag.flag), np.uint32(0))
