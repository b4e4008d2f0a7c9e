"""One CAN frame as bytes, as a recording holds it; NumPy reads a block of them without a loop (``can_frames``).

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

from imufield.dataclass import dataclass

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
CONTINUATION = 0xFFFFFFFF
_MORE = struct.Struct("<I20s")
# Data bytes in the unit of a frame, and in each continuation.
FIRST_BYTES = 8
FURTHER_BYTES = 20


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
    first = _HEADER.pack(can_id, size, flags, MARK, time_s, data[:FIRST_BYTES])
    if size <= FIRST_BYTES:
        return first
    more = (_MORE.pack(CONTINUATION, data[at : at + FURTHER_BYTES]) for at in range(FIRST_BYTES, size, FURTHER_BYTES))
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
