"""WitMotion WT901 and relatives."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence


class WitMotion(Driver):
    """WitMotion standard protocol.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0       0x55
    1       what: 0x51 acceleration, 0x52 angular rate, 0x53 angle, 0x54 magnetic
    2 to 9  four numbers of 16 bits, little-endian; the fourth is a temperature
    10      sum of all bytes before
    ======  ==============================================================

    A sample takes several frames, and nothing numbers them. The frames of Bluetooth (``--set form=bluetooth``, 20 bytes) and
    of memory cards (``--set form=card``, 28 bytes) have no checksum: damage in them goes unseen.
    """

    name: ClassVar[str] = "witmotion"
    title: ClassVar[str] = "WitMotion WT901, HWT90x"
    protocol: ClassVar[str] = "witmotion"
    default_baud: ClassVar[int] = 9600
    bauds: ClassVar[tuple[int, ...]] = (9600, 115200, 230400, 460800, 921600, 57600, 38400, 19200, 4800)
    status: ClassVar[Evidence] = "verified on real bytes"
    manual: ClassVar[str] = "WITMOTION WitStandardProtocol_JY901: standard protocol and register map"


DRIVER = WitMotion
