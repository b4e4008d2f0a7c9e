"""Frames of a serial stream to samples without a time: the source behind every binary protocol.

The framer cuts the stream into frames; all frames of one kind are read together, with NumPy, and put back into the order of
the stream. Frames that are no samples are handed out as messages.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.decode.assembly import NO_TICKS, FrameJoin, Keep, RawBlock, Ticks, instrument_bits, join
from imufield.acquire.decode.frame_check import distinct, rows_at
from imufield.acquire.decode.framing import FrameBlock, Framer
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.protocol.frame_schema import FrameRule
from imufield.acquire.protocol.layout import Field, Layout, Rows
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import NANOSECONDS, FlagRule
from imufield.samples import LARGEST_OUTPUT, NO_COUNTER, FloatArray, IntArray, Status, every

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
        self._statistics = statistics
        self._keep = keep

    def feed(self, data: bytes) -> RawBlock | None:
        """Return the samples of the frames that are complete now, None if there are none."""
        return self._read(self._framer.feed(data))

    def finish(self) -> RawBlock | None:
        """Return what was kept back; nothing will follow."""
        return self._read(self._framer.feed(b"", last=True))

    def _read(self, block: FrameBlock) -> RawBlock | None:
        self._statistics.bytes_skipped = self._framer.bytes_skipped
        self._statistics.frames_bad_checksum = self._framer.frames_bad_checksum
        if len(block) == 0:
            return None
        self._statistics.frames += len(block)
        keys = distinct(block.shapes)
        readers = {key: reader for key in keys if (reader := self._reader(key)) is not None}
        if len(readers) < len(keys):
            self._read_others(block, [key for key in keys if key not in readers])
        # Nearly always: one kind of frame, whose rows are a view and need no sorting.
        if len(keys) == len(readers) == 1 and self._join is None:
            return self._read_kind(block, readers[keys[0]], slice(None))
        if not readers:
            return None
        places = [np.flatnonzero(block.shapes == key) for key in readers]
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

    def _read_kind(self, block: FrameBlock, reader: _FrameReader, which: NDArray[np.intp] | slice) -> RawBlock:
        starts = block.starts[which]
        self._statistics.count(reader.kind, len(starts))
        rows = rows_at(block.data, starts, reader.length)
        ends = np.maximum(starts + (block.origin + reader.length), block.seen_until[which])
        return reader.read(rows, block.skipped_before[which], ends)

    def _read_others(self, block: FrameBlock, keys: list[int]) -> None:
        """Count frames that are no samples; keep those that are messages, in the order of the stream."""
        layouts = {key: self._framer.layout(key) for key in keys}
        for key, layout in layouts.items():
            self._statistics.count(layout.kind, int(np.count_nonzero(block.shapes == key)))
        kept = [key for key, layout in layouts.items() if layout.is_message]
        which = np.isin(block.shapes, kept) if kept else np.zeros(len(block), dtype=np.bool_)
        for start, key in zip(block.starts[which].tolist(), block.shapes[which].tolist(), strict=True):
            layout = layouts[key]
            self._keep({"kind": layout.kind, **layout.describe(block.data[start : start + layout.length].tobytes())})


class _FrameReader:
    """Reads the samples out of frames of one kind. Made once for each kind."""

    def __init__(self, protocol: Protocol, layout: Layout) -> None:
        rule = protocol.samples
        self.kind, self.length = layout.kind, layout.length
        self._triads = [_TriadReader(protocol, layout, part) for part in ("accelerometer", "gyroscope")]
        self._may_be_garbage = any(field.type[0] == "f" for triad in self._triads for field in triad.fields)
        # False for frames that carry other things, e.g. a magnetometer alone.
        self.has_samples = any(triad.fields for triad in self._triads)
        temperatures = layout.fields_of(rule.temperature.fields)
        self._temperature = temperatures[0] if temperatures else None
        sensors = [rule.quantity(part).sensor_temperature for part in ("accelerometer", "gyroscope")]
        # Empty where no kind of frame has any; a kind without them among others has NaN.
        self._of_sensors = [layout.field(name) for name in sensors] if any(sensors) else []
        self._counter = layout.field(protocol.clock.counter_field)
        self._ticks = _TickReader(protocol, layout)
        names = dict.fromkeys([flag.field for flag in rule.flags] + [name for name, _ in rule.instrument_status])
        self._status = [
            _StatusReader(field, [flag for flag in rule.flags if flag.field == name], dict(rule.instrument_status).get(name))
            for name in names
            if (field := layout.field(name)) is not None
        ]

    def read(self, rows: Rows, skipped_before: IntArray, ends: IntArray) -> RawBlock:
        """Return the samples of n frames, which are known at offsets ``ends`` of the stream."""
        n = len(rows)
        temperature_degc = np.full(n, np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            # Without a checksum any bits arrive as numbers; what is none is flagged below.
            accelerometer, gyroscope = (triad.read(rows) for triad in self._triads)
            if (field := self._temperature) is not None:
                raw = field.raw(rows)
                total: FloatArray = raw.astype(np.float64) if raw.ndim == 1 else raw.sum(axis=1, dtype=np.float64)
                temperature_degc = total * (field.factor / field.count) + field.offset
            own_degc = np.full((n, 6) if self._of_sensors else 0, np.nan)
            for place, own in enumerate(self._of_sensors):
                if own is not None:
                    own_degc[:, 3 * place : 3 * place + 3] = own.raw(rows).reshape(n, -1) * own.factor + own.offset
        status = np.zeros(n, dtype=np.uint32)
        for reader in self._status:
            status |= reader.read(rows)
        if self._may_be_garbage:
            if not every(possible := np.abs(accelerometer) <= LARGEST_OUTPUT):
                status[~possible.all(axis=1)] |= np.uint32(Status.ACCELEROMETER_INVALID)
            if not every(possible := np.abs(gyroscope) <= LARGEST_OUTPUT):
                # Three NaN of a gyroscope mean that there is none.
                status[~possible.all(axis=1) & ~np.isnan(gyroscope).all(axis=1)] |= np.uint32(Status.GYROSCOPE_INVALID)
        return RawBlock(
            accelerometer=accelerometer,
            gyroscope=gyroscope,
            temperature_degc=temperature_degc,
            counter=np.full(n, NO_COUNTER) if self._counter is None else self._counter.raw(rows).astype(np.int64),
            ticks=self._ticks.read(rows),
            status=status,
            lost_before=np.zeros(n, dtype=np.int64),
            skipped_before=skipped_before / self.length,
            stream_end=ends,
            sensor_temperature_degc=own_degc,
        )


class _TriadReader:
    """Reads three axes from one field of three values or from three fields of one."""

    def __init__(self, protocol: Protocol, layout: Layout, part: str) -> None:
        quantity = protocol.samples.quantity(part)
        self.fields = layout.fields_of(quantity.fields)
        self._is_whole = sum(field.count for field in self.fields[:3]) >= 3
        self._factor = protocol.factor(part, self.fields[0]) if self.fields else 1.0
        # The scale that holds while status bits of the frame are set, relative to the usual one.
        when = quantity.scale_when
        self._when = None if when is None else layout.field(when.field)
        self._mask, self._ratio = (0, 1.0) if when is None else (when.mask, when.scale / quantity.scale)

    def read(self, rows: Rows) -> FloatArray:
        """Return the values in SI units, NaN where the frame has none. Shape (n, 3)."""
        if not self._is_whole:
            return np.full((len(rows), 3), np.nan)
        if self.fields[0].count == 3:
            values = self._scaled(rows, self.fields[0])
        else:
            values = np.column_stack([self._scaled(rows, field) for field in self.fields])
        if self._when is not None:
            values[(self._when.raw(rows).astype(np.int64) & self._mask) != 0] *= self._ratio
        return values

    def _scaled(self, rows: Rows, field: Field) -> FloatArray:
        values: FloatArray = np.multiply(field.raw(rows), field.factor * self._factor, dtype=np.float64)
        return values + field.offset * self._factor if field.offset else values


class _StatusReader:
    """Turns one status field into flags and instrument bits; by table where the field is a byte."""

    def __init__(self, field: Field, flags: list[FlagRule], shift: int | None) -> None:
        self._field = field
        self._flags = flags
        self._shift = shift
        self._table = self._translate(np.arange(256)) if field.size == 1 else None

    def read(self, rows: Rows) -> NDArray[np.uint32]:
        raw = self._field.raw(rows)
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
        known = protocol.frame.all_fields() if protocol.frame and not rule.times else []
        fractions = any(field.name == rule.time_field and field.type[0] == "f" for field in known)
        self._missing: float | int = np.nan if fractions else NO_TICKS

    def read(self, rows: Rows) -> Ticks:
        """Return the time stamps of n frames, shape (n,), or (0,) where the protocol has none."""
        if self._field is None:
            return np.full(len(rows), self._missing) if self._has_time else np.empty(0)
        raw = self._field.raw(rows)
        is_fraction = raw.dtype.kind == "f"
        if not self._factor:
            return raw.astype(np.float64 if is_fraction else np.int64)
        if not is_fraction:
            return raw.astype(np.int64) * np.int64(self._factor)
        # Seconds of a week: in ns they stay below 2^53, so nothing is lost by rounding.
        far: FloatArray = np.nan_to_num(np.rint(raw * self._factor), nan=0, posinf=0, neginf=0)
        return far.clip(-_FAR, _FAR).astype(np.int64)
