"""CAN frames to samples without a time: signals scaled and put in their places (bits: ``protocol.can_dbc``).

A block of packed frames is sorted by kind, grouped into samples, and read kind by kind with NumPy. Frames of samples that are
not settled yet are put back and read again in front of the next block. Values are written to their place in the sample as
they are read, not joined afterwards as those of serial frames are: on a bus every sample takes several frames.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.assembly import NO_FRAME, Keep, RawBlock, instrument_bits
from imufield.acquire.decode.can_assembly import Assembler, SampleFrames
from imufield.acquire.decode.statistics import LEFT_OUT, DecoderStatistics
from imufield.acquire.protocol.can_dbc import CanSignal
from imufield.acquire.protocol.can_frame import ERROR, EXTENDED, REMOTE
from imufield.acquire.protocol.can_frames import CanFrames, Unpacker
from imufield.acquire.protocol.can_protocol import ANY_ADDRESS, TEMPERATURE, CanKind, CanRule, Column
from imufield.acquire.protocol.samples_and_clock import FlagRule
from imufield.dataclass import dataclass
from imufield.samples import FloatArray, IntArray, Status, every, no_counters, unknown

_Flag = tuple[CanSignal, FlagRule]
_NO_KIND = -1
_SHORT = -2
_VALUES = TEMPERATURE + 1
_ACCELEROMETER = slice(0, 3)
_GYROSCOPE = slice(3, 6)


class CanSource:
    """Reads packed frames.

    Parameters
    ----------
    rule : CanRule
    statistics : DecoderStatistics
    keep : callable
        Is given every message that is no sample.
    """

    def __init__(self, rule: CanRule, statistics: DecoderStatistics, keep: Keep) -> None:
        self._rule = rule
        self._statistics = statistics
        self._keep = keep
        self._unpacker = Unpacker()
        self._put_back = 0  # Frames of the next block that were counted before.
        self._address = rule.source_address
        self._kinds = [_KindReader(kind) for kind in rule.kinds]
        self._match_address()
        # Where the values of a triad stand that samples have, and the flag of those that lack one.
        self._triads = [(_ACCELEROMETER, np.uint32(Status.ACCELEROMETER_INVALID))] * rule.has_accelerometer
        self._triads += [(_GYROSCOPE, np.uint32(Status.GYROSCOPE_INVALID))] * rule.has_gyroscope
        self._has_time = any(kind.time for kind in rule.kinds)
        self._inertial = [
            number for number, kind in enumerate(rule.kinds) if any(column.place < TEMPERATURE for column in kind.columns)
        ]
        # By number of a slower kind: data of its last frame, and how many samples ago that was.
        self._standing: dict[int, tuple[NDArray[np.uint8], int]] = {}
        self._bytes_needed = max(reader.bytes_needed for reader in self._kinds)
        self._assembler = Assembler(rule.assembly, [rule.dbc.identifier(kind.message.name) for kind in rule.kinds])

    def feed(self, data: bytes) -> RawBlock | None:
        """Return the samples that are settled, None if there are none."""
        return self._read(self._unpacker.feed(data), last=False)

    def finish(self) -> RawBlock | None:
        """Return what was kept back; nothing will follow."""
        return self._read(self._unpacker.feed(b"", last=True), last=True)

    def _read(self, frames: CanFrames, *, last: bool) -> RawBlock | None:
        new_from, self._put_back = self._put_back, 0
        kind = self._kinds_of(frames)
        self._count(frames, kind, new_from)
        places = (kind >= 0).nonzero()[0]
        if len(places) == 0:
            self._note_skipped(0)
            return None
        sample_frames = self._sample_frames(frames, kind, places)
        groups = self._assembler.group(sample_frames, last=last)
        if groups.keep_from < len(places):
            first = int(places[groups.keep_from])
            self._put_back = len(frames) - first
            # Bytes, not arrays, go back: a block begins with them as if they came in one read.
            self._unpacker.put_back(frames, first)
        self._note_skipped(groups.left_out)
        rows = groups.rows
        if len(rows) == 0:
            return None
        is_complete = every(rows >= 0)
        if len(places) < len(frames):
            # The assembler counts frames of samples only; from here on all frames of the block count.
            rows = places[rows] if is_complete else np.where(rows == NO_FRAME, NO_FRAME, places[rows])
        return self._values(frames, rows, is_complete)

    def _kinds_of(self, frames: CanFrames) -> NDArray[np.int8]:
        """Return the number of the kind of each frame, ``_NO_KIND`` for those of no sample. Shape (n,)."""
        if self._address == ANY_ADDRESS and len(frames):
            self._choose_address(frames)
        kind = np.full(len(frames), _NO_KIND, dtype=np.int8)
        masked: dict[int, NDArray[np.uint32]] = {}
        for number, reader in enumerate(self._kinds):
            bits = int(reader.mask)
            # Messages of one form have one mask; the identifiers are masked once for all of them.
            if bits not in masked:
                masked[bits] = frames.can_id & reader.mask
            hit = masked[bits] == reader.can_id
            if reader.selectors and hit.any():
                hit[hit] = reader.is_selected(frames, np.flatnonzero(hit))
            np.putmask(kind, hit, number)
        return kind

    def _choose_address(self, frames: CanFrames) -> None:
        """Stay with the first J1939 node that sends samples: two instruments mixed would be no instrument."""
        heard = np.zeros(len(frames), dtype=np.bool_)
        for reader in self._kinds:
            if reader.kind.message.is_j1939:
                # A frame that is too short for its signals is nobody's.
                heard |= ((frames.can_id & reader.mask) == reader.can_id) & (frames.size >= reader.bytes_needed)
        if heard.any():
            self._address = int(frames.can_id[int(np.argmax(heard))]) & 0xFF
            self._match_address()

    def _match_address(self) -> None:
        for reader in self._kinds:
            message = reader.kind.message
            is_chosen = message.is_j1939 and self._address != ANY_ADDRESS
            reader.mask = np.uint32(message.mask | ERROR | REMOTE | (0xFF if is_chosen else 0))
            reader.can_id = np.uint32(message.can_id | (self._address if is_chosen else 0))

    def _count(self, frames: CanFrames, kind: NDArray[np.int8], new_from: int) -> None:
        """Drop frames that end before their signals do; count the new frames by kind and hand out messages."""
        lacking = 0
        for number, reader in enumerate(self._kinds if not every(frames.size >= self._bytes_needed) else ()):
            short = (kind == number) & (frames.size < reader.bytes_needed)
            kind[short] = _SHORT
            here = int(np.count_nonzero(short[new_from:]))
            self._statistics.count(f"{reader.name}, too short", here)
            lacking += here
        counts = np.bincount(kind[new_from:] + 2, minlength=len(self._kinds) + 2).tolist()
        for reader, count in zip(self._kinds, counts[2:], strict=True):
            self._statistics.count(reader.name, count)
        self._statistics.frames += len(frames) - new_from - lacking
        self._statistics.frames_bad_checksum += lacking
        if counts[_NO_KIND + 2]:
            self._count_others(frames, np.flatnonzero(kind[new_from:] == _NO_KIND) + new_from)

    def _count_others(self, frames: CanFrames, others: IntArray) -> None:
        can_id = frames.can_id[others]
        errors = (can_id & np.uint32(ERROR)) != 0
        if errors.any():
            self._statistics.count("error frame", int(np.count_nonzero(errors)))
        taken = errors
        for message in self._rule.messages:
            bits = np.uint32(message.mask | ERROR | REMOTE)
            hit = (can_id & bits) == np.uint32(message.can_id)
            taken = taken | hit
            for place in others[hit].tolist():
                data = frames.data(np.array([place]), 64)[0, : int(frames.size[place])].tobytes()
                self._statistics.count(message.name, 1)
                # The lowest byte of an extended identifier of J1939 is who sent it.
                can_id_here = int(frames.can_id[place])
                address = {"source_address": can_id_here & 0xFF} if can_id_here & EXTENDED else {}
                self._keep({"kind": message.name, **address, **self._rule.dbc.describe(message.name, data)})
        self._statistics.count("other", int(len(others) - np.count_nonzero(taken)))

    def _note_skipped(self, left_out: int) -> None:
        self._statistics.count(LEFT_OUT, left_out)
        self._statistics.bytes_skipped = self._unpacker.bytes_skipped

    def _sample_frames(self, frames: CanFrames, kind: NDArray[np.int8], places: IntArray) -> SampleFrames:
        whole = len(places) == len(frames)
        own = kind if whole else kind[places]

        def is_repeated(which: IntArray) -> NDArray[np.bool_]:
            here, before = frames.data(places[which], 8), frames.data(places[which - 1], 8)
            return np.asarray((here == before).all(axis=1) & (own[which] == own[which - 1]))

        group = None
        if self._rule.assembly.group_modulus:
            group = np.zeros(len(places), dtype=np.int64)
            for number, reader in enumerate(self._kinds):
                mine = own == number
                if reader.kind.group is not None and mine.any():
                    group[mine] = reader.kind.group.count(reader.data(frames, places[mine]))
        return SampleFrames(own, frames.time_s if whole else frames.time_s[places], is_repeated, group)

    def _values(self, frames: CanFrames, rows: IntArray, is_complete: bool) -> RawBlock | None:
        """Read the frames of n samples; ``rows`` has one column per kind."""
        n = len(rows)
        into = Rows(
            values=unknown((_VALUES, n)),
            status=np.zeros(n, dtype=np.uint32),
            counter=no_counters(n),
            ticks=unknown(n if self._has_time else 0),
        )
        has_gaps = not is_complete
        for number, reader in enumerate(self._kinds):
            which = rows[:, number]
            if number in self._inertial and (each := self._assembler.samples_each[number]) > 1:
                has_gaps |= self._read_slower(frames, number, each, which, into=into)
            elif is_complete or every(which >= 0):
                has_gaps |= reader.read(reader.data(frames, which), into, slice(None))
            elif len(there := np.flatnonzero(which >= 0)):
                reader.read(reader.data(frames, which[there]), into, there)
        if has_gaps:
            for triad, flag in self._triads:
                into.status[~np.isfinite(into.values[triad]).all(axis=0)] |= flag
        block = RawBlock(
            accelerometer=into.values[_ACCELEROMETER].T,
            gyroscope=into.values[_GYROSCOPE].T,
            temperature_degc=into.values[TEMPERATURE],
            status=into.status,
            counter=into.counter,
            ticks=into.ticks,
            stamp_s=frames.time_s[rows[:, self._assembler.start]],
        )
        if is_complete:
            return block
        # What carries neither acceleration nor rate is no sample.
        block = block[np.asarray((rows[:, self._inertial] >= 0).any(axis=1))]
        return block if len(block) else None

    def _read_slower(self, frames: CanFrames, number: int, samples_each: int, which: IntArray, *, into: Rows) -> bool:
        """Read the frames of a kind that comes with some samples only; between them its values stand, and are flagged so."""
        reader, n = self._kinds[number], len(which)
        there = np.flatnonzero(which >= 0)
        data = reader.data(frames, which[there])
        has_gaps = bool(len(there)) and reader.read(data, into, there)
        before, age = self._standing.get(number, (data[:0], 0))
        data = np.concatenate([before, data])
        # Row of the frame whose values stand at each sample; negative: so many samples before this block.
        sent_row = np.maximum.accumulate(np.where(which >= 0, np.arange(n), -1 - age))
        age_of = np.arange(n) - sent_row
        place = np.cumsum(which >= 0) + len(before) - 1
        standing = np.flatnonzero((age_of > 0) & (age_of < samples_each) & (place >= 0))
        if len(standing):
            has_gaps |= reader.read(data[place[standing]], into, standing, values_only=True)
            into.status[standing] |= np.uint32(Status.STANDING)
            self._statistics.samples_standing += len(standing)
        self._standing[number] = data[-1:], int(age_of[-1])
        return has_gaps


@dataclass(slots=True)  # One for each read: a frozen one takes five times as long to make.
class Rows:
    """Arrays of a block being filled."""

    values: FloatArray
    """Shape (7, n): what is read is written one after another."""
    status: NDArray[np.uint32]
    counter: IntArray
    ticks: FloatArray


class _KindReader:
    """Reads all frames of one kind."""

    def __init__(self, kind: CanKind) -> None:
        self.kind = kind
        self.name = kind.name
        self.selectors = kind.message.selectors
        self.bytes_needed = kind.bytes_needed
        self.mask = np.uint32(kind.message.mask)
        self.can_id = np.uint32(kind.message.can_id)
        self._columns = [(each, min((code.low for code in each.signal.codes), default=None)) for each in kind.columns]
        # Acceleration and rate have three columns each, if any.
        threes = (self._columns[at : at + 3] for at in range(0, len(self._columns) - 2, 3))
        self._triads = [triad for columns in threes if (triad := _Triad.of(columns))]
        together = {column.place for triad in self._triads for column in triad.columns}
        self._others = [each for each in self._columns if each[0].place not in together]
        self._flag_tables, self._flags = _flag_tables(kind.flags)

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

    def read(self, data: NDArray[np.uint8], into: Rows, rows: slice | IntArray, *, values_only: bool = False) -> bool:
        """Write values, flags, counter and time stamps of frames into ``rows`` of a block; tell whether some have no value.

        Parameters
        ----------
        data : ndarray of uint8, shape (n, width)
        into : Rows
        rows : slice or ndarray of int64, shape (n,)
        values_only : bool
            Leave counter and time out.
        """
        kind, status = self.kind, into.status
        has_gaps, columns = False, self._columns
        if isinstance(rows, slice) and all(triad.read(data, into) for triad in self._triads):
            columns = self._others
        for column, lowest_code in columns:
            has_gaps |= _read_column(column, lowest_code, data, into=into, rows=rows)
        for at, table in self._flag_tables:
            status[rows] |= table[data[:, at]]
        for flag in self._flags:
            status[rows] |= _flagged(flag, data)
        for signal, shift in kind.status:
            status[rows] |= instrument_bits(signal.raw(data).astype(np.int64), shift)
        if values_only:
            return has_gaps
        if kind.counter is not None:
            into.counter[rows] = kind.counter.count(data, kind.counter_modulus)
        if kind.time is not None:
            into.ticks[rows] = kind.time.raw(data).astype(np.float64)
        return has_gaps


@dataclass(frozen=True, slots=True, kw_only=True)
class _Triad:
    """Three signals one behind another, whole numbers of one type, which are read at once."""

    columns: list[Column]
    begin: int
    number_type: np.dtype[np.number]
    factors: FloatArray
    offsets: FloatArray
    has_offsets: bool
    lowest_code: float
    """Smallest number that is no value of one of them."""

    @classmethod
    def of(cls, columns: list[tuple[Column, float | None]]) -> _Triad | None:
        """Return a reader for three columns, None where they do not stand so."""
        signals = [column.signal for column, _ in columns]
        first, kind = signals[0], signals[0].number_type
        size = first.length // 8
        stands = [
            (signal.number_type, signal.first_byte, column.place)
            == (kind, first.first_byte + size * at, columns[0][0].place + at)
            for at, ((column, _), signal) in enumerate(zip(columns, signals, strict=True))
        ]
        # An offset of 0 that is added turns -0.0 into 0.0.
        has_offsets = {bool(column.offset) for column, _ in columns}
        if kind is None or first.is_float or not all(stands) or len(has_offsets) > 1:
            return None
        return cls(
            columns=[column for column, _ in columns],
            begin=first.first_byte,
            number_type=np.dtype(kind),
            factors=np.array([[column.factor] for column, _ in columns]),
            offsets=np.array([[column.offset] for column, _ in columns]),
            has_offsets=any(has_offsets),
            lowest_code=min((lowest for _, lowest in columns if lowest is not None), default=math.inf),
        )

    def read(self, data: NDArray[np.uint8], into: Rows) -> bool:
        """Write the values of all frames; False where some may be none, and nothing is read."""
        raw = data[:, self.begin : self.begin + 3 * self.number_type.itemsize].view(self.number_type)
        if not every(raw < self.lowest_code):
            return False
        place = self.columns[0].place
        out = into.values[place : place + 3]
        np.multiply(raw.T, self.factors, out=out)
        if self.has_offsets:
            out += self.offsets
        return True


def _read_column(
    column: Column, lowest_code: float | None, data: NDArray[np.uint8], *, into: Rows, rows: slice | IntArray
) -> bool:
    """Write one value of each frame; tell whether some have none. ``lowest_code`` is the smallest number that is no value."""
    signal = column.signal
    raw = signal.raw(data)
    out = into.values[column.place] if isinstance(rows, slice) else None
    scaled: FloatArray
    if signal.is_float:
        # Any bits may stand in a float; what is no number is a gap.
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = np.multiply(raw, column.factor, out=out, dtype=np.float64)
    else:
        scaled = np.multiply(raw, column.factor, out=out)
    if column.offset:
        scaled += column.offset
    # One comparison finds that there is nothing to do, which is nearly always so.
    is_suspect = signal.is_float or (lowest_code is not None and bool(raw.max() >= lowest_code))
    if is_suspect:
        missing, fault = signal.gaps(raw)
        scaled[missing] = np.nan
        if column.place < TEMPERATURE:
            into.status[rows] |= np.where(fault, np.uint32(Status.INSTRUMENT_FAULT), np.uint32(0))
    if not isinstance(rows, slice):
        into.values[column.place, rows] = scaled
    return is_suspect


def _flag_tables(flags: list[_Flag]) -> tuple[list[tuple[int, NDArray[np.uint32]]], list[_Flag]]:
    """Return tables of 256 flags for the bytes that hold whole signals, and the flags that need more than a byte."""
    small = [(signal, rule) for signal, rule in flags if signal.bytes_needed == signal.first_byte + 1]
    tables = []
    for at in sorted({signal.first_byte for signal, _ in small}):
        each = np.zeros((256, at + 1), dtype=np.uint8)
        each[:, at] = np.arange(256)
        here = [_flagged(flag, each) for flag in small if flag[0].first_byte == at]
        tables.append((at, np.bitwise_or.reduce(here)))
    return tables, [flag for flag in flags if flag not in small]


def _flagged(flag: _Flag, data: NDArray[np.uint8]) -> NDArray[np.uint32]:
    signal, rule = flag
    return rule.bits(signal.raw(data).astype(np.int64))
