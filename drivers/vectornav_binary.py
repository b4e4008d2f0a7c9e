"""VectorNav VN-100, VN-200 and VN-300, binary output."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence


class VectorNavBinary(Driver):
    """VectorNav binary output messages.

    Numbers are little-endian, the checksum is not.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0       0xFA
    1       groups, one bit each
    from 2  for each group a mask of 16 bits, one for each field
    then    the fields, by group, then by bit
    last 2  CRC-16 of all but the first byte, high byte first
    ======  ==============================================================

    No length is sent: a message with a bit that is not known cannot be read. z points down, so a level unit at rest shows
    about -9.8 m/s^2 there.
    """

    name: ClassVar[str] = "vectornav_binary"
    title: ClassVar[str] = "VectorNav VN-100/200/300, binary"
    protocol: ClassVar[str] = "vectornav_binary"
    default_baud: ClassVar[int] = 115200
    bauds: ClassVar[tuple[int, ...]] = (115200, 921600, 460800, 230400, 128000, 57600, 38400, 19200, 9600)
    status: ClassVar[Evidence] = "verified on real bytes"
    manual: ClassVar[str] = "VectorNav UM001, VN-100 User Manual rev. 2.22: binary output messages"


DRIVER = VectorNavBinary
