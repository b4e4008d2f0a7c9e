"""Frames of a serial stream to samples without a time: the source behind every binary protocol.

The framer cuts the stream into frames; all frames of one kind are read together, with NumPy (``acquire.protocol.layout``),
scaled to SI units, and put back into the order of the stream. Frames that are no samples are handed out as messages.
"""

from __future__ import annotations

from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.assembly import ABSENT, NO_TICKS, FrameJoin, Keep, RawBlock, Ticks, instrument_bits, join
from imufield.acquire.decode.frame_check import distinct, frames_at
from imufield.acquire.decode.framing import EvenBlock, FrameBlock, Framer
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.frame_schema import FrameRule
from imufield.acquire.protocol.layout import Field, FieldPair, Frames, Layout
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import NANOSECONDS, FlagRule
from imufield.dataclass import dataclass
from imufield.samples import LARGEST_OUTPUT, TRIADS, FloatArray, IntArray, Status, no_counters, unknown

_Triads = FloatArray | list[FloatArray]  # Acceleration and rate.
_FAR = 2.0**62  # Bound on time stamps in ns, for bits that are no time.


class FrameSource:
    """Reads frames of all kinds, kind by kind.

    Parameters
    ----------
    protocol : Protocol
    rule : FrameRule
    statistics : DecoderStatistics
    keep : callable
        Is given every message that is no sample.
    """

    def __init__(self, protocol: Protocol, rule: FrameRule, statistics: DecoderStatistics, keep: Keep) -> None:
        self._framer = Framer(rule)
        self._protocol = protocol
        self._join = FrameJoin(rule.join) if rule.join else None
        self._readers: dict[int, _FrameReader | None] = {}
        self._cycles: dict[tuple[int, ...], _Cycle | None] = {}
        self._statistics = statistics
        self._keep = keep

    def feed(self, data: bytes) -> RawBlock | None:
        """Return the samples of the frames that are complete now, None if there are none."""
        return self._read(self._framer.feed(data))

    def finish(self) -> RawBlock | None:
        """Return what was kept back; nothing will follow."""
        return self._read(self._framer.feed(b"", last=True))

    def _read(self, block: FrameBlock | EvenBlock) -> RawBlock | None:
        self._statistics.bytes_skipped = self._framer.bytes_skipped
        self._statistics.frames_bad_checksum = self._framer.frames_bad_checksum
        if len(block) == 0:
            return None
        self._statistics.frames += len(block)
        if isinstance(block, EvenBlock) and (cycle := self._cycle(block.cycle)) is not None:
            return self._read_even(block, cycle)
        keys = distinct(block.shapes)
        readers = {key: reader for key in keys if (reader := self._reader(key)) is not None}
        if len(readers) < len(keys):
            self._read_others(block, [key for key in keys if key not in readers])
        # Nearly always: one kind of frame, whose rows are a view and need no sorting.
        if len(keys) == len(readers) == 1 and self._join is None:
            return self._read_kind(block, readers[keys[0]], slice(None))
        if not readers:
            return None
        places = [(block.shapes == key).nonzero()[0] for key in readers]
        parts = [self._read_kind(block, reader, place) for reader, place in zip(readers.values(), places, strict=True)]
        if self._join is None and len(parts) == 1:
            return parts[0]
        # Read kind by kind, the samples go back to the order of the stream.
        order = np.argsort(np.concatenate(places), kind="stable")
        if self._join is None:
            return join(parts)[order]
        numbers = [self._join.kinds.index(reader.kind) for reader in readers.values()]
        return self._join.add(np.repeat(numbers, [len(place) for place in places])[order], join(parts)[order])

    def _reader(self, key: int) -> _FrameReader | None:
        """Return the reader for a kind of frame, made when the first one comes; None for those without samples."""
        if key not in self._readers:
            layout = self._framer.layout(key)
            takes_part = not layout.is_message and (self._join is None or layout.kind in self._join.kinds)
            reader = _FrameReader(self._protocol, layout) if takes_part else None
            self._readers[key] = reader if reader is not None and reader.has_samples else None
        return self._readers[key]

    def _cycle(self, shapes: tuple[int, ...]) -> _Cycle | None:
        """Return how frames are read whose shapes come in this cycle; None for those that are to be read kind by kind."""
        if shapes not in self._cycles:
            layouts = [self._framer.layout(shape) for shape in shapes]
            readers = [(place, reader) for place, shape in enumerate(shapes) if (reader := self._reader(shape)) is not None]
            numbers = [self._join.kinds.index(reader.kind) for _, reader in readers] if self._join else []
            needed = len(readers) == 1 if self._join is None else sorted(numbers) == list(range(len(self._join.kinds)))
            is_plain = needed and not any(layout.is_message for layout in layouts)
            self._cycles[shapes] = _Cycle([layout.kind for layout in layouts], readers, numbers) if is_plain else None
        return self._cycles[shapes]

    def _read_even(self, block: EvenBlock, cycle: _Cycle) -> RawBlock | None:
        each = [block.of_place(place) for place in range(len(block.cycle))]
        for kind, frames in zip(cycle.kinds, each, strict=True):
            self._statistics.count(kind, frames.count)
        parts = [reader.read_even(each[place], block.origin) for place, reader in cycle.readers]
        if self._join is None:
            return parts[0]
        return self._join.add_cycles(cycle.numbers, parts, [reader.has for _, reader in cycle.readers])

    def _read_kind(self, block: FrameBlock | EvenBlock, reader: _FrameReader, which: NDArray[np.intp] | slice) -> RawBlock:
        starts = block.starts[which]
        self._statistics.count(reader.kind, len(starts))
        frames = frames_at(block.data, starts, reader.length)
        skipped = np.zeros(len(starts)) if block.skipped_before is None else block.skipped_before[which] / reader.length
        ends = starts + (block.origin + reader.length)
        if block.seen_until is not None:
            ends = np.maximum(ends, block.seen_until[which])
        return reader.read(frames, skipped, ends)

    def _read_others(self, block: FrameBlock | EvenBlock, keys: list[int]) -> None:
        """Count frames that are no samples; keep those that are messages, in the order of the stream."""
        layouts = {key: self._framer.layout(key) for key in keys}
        for key, layout in layouts.items():
            self._statistics.count(layout.kind, int(np.count_nonzero(block.shapes == key)))
        kept = [key for key, layout in layouts.items() if layout.is_message]
        if not kept:
            return
        which = np.isin(block.shapes, kept)
        for start, key in zip(block.starts[which].tolist(), block.shapes[which].tolist(), strict=True):
            layout = layouts[key]
            self._keep({"kind": layout.kind, **layout.describe(block.data[start : start + layout.length].tobytes())})


