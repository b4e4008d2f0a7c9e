"""Bytes to samples: the one way from an instrument's stream, live or recorded, into imufield.

Pure: no input or output, no clock, no logging. What comes out depends on the bytes alone and not on how they are cut into
feeds, except where host arrival time is used because the stream cannot tell (``Status.TIME_ESTIMATED`` and
``Status.GAP_ESTIMATED``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from imufield.acquire.assembly import FrameReader, RawBlock, join
from imufield.acquire.framing import FrameBlock, Framer
from imufield.acquire.layout import Layout
from imufield.acquire.protocol import Protocol
from imufield.acquire.protocol_schema import ClockRule, FrameRule
from imufield.acquire.sample_clock import SampleClock
from imufield.acquire.statistics import DecoderStatistics
from imufield.acquire.text_lines import LineReader
from imufield.samples import Samples, concatenate, no_samples

_PIECE_BYTES = 1 << 18
"""Larger feeds are worked off in pieces of this size: memory stays bounded, and the pieces stay in cache."""
_MESSAGES_KEPT = 1000
"""Messages kept until somebody fetches them: identity comes first, a stream of the same kind must not fill memory."""


class Decoder:
    """Turns the stream of one instrument into samples.

    Parameters
    ----------
    protocol : Protocol

    Examples
    --------
    >>> from imufield.acquire.protocol import load_protocol
    >>> decoder = Decoder(load_protocol("stim300", {"accelerometer_range_g": 30}))
    >>> len(decoder.feed(b"noise", arrival_s=0.0))
    0
    """

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.statistics = DecoderStatistics()
        self._messages: list[dict[str, Any]] = []
        self._source: _FrameSource | LineReader
        if protocol.frame is not None:
            self._source = _FrameSource(protocol, protocol.frame, self.statistics, self._keep)
        else:
            self._source = LineReader(protocol, self.statistics)
        self._clock = SampleClock(_clock_rule(protocol), protocol.units, self.statistics)

    def feed(self, data: bytes, arrival_s: float = math.nan) -> Samples:
        """Take the bytes of one read; return the samples that are settled now, in order.

        Parameters
        ----------
        data : bytes
        arrival_s : float
            Host time when the last of them arrived, s; leave it out where it is not known.
        """
        self.statistics.bytes_total += len(data)
        done: list[Samples] = []
        for at in range(0, len(data), _PIECE_BYTES):
            block = self._source.feed(data[at : at + _PIECE_BYTES])
            timed = None if block is None else self._clock.push(block, arrival_s)
            if timed is not None:
                done.append(timed)
        return self._joined(done)

    def flush(self) -> Samples:
        """Return what was held back; nothing will follow."""
        block = self._source.finish()
        timed = [] if block is None else [self._clock.push(block, math.nan)]
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
        if len(blocks) == 1:
            return blocks[0]
        return concatenate(blocks) if blocks else no_samples(self.protocol.units)


def decode_fields(protocol: Protocol, data: bytes) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every good frame in ``data`` as (kind, fields by name), raw and in its unit.

    Slow and complete: for tests, for looking at a stream, for protocols being written.
    """
    if protocol.frame is None:
        return
    framer = Framer(protocol.frame)
    for block in (framer.feed(data), framer.feed(b"", last=True)):
        for start, key in zip(block.starts.tolist(), block.keys.tolist(), strict=True):
            layout = protocol.frame.layouts[key]
            yield layout.kind, layout.describe(block.data[start : start + layout.length].tobytes())


class _FrameSource:
    """Frames of all kinds, read kind by kind and put back into the order of the stream."""

    def __init__(self, protocol: Protocol, rule: FrameRule, statistics: DecoderStatistics, keep: Any) -> None:
        self._rule = rule
        self._framer = Framer(rule)
        self._readers = {key: FrameReader(protocol, layout) for key, layout in rule.layouts.items()}
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
        first = int(block.keys[0])
        if (block.keys == first).all():
            return self._read_kind(block, first, None)
        parts: list[RawBlock] = []
        places = []
        for key in np.unique(block.keys).tolist():
            which = block.keys == key
            part = self._read_kind(block, key, which)
            if part is not None:
                parts.append(part)
                places.append(np.flatnonzero(which))
        if not parts:
            return None
        return join(parts)[np.argsort(np.concatenate(places), kind="stable")]

    def _read_kind(self, block: FrameBlock, key: int, which: Any) -> RawBlock | None:
        layout: Layout = self._rule.layouts[key]
        rows = block.rows(which, layout.length)
        by_kind = self._statistics.by_kind
        by_kind[layout.kind] = by_kind.get(layout.kind, 0) + len(rows)
        if layout.is_message:
            for row in rows:
                self._keep({"kind": layout.kind, **layout.describe(row.tobytes())})
            return None
        return self._readers[key].read(rows, block.after_skip if which is None else block.after_skip[which])


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
    layouts = protocol.frame.layouts.values() if protocol.frame else ()
    fields = {field.name: field for layout in layouts for field in layout.fields}
    if rule.counter_field and not rule.counter_modulus:
        rule = replace(rule, counter_modulus=fields[rule.counter_field].modulus)
    if rule.time_field and not rule.time_modulus and fields[rule.time_field].type in ("u8", "u16", "u24", "u32"):
        rule = replace(rule, time_modulus=fields[rule.time_field].modulus)
    return rule
