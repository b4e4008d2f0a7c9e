"""Frames one by one: packed, read from text, and all their fields; slow, and by other ways than the decoder's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from imufield.acquire.decode.framing import Framer
from imufield.acquire.protocol.can_dbc import CanSignal
from imufield.acquire.protocol.can_frame import EXTENDED, Frame, pack_frame
from imufield.acquire.protocol.layout import Rows
from imufield.acquire.protocol.protocol import Protocol
from imufield.samples import FloatArray


def pack_frames(frames: Iterable[Frame]) -> bytes:
    """Return frames as bytes."""
    return b"".join(pack_frame(frame.can_id, frame.data, frame.time_s, frame.flags) for frame in frames)


def parse_candump(text: str) -> Frame:
    """Return the frame written as ``ID#DATA``; an identifier of more than 3 digits is extended."""
    identifier, _, data = text.partition("#")
    return Frame(int(identifier, 16) | (EXTENDED if len(identifier) > 3 else 0), bytes.fromhex(data))


def decode_fields(protocol: Protocol, data: bytes) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every good frame in ``data`` as (kind, fields by name), raw and in its unit.

    Slow and complete, by another way than the decoder's.
    """
    if protocol.frame is None:
        return
    framer = Framer(protocol.frame)
    for block in (framer.feed(data), framer.feed(b"", last=True)):
        for start, key in zip(block.starts.tolist(), block.shapes.tolist(), strict=True):
            layout = framer.layout(key)
            yield layout.kind, layout.describe(block.data[start : start + layout.length].tobytes())


def values_of(signal: CanSignal, rows: Rows) -> FloatArray:
    """Return the numbers of a signal in its unit, NaN where a code says that there is none."""
    raw = signal.raw(rows)
    with np.errstate(over="ignore", invalid="ignore"):
        values = raw.astype(np.float64) * signal.factor + signal.offset
    return np.where(signal.gaps(raw)[0], np.nan, values)