@dataclass(frozen=True, slots=True)
class _Cycle:
    """Frames whose kinds come one after the other, again and again."""

    kinds: list[str]
    readers: list[tuple[int, _FrameReader]]
    """Of those with samples, and the place of each in the cycle."""
    numbers: list[int]
    """Numbers of their kinds where they are joined."""


class _FrameReader:
    """Reads the samples out of frames of one kind. Made once for each kind."""

    def __init__(self, protocol: Protocol, layout: Layout) -> None:
        rule = protocol.samples
        self.kind, self.length = layout.kind, layout.length
        self._triads = [_TriadReader(protocol, layout, triad) for triad in TRIADS]
        temperatures = layout.fields_of(rule.temperature.fields)
        self._temperature = temperatures[0] if temperatures else None
        self._to_degc = protocol.factors["temperature"]
        # Which of the values are there at all, in the order of a block.
        self.has = (self._triads[0].is_whole, self._triads[1].is_whole, self._temperature is not None)
        self._pair = _TriadPair.of(self._triads[0], self._triads[1], layout.length)
        self._may_be_garbage = any(field.type[0] == "f" for triad in self._triads for field in triad.fields)
        # False for frames that carry other things, e.g. a magnetometer alone.
        self.has_samples = any(triad.fields for triad in self._triads)
        sensors = [rule.quantity(triad).sensor_temperature for triad in TRIADS]
        self._of_sensors = [(place, field) for place, name in enumerate(sensors) if (field := layout.field(name))]
        read = [*self._triads[0].fields, *self._triads[1].fields, *temperatures, *(field for _, field in self._of_sensors)]
        self._has_fractions = any(field.type[0] == "f" for field in read)
        self._counter = layout.field(protocol.clock.counter_field)
        # Of imported rows, whose counter is one beside their time, a number below 0 stands for none.
        self._modulus = 0 if protocol.clock.counter_counts_others else protocol.clock.counter_modulus
        self._ticks = _TickReader(protocol, layout)
        self._status = _StatusReader(protocol, layout)

    def read_even(self, frames: Frames, origin: int) -> RawBlock:
        """Return the samples of frames with nothing passed over before them, in a buffer that stands there in the stream."""
        end = origin + frames.at + self.length
        ends = np.arange(end, end + frames.count * frames.step, frames.step, dtype=np.int64)
        return self.read(frames, np.zeros(frames.count), ends)

    def read(self, frames: Frames, skipped_before: FloatArray, ends: IntArray) -> RawBlock:
        """Return the samples of n frames, known at ``ends`` of the stream; ``skipped_before`` counts bytes as frames."""
        n = frames.count
        if self._has_fractions:
            # Without a checksum any bits arrive as numbers; what is none is flagged below.
            with np.errstate(over="ignore", invalid="ignore"):
                values = self._values(frames)
        else:
            values = self._values(frames)
        triads, temperature_degc, own_degc = values
        status = self._status.read(frames)
        if self._may_be_garbage:
            _flag_garbage(triads, status)
        return RawBlock(
            accelerometer=triads[0],
            gyroscope=triads[1],
            temperature_degc=temperature_degc,
            counter=no_counters(n) if self._counter is None else self._counter.counts(frames, self._modulus),
            ticks=self._ticks.read(frames),
            status=status,
            lost_before=np.zeros(n, dtype=np.int64),
            skipped_before=skipped_before,
            stream_end=ends,
            sensor_temperature_degc=own_degc,
        )

    def _values(self, frames: Frames) -> tuple[_Triads, FloatArray, FloatArray]:
        """Return acceleration and rate, temperature, and the temperatures of the axes."""
        triads = [triad.read(frames) for triad in self._triads] if self._pair is None else self._pair.read(frames)
        temperature_degc = (
            unknown(frames.count) if self._temperature is None else _degc(self._temperature, self._to_degc, frames)
        )
        return triads, temperature_degc, self._sensor_temperatures(frames) if self._of_sensors else ABSENT

    def _sensor_temperatures(self, frames: Frames) -> FloatArray:
        """Return what the thermometers of the axes show, shape (n, 6)."""
        found = unknown((frames.count, 6))
        for place, field in self._of_sensors:
            found[:, 3 * place : 3 * place + 3] = field.raw(frames).reshape(frames.count, -1) * field.factor + field.offset
        return found


