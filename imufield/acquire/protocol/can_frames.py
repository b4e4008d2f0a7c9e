"""CAN frames as bytes: what a recording holds of a bus, packed so that NumPy reads a block without a loop.

A frame is one unit of 24 bytes, little-endian; a CAN FD frame of more than 8 bytes goes on in units behind it::

    offset  type  content
    0       u32   identifier; bit 31 extended (29 bits), bit 30 remote frame, bit 29 error frame, as in Linux SocketCAN
    4       u8    number of data bytes, 0 to 64
    5       u8    bit 0 CAN FD, bit 1 bit-rate switch, bit 2 error state indicator, bit 3 sent by this host,
                  bit 4 the time stamp is of the adapter's own clock
    6       u16   0xCA4E: tells a frame from anything else
    8       f64   time stamp in s: host's monotonic clock, or the adapter's (see bit 4), or that of a log file
    16      u8x8  data, zero behind the last byte

    continuation: u32 0xFFFFFFFF (no identifier has all flags set), then 20 more bytes of data
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imufield.samples import FloatArray, IntArray

UNIT_BYTES = 24
MARK = 0xCA4E
EXTENDED = 0x80000000
REMOTE = 0x40000000
ERROR = 0x20000000
ID_MASK = 0x1FFFFFFF
FD = 1
BIT_RATE_SWITCH = 2
ERROR_STATE = 4
SENT = 8
ADAPTER_TIME = 16
MOST_DATA = 64
BUS_OFF = 0x40
"""Bit in the identifier of an error frame: the controller has left the bus (Linux, include/uapi/linux/can/error.h)."""

_HEADER = struct.Struct("<IBBHd8s")
_CONTINUATION = 0xFFFFFFFF
_MORE = struct.Struct("<I20s")
_MARK_BYTES = MARK.to_bytes(2, "little")
_MARK_AT = 6
LATEST_S = 1e11
"""In the year 5138, if seconds since 1970."""
# Data bytes in the unit of a frame, and in each continuation.
_FIRST = 8
_FURTHER = 20

Units = NDArray[np.uint8]


def pack_frame(can_id: int, data: bytes, time_s: float = 0.0, flags: int = 0) -> bytes:
    """Return one frame as bytes.

    Parameters
    ----------
    can_id : int
        Identifier with ``EXTENDED``, ``REMOTE`` and ``ERROR`` as they apply.
    data : bytes
        At most 64.
    time_s : float
    flags : int
        ``FD``, ``BIT_RATE_SWITCH``, ``ERROR_STATE``, ``SENT``, ``ADAPTER_TIME``.
    """
    size = len(data)
    if size > MOST_DATA:
        raise ValueError(f"a CAN frame has at most {MOST_DATA} bytes, not {size}")
    first = _HEADER.pack(can_id, size, flags, MARK, time_s, data[:_FIRST])
    if size <= _FIRST:
        return first
    more = (_MORE.pack(_CONTINUATION, data[at : at + _FURTHER]) for at in range(_FIRST, size, _FURTHER))
    return first + b"".join(more)


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame, for people and for sending; blocks are ``CanFrames``."""

    can_id: int
    """With ``EXTENDED``, ``REMOTE`` and ``ERROR``."""
    data: bytes
    time_s: float = 0.0
    flags: int = 0

    @property
    def text(self) -> str:
        """The frame as candump prints it, e.g. ``0CF02A80#807F008080800000``."""
        width = 8 if self.can_id & EXTENDED else 3
        return f"{self.can_id & ID_MASK:0{width}X}#{self.data.hex().upper()}"


@dataclass(frozen=True, slots=True, kw_only=True)
class CanFrames:
    """n frames as arrays."""

    can_id: NDArray[np.uint32]
    """With ``EXTENDED``, ``REMOTE`` and ``ERROR``. Shape (n,)."""
    size: Units
    """Data bytes. Shape (n,)."""
    flags: Units
    """Shape (n,)."""
    time_s: FloatArray
    """Shape (n,)."""
    units: Units
    """All units of the block, shape (m, 24)."""
    unit: IntArray
    """Which of them is the first of each frame. Shape (n,)."""

    def __len__(self) -> int:
        return len(self.can_id)

    def data(self, which: IntArray, width: int) -> Units:
        """Return the first ``width`` data bytes of some frames, shape (k, width); zero where a frame has fewer.

        Parameters
        ----------
        which : ndarray of int64, shape (k,)
            Numbers of the frames.
        width : int
            At most 8 gives 8, anything above 64.
        """
        first = self.unit[which]
        if width <= _FIRST:
            # One number of 8 bytes for each frame is gathered several times faster than 8 of one.
            return np.asarray(self.units.view(np.uint64)[first, 2].view(np.uint8).reshape(-1, _FIRST))
        rows = np.zeros((len(which), _FIRST + 3 * _FURTHER), dtype=np.uint8)
        rows[:, :_FIRST] = self.units[first, 16:]
        for number in range(3):
            at = _FIRST + number * _FURTHER
            long = self.size[which] > at
            rows[long, at : at + _FURTHER] = self.units[first[long] + 1 + number, 4:]
        return rows[:, :MOST_DATA]


