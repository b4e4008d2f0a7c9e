"""VectorNav VN-100, VN-200 and VN-300, ASCII output."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence


class VectorNavAscii(Driver):
    """VectorNav lines of text.

    A line is ``$VNIMU,number,...*XX`` with CR LF or LF: XX is the XOR of what stands between dollar and star, four digits
    are a CRC-16. VNIMU, VNYMR, VNQMR and VNMAR hold samples; other lines are kept as messages. Acceleration has a
    resolution of 0.001 m/s^2 only, which is too coarse for noise: prefer the binary output.
    """

    name: ClassVar[str] = "vectornav_ascii"
    title: ClassVar[str] = "VectorNav VN-100/200/300, ASCII"
    protocol: ClassVar[str] = "vectornav_ascii"
    default_baud: ClassVar[int] = 115200
    bauds: ClassVar[tuple[int, ...]] = (115200, 921600, 460800, 230400, 128000, 57600, 38400, 19200, 9600)
    status: ClassVar[Evidence] = "verified on real bytes"
    manual: ClassVar[str] = "VectorNav UM001, VN-100 User Manual rev. 2.22: asynchronous ASCII output, protocol control"


DRIVER = VectorNavAscii