def _degc(field: Field, scale: float, frames: Frames) -> FloatArray:
    """Return a temperature, the mean of those in its field, shape (n,)."""
    raw = field.raw(frames)
    total: FloatArray = raw.astype(np.float64) if raw.ndim == 1 else raw.sum(axis=1, dtype=np.float64)
    return total * (field.factor * scale / field.count) + field.offset * scale


def _flag_garbage(triads: _Triads, status: NDArray[np.uint32]) -> None:
    """Flag values of acceleration and rate that no instrument can have sent."""
    values = np.asarray(triads)
    # The sum of the squares tells that there are none; a half leaves room for rounding.
    if np.vdot(values, values) < LARGEST_OUTPUT**2 / 2:
        return
    impossible = np.asarray(~(np.abs(values) <= LARGEST_OUTPUT).all(axis=2))
    status[impossible[0]] |= np.uint32(Status.ACCELEROMETER_INVALID)
    # Three NaN of a gyroscope mean that there is none.
    status[impossible[1] & ~np.isnan(values[1]).all(axis=1)] |= np.uint32(Status.GYROSCOPE_INVALID)


class _TriadReader:
    """Reads three axes from one field of three values or from three fields of one."""

    def __init__(self, protocol: Protocol, layout: Layout, part: str) -> None:
        quantity = protocol.samples.quantity(part)
        self.fields = layout.fields_of(quantity.fields)
        self.is_whole = sum(field.count for field in self.fields[:3]) >= 3
        # From each field's own unit to SI.
        self._factors = [protocol.factor(part, field) for field in self.fields]
        # The scale that holds while status bits of the frame are set, relative to the usual one.
        when = quantity.scale_when
        self._when = None if when is None else layout.field(when.field)
        self._mask, self._ratio = (0, 1.0) if when is None else (when.mask, when.scale / quantity.scale)

    @property
    def is_plain(self) -> bool:
        """Whether it is one field that is only scaled."""
        return self.is_whole and self.fields[0].count == 3 and not self.fields[0].offset and self._when is None

    @property
    def factor(self) -> float:
        """From numbers as sent to SI units, where the field is only scaled."""
        return self.fields[0].factor * self._factors[0]

    def read(self, frames: Frames) -> FloatArray:
        """Return the values in SI units, NaN where the frame has none. Shape (n, 3)."""
        if not self.is_whole:
            return unknown((frames.count, 3))
        if self.fields[0].count == 3:
            values = _scaled(self.fields[0], self._factors[0], frames)
        else:
            each = zip(self.fields, self._factors, strict=True)
            values = np.column_stack([_scaled(field, factor, frames) for field, factor in each])
        if self._when is not None:
            values[(self._when.raw(frames).astype(np.int64) & self._mask) != 0] *= self._ratio
        return values


def _scaled(field: Field, factor: float, frames: Frames) -> FloatArray:
    values: FloatArray = np.multiply(field.raw(frames), field.factor * factor, dtype=np.float64)
    return values + field.offset * factor if field.offset else values