class Unpacker:
    """Cuts a stream of packed frames into blocks, however it is cut into reads.

    What is no frame is passed over and counted in ``bytes_skipped``.
    """

    def __init__(self) -> None:
        self.bytes_skipped = 0
        self._rest = b""

    def feed(self, data: bytes, *, last: bool = False) -> CanFrames:
        """Return the frames that are whole now.

        Parameters
        ----------
        data : bytes
        last : bool
            Nothing will follow: what cannot be completed counts as skipped.
        """
        data = self._rest + data if self._rest else data
        units = _units_of(data)
        is_first = _first_units(units)
        if is_first is None:
            data = self._only_units(data)
            units = _units_of(data)
            is_first = _first_units(units)
        whole = len(units) if last else _whole_units(units)
        self._rest = data[whole * UNIT_BYTES :]
        if last:
            self.bytes_skipped += len(self._rest)
            self._rest = b""
        first = np.arange(whole) if is_first is None else np.flatnonzero(is_first[:whole])
        return self._frames(units[:whole], first)

    def put_back(self, frames: CanFrames, first: int) -> None:
        """Take frames from ``first`` on back: the next call of ``feed`` returns them again."""
        if len(frames) == len(frames.units):
            self._rest = frames.units[first:].tobytes() + self._rest
            return
        lengths = 1 + _further_units(frames.size[first:])
        pieces = (frames.units[at : at + length] for at, length in zip(frames.unit[first:], lengths, strict=True))
        self._rest = b"".join(piece.tobytes() for piece in pieces) + self._rest

    def _frames(self, units: Units, first: IntArray) -> CanFrames:
        """Return the frames whose first units are these, if as many follow as their length needs; others lost some."""
        if len(first) and (len(first) < len(units) or units[:, 4].max() > _FIRST):
            follow = np.diff(np.append(first, len(units))) - 1
            good = follow == _further_units(units[first, 4])
            self.bytes_skipped += int(UNIT_BYTES * (len(units) - np.sum(1 + follow[good])))
            first = first[good]
        # Where every unit begins a frame, which is nearly always so, the arrays are views.
        rows = slice(None) if len(first) == len(units) else first
        return CanFrames(
            can_id=units.view("<u4")[rows, 0],
            size=units[rows, 4],
            flags=units[rows, 5],
            time_s=_possible(units.view("<f8")[rows, 1]),
            units=units,
            unit=first,
        )

    def _only_units(self, data: bytes) -> bytes:
        """Keep what looks like units; step byte by byte over the rest until a mark stands where one should."""
        kept, at = [], 0
        while at + UNIT_BYTES <= len(data):
            is_first = data[at + _MARK_AT : at + _MARK_AT + 2] == _MARK_BYTES and data[at + 4] <= MOST_DATA
            if is_first or data[at : at + 4] == _CONTINUATION.to_bytes(4, "little"):
                kept.append(data[at : at + UNIT_BYTES])
                at += UNIT_BYTES
                continue
            mark = data.find(_MARK_BYTES, at + _MARK_AT + 1)
            until = mark - _MARK_AT if mark >= 0 else max(len(data) - UNIT_BYTES + 1, at + 1)
            self.bytes_skipped += until - at
            at = until
        return b"".join(kept) + data[at:]


def _units_of(data: bytes) -> Units:
    end = len(data) - len(data) % UNIT_BYTES
    return np.frombuffer(data, dtype=np.uint8, count=end).reshape(-1, UNIT_BYTES)


def _possible(time_s: FloatArray) -> FloatArray:
    """Replace time stamps that are none, which a damaged recording may hold, by the one before."""
    if not len(time_s) or np.abs(time_s).max() < LATEST_S:
        return time_s
    good = np.abs(time_s) < LATEST_S
    place = np.maximum.accumulate(np.where(good, np.arange(len(time_s)), -1))
    return np.where(place >= 0, time_s[place], 0.0)


def _first_units(units: Units) -> NDArray[np.bool_] | None:
    """Return which units begin a frame, the others going on with one; None where some do neither."""
    is_first: NDArray[np.bool_] = (units.view("<u2")[:, 3] == MARK) & (units[:, 4] <= MOST_DATA)
    if is_first.all() or (units.view("<u4")[~is_first, 0] == _CONTINUATION).all():
        return is_first
    return None


def _further_units(size: Units) -> IntArray:
    return np.maximum(size.astype(np.int64) - _FIRST + _FURTHER - 1, 0) // _FURTHER


def _whole_units(units: Units) -> int:
    """Return how many units belong to frames that are complete."""
    if not len(units) or (units[-1, 4] <= _FIRST and units[-1, 3] != _CONTINUATION >> 24):
        return len(units)
    tail = units[-4:]
    words = tail.view("<u4")[:, 0]
    for back in range(1, len(tail) + 1):
        if words[-back] != _CONTINUATION:
            needed = 1 + int(_further_units(tail[-back : len(tail) - back + 1, 4])[0])
            return len(units) - back if needed > back else len(units)
    return len(units)


def unpack_frames(data: bytes) -> Iterator[Frame]:
    """Yield the frames of packed bytes one by one."""
    frames = Unpacker().feed(data, last=True)
    rows = frames.data(np.arange(len(frames)), int(frames.size.max(initial=0)))
    numbers = (frames.can_id.tolist(), frames.size.tolist(), frames.time_s.tolist(), frames.flags.tolist())
    for row, can_id, size, time_s, flags in zip(rows, *numbers, strict=True):
        yield Frame(can_id, b"" if can_id & REMOTE else row[:size].tobytes(), time_s, flags)
