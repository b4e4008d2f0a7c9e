"""Xsens / Movella MTi on a serial port, MTData2."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence


class XsensMtData2(Driver):
    """Xsens MTi 1, 10, 100, 300, 600 and 700 series, in measurement mode.

    Every number is big-endian.

    ==========  ==============================================================
    bytes       content
    ==========  ==============================================================
    0           0xFA
    1           bus id, 0xFF of a single unit
    2           message id, 0x36 for data
    3           length of the data; 255: the two bytes behind have it
    from 4      packets: id (2 bytes), size (1), values
    last        makes the sum of all bytes but the first zero
    ==========  ==============================================================

    The two lowest bits of a packet's id tell the number format: float32, fixed 12.20, fixed 16.32 (fraction first), float64.
    Messages with GNSS data alone come in between, with an older time; they are no samples.
    """

    name: ClassVar[str] = "xsens_mtdata2"
    title: ClassVar[str] = "Xsens MTi"
    protocol: ClassVar[str] = "xsens_mtdata2"
    default_baud: ClassVar[int] = 115200
    bauds: ClassVar[tuple[int, ...]] = (115200, 921600, 460800, 230400, 2000000, 57600)
    status: ClassVar[Evidence] = "verified on real bytes"
    manual: ClassVar[str] = "Xsens MT0101P, MT Low Level Communication Protocol Documentation: Xbus messages, MTData2"


DRIVER = XsensMtData2
