"""Bytes to samples: the one way from an instrument's stream, live or recorded, into imufield.

Pure: no input or output, no clock, no logging. What comes out depends on the bytes alone and not on how they are cut into
feeds, except where host arrival time is used because the stream cannot tell (``Status.TIME_ESTIMATED`` and
``Status.GAP_ESTIMATED``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.clock.sample_clock import Arrivals, SampleClock
from imufield.acquire.decode.assembly import FrameJoin, FrameReader, RawBlock, join
from imufield.acquire.decode.frame_check import distinct
from imufield.acquire.decode.framing import FrameBlock, Framer
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decode.text_lines import LineReader
from imufield.acquire.protocol.frame_schema import FrameRule
from imufield.acquire.protocol.layout import Field
from imufield.acquire.protocol.protocol import Protocol
from imufield.acquire.protocol.samples_and_clock import NANOSECONDS, ClockRule
from imufield.samples import FloatArray, IntArray, Samples, Status, concatenate, no_samples

if TYPE_CHECKING:
    from imufield.acquire.protocol.can_protocol import CanRule

_INCOMPLETE = np.uint32(Status.ACCELEROMETER_INVALID | Status.GYROSCOPE_INVALID)
# Larger feeds are worked off in pieces of this size: memory stays bounded, and the pieces stay in cache.
_PIECE_BYTES = 1 << 18
# Messages kept until somebody fetches them: identity comes first, a stream of the same kind must not fill memory.
_MESSAGES_KEPT = 1000

_LONGEST_WRAP_NS = 2.0**62  # Stamps of 64 bits do not wrap while a program runs.


class Decoder:
    """Turns the stream of one instrument into samples.

    Parameters
    ----------
    protocol : Protocol

    Examples
    --------
    >>> from imufield.acquire.protocol.protocol import load_protocol
    >>> decoder = Decoder(load_protocol("stim300", {"accelerometer_range_g": 30}))
    >>> len(decoder.feed(b"noise", arrival_s=0.0))
    0
    """

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.statistics = DecoderStatistics()
        self._messages: list[dict[str, Any]] = []
        # A source and the clock that takes its blocks; those of a CAN bus are imported where one is used.
        self._source: Any
        self._clock: Any
        if protocol.can is not None:
            self._source, self._clock = _can_parts(protocol, protocol.can, self.statistics, self._keep)
            return
        if protocol.frame is not None:
            self._source = _FrameSource(protocol, protocol.frame, self.statistics, self._keep)
        else:
            self._source = LineReader(protocol, self.statistics, self._keep)
        self._clock = SampleClock(_clock_rule(protocol), protocol.units, self.statistics)

    def feed(self, data: bytes, arrival_s: float = math.nan) -> Samples:
        """Take the bytes of one read; return the samples that are settled now, in order.

        Parameters
        ----------
        data : bytes
        arrival_s : float
            Host time when the last of them arrived, s; leave it out where it is not known.
        """
        return self.feed_chunks(data, np.array([len(data)]), np.array([arrival_s]))

    def feed_chunks(self, data: bytes, ends: IntArray, arrival_s: FloatArray) -> Samples:
        """Take the bytes of k reads at once; the same as k calls of ``feed``, many times faster for small reads.

        Parameters
        ----------
        data : bytes
            The reads, joined.
        ends : ndarray of int64, shape (k,)
            Where each ends in ``data``; the last is ``len(data)``.
        arrival_s : ndarray, shape (k,)
            Host time when the last byte of each arrived, s; NaN where not known.
        """
        arrivals = Arrivals(ends + self.statistics.bytes_total, np.asarray(arrival_s, dtype=np.float64))
        self.statistics.bytes_total += len(data)
        done: list[Samples] = []
        for at in range(0, len(data), _PIECE_BYTES):
            block = self._source.feed(data[at : at + _PIECE_BYTES])
            timed = None if block is None else self._clock.push(block, arrivals)
            if timed is not None:
                done.append(timed)
        return self._joined(done)

    def flush(self) -> Samples:
        """Return what was held back; nothing will follow."""
        block = self._source.finish()
        never = Arrivals(np.array([self.statistics.bytes_total]), np.array([math.nan]))
        timed = [] if block is None else [self._clock.push(block, never)]
        return self._joined([samples for samples in (*timed, self._clock.flush()) if samples is not None])

    def messages(self) -> list[dict[str, Any]]:
        """Return the messages that are no samples (identity, configuration, errors) since the last call.

        Each is a dict with "kind" and the fields of the message by name.
        """
        messages, self._messages = self._messages, []
        return messages

    def _keep(self, message: dict[str, Any]) -> None:
        if len(self._messages) < _MESSAGES_KEPT:
            self._messages.append(message)

    def _joined(self, blocks: list[Samples]) -> Samples:
        for block in blocks:
            self.statistics.samples_incomplete += int(np.count_nonzero(block.status & _INCOMPLETE))
        if len(blocks) == 1:
            return blocks[0]
        return concatenate(blocks) if blocks else no_samples(self.protocol.units)


def _can_parts(protocol: Protocol, rule: CanRule, statistics: DecoderStatistics, keep: Any) -> tuple[Any, Any]:
    from imufield.acquire.clock.can_clock import CanClock
    from imufield.acquire.decode.can_source import CanSource

    return CanSource(rule, statistics, keep), CanClock(protocol.clock, protocol.units, rule.counter_steps, statistics)


class _FrameSource:
    """Frames of all kinds, read kind by kind and put back into the order of the stream."""

    def __init__(self, protocol: Protocol, rule: FrameRule, statistics: DecoderStatistics, keep: Any) -> None:
        self._framer = Framer(rule)
        self._protocol = protocol
        self._join = FrameJoin(rule.join) if rule.join else None
        self._readers: dict[int, FrameReader | None] = {}
        self._statistics = statistics
        self._keep = keep

    def feed(self, data: bytes) -> RawBlock | None:
        return self._read(self._framer.feed(data))

    def finish(self) -> RawBlock | None:
        return self._read(self._framer.feed(b"", last=True))

    def _read(self, block: FrameBlock) -> RawBlock | None:
        self._statistics.bytes_skipped = self._framer.bytes_skipped
        self._statistics.frames_bad_checksum = self._framer.frames_bad_checksum
        if len(block) == 0:
            return None
        self._statistics.frames += len(block)
        shapes = block.shapes
        keys = distinct(shapes)
        readers = {key: reader for key in keys if (reader := self._reader(key)) is not None}
        if len(readers) < len(keys):
            self._read_others(block, [key for key in keys if key not in readers])
        if len(keys) == len(readers) == 1 and self._join is None:
            return self._read_kind(block, keys[0], readers[keys[0]], None)
        places = [np.flatnonzero(block.shapes == key) for key in readers]
        parts = [self._read_kind(block, key, readers[key], place) for key, place in zip(readers, places, strict=True)]
        if not parts:
            return None
        if self._join is None and len(parts) == 1:
            return parts[0]
        order = np.argsort(np.concatenate(places), kind="stable")
        if self._join is None:
            return join(parts)[order]
        numbers = [self._join.kinds.index(self._framer.layout(key).kind) for key in readers]
        return self._join.add(np.repeat(numbers, [len(place) for place in places])[order], join(parts)[order])

    def _reader(self, key: int) -> FrameReader | None:
        """Return the reader for a kind of frame, made when the first one comes; None for those without samples."""
        if key not in self._readers:
            layout = self._framer.layout(key)
            takes_part = not layout.is_message and (self._join is None or layout.kind in self._join.kinds)
            reader = FrameReader(self._protocol, layout) if takes_part else None
            self._readers[key] = reader if reader is not None and reader.has_samples else None
        return self._readers[key]

    def _read_kind(self, block: FrameBlock, key: int, reader: FrameReader, which: NDArray[np.intp] | None) -> RawBlock:
        rows = block.rows(which, reader.length)
        self._count(self._framer.layout(key).kind, len(rows))
        starts = block.starts + block.origin
        if which is None:
            return reader.read(rows, block.skipped_before, starts)
        return reader.read(rows, block.skipped_before[which], starts[which])

    def _read_others(self, block: FrameBlock, keys: list[int]) -> None:
        """Count frames that are no samples; keep those that are messages, in the order of the stream."""
        layouts = {key: self._framer.layout(key) for key in keys}
        for key, layout in layouts.items():
            self._count(layout.kind, int(np.count_nonzero(block.shapes == key)))
        kept = [key for key, layout in layouts.items() if layout.is_message]
        which = np.isin(block.shapes, kept) if kept else np.zeros(len(block), dtype=np.bool_)
        for start, key in zip(block.starts[which].tolist(), block.shapes[which].tolist(), strict=True):
            layout = layouts[key]
            self._keep({"kind": layout.kind, **layout.describe(block.data[start : start + layout.length].tobytes())})

    def _count(self, kind: str, number: int) -> None:
        by_kind = self._statistics.by_kind
        by_kind[kind] = by_kind.get(kind, 0) + number


def _clock_rule(protocol: Protocol) -> ClockRule:
    """Return the clock's rule with what the fields of the stream add: their moduli, and which of them are there."""
    rule = protocol.clock
    if protocol.lines is not None:
        columns = protocol.lines.columns
        return replace(
            rule,
            counter_field=rule.counter_field if rule.counter_field in columns else "",
            time_field=rule.time_field if rule.time_field in columns else "",
        )
    fields = {field.name: field for field in reversed(protocol.frame.all_fields())} if protocol.frame else {}
    if rule.counter_field and not rule.counter_modulus:
        rule = replace(rule, counter_modulus=fields[rule.counter_field].modulus)
    if rule.times:
        return replace(rule, time_modulus=rule.time_modulus or _longest_wrap(rule, fields))
    if rule.time_field and not rule.time_modulus and fields[rule.time_field].type in ("u8", "u16", "u24", "u32"):
        rule = replace(rule, time_modulus=fields[rule.time_field].modulus)
    return rule


def _longest_wrap(rule: ClockRule, fields: Mapping[str, Field]) -> int:
    """Return after how many ns the longest of several time stamps wraps; 0 where none does."""
    wraps = [fields[time.field].modulus * NANOSECONDS / time.ticks_per_s for time in rule.times]
    return round(max((wrap for wrap in wraps if wrap < _LONGEST_WRAP_NS), default=0))