class _TriadPair:
    """Reads acceleration and rate at once, where both are one field of three values of the same type."""

    def __init__(self, fields: FieldPair, factors: tuple[float, float]) -> None:
        self._fields = fields
        self._factors = np.array(factors).reshape(2, 1, 1)

    @classmethod
    def of(cls, first: _TriadReader, second: _TriadReader, length: int) -> _TriadPair | None:
        """Return a reader for the two, None where they are of different kinds."""
        if not (first.is_plain and second.is_plain and FieldPair.fits(first.fields[0], second.fields[0], length)):
            return None
        return cls(FieldPair(first.fields[0], second.fields[0]), (first.factor, second.factor))

    def read(self, frames: Frames) -> FloatArray:
        """Return the values in SI units, shape (2, n, 3)."""
        # Each triad in one piece of memory, as whoever works with them is faster so.
        return np.asarray(np.multiply(self._fields.raw(frames), self._factors, dtype=np.float64, order="C"))


class _StatusReader:
    """Turns the status fields of frames into flags and instrument bits."""

    def __init__(self, protocol: Protocol, layout: Layout) -> None:
        rule = protocol.samples
        shifts = dict(rule.instrument_status)
        names = dict.fromkeys([flag.field for flag in rule.flags] + [name for name, _ in rule.instrument_status])
        self._fields = [
            _StatusField(field, [flag for flag in rule.flags if flag.field == name], shifts.get(name))
            for name in names
            if (field := layout.field(name)) is not None
        ]
        columns = [column for each in self._fields for column in range(each.field.at, each.field.at + each.field.size)]
        self._begin, self._end = min(columns, default=0), max(columns, default=-1) + 1
        self._mask = np.zeros(self._end - self._begin, dtype=np.uint8)
        self._mask[np.array(columns, dtype=np.intp) - self._begin] = 255
        self._usual, self._usual_bits = b"", np.uint32(0)

    def read(self, frames: Frames) -> NDArray[np.uint32]:
        """Return the status of n samples, shape (n,)."""
        if not self._fields:
            return np.zeros(frames.count, dtype=np.uint32)
        sent = (frames.columns(self._begin, self._end) & self._mask).tobytes()
        # A status seldom changes: those of a block are compared with the last one, all at once.
        if sent == self._usual[: len(sent)]:
            status = np.empty(frames.count, dtype=np.uint32)
            status.fill(self._usual_bits)
            return status
        status = reduce(or_, [field.read(frames) for field in self._fields])
        first = sent[: len(self._mask)]
        if sent == (repeated := first * frames.count):
            self._usual, self._usual_bits = repeated, status[0]
        return status


class _StatusField:
    """Turns one status field into flags and instrument bits; by table where the field is a byte."""

    def __init__(self, field: Field, flags: list[FlagRule], shift: int | None) -> None:
        self.field = field
        self._flags = flags
        self._shift = shift
        self._table = self._translate(np.arange(256)) if field.size == 1 else None

    def read(self, frames: Frames) -> NDArray[np.uint32]:
        raw = self.field.raw(frames)
        # A field of one byte is a whole number already: it is the place in the table.
        return self._translate(raw.astype(np.int64)) if self._table is None else self._table[raw.astype(np.uint8, copy=False)]

    def _translate(self, raw: IntArray) -> NDArray[np.uint32]:
        status = np.zeros(len(raw), dtype=np.uint32)
        for flag in self._flags:
            status |= flag.bits(raw)
        return status if self._shift is None else status | instrument_bits(raw, self._shift)


class _TickReader:
    """Reads the time stamp, or the first of several in ns; fills in where a frame has none but the protocol knows one."""

    def __init__(self, protocol: Protocol, layout: Layout) -> None:
        rule = protocol.clock
        self._has_time = bool(rule.time_field)
        self._field = layout.field(rule.time_field)
        self._factor = 0.0
        for time in reversed(rule.times):
            if found := layout.field(time.field):
                self._field, self._factor = found, NANOSECONDS / time.ticks_per_s
        # What stands for a missing stamp must fit the type of those that are there: the block has one array of them.
        known = protocol.frame.sample_fields() if protocol.frame and not rule.times else []
        fractions = any(field.name == rule.time_field and field.type[0] == "f" for field in known)
        self._missing: float | int = np.nan if fractions else NO_TICKS

    def read(self, frames: Frames) -> Ticks:
        """Return the time stamps of n frames, shape (n,), or (0,) where the protocol has none."""
        if self._field is None:
            return np.full(frames.count, self._missing) if self._has_time else ABSENT
        raw = self._field.raw(frames)
        is_fraction = raw.dtype.kind == "f"
        if not self._factor:
            return raw.astype(np.float64 if is_fraction else np.int64)
        if not is_fraction:
            return raw.astype(np.int64) * np.int64(self._factor)
        # Seconds of a week: in ns they stay below 2^53, so nothing is lost by rounding.
        far: FloatArray = np.nan_to_num(np.rint(raw * self._factor), nan=0, posinf=0, neginf=0)
        return far.clip(-_FAR, _FAR).astype(np.int64)
