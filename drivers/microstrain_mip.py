"""MicroStrain (HBK, formerly LORD) inertial sensors, MIP."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence


class MicroStrainMip(Driver):
    """MicroStrain 3DM-GX4, GX5, CV5, CV7, GQ7 and others that speak MIP.

    Every number is big-endian.

    ==========  ==============================================================
    bytes       content
    ==========  ==============================================================
    0, 1        0x75 0x65
    2           descriptor set, 0x80 for inertial data
    3           length of the payload
    from 4      fields: length (1 byte, it counts itself), descriptor (1), values
    last 2      two running sums modulo 256 over all bytes before
    ==========  ==============================================================

    Acceleration is in g, delta velocity in g s. A packet of set 0x80 without acceleration and rate is no sample.
    """

    name: ClassVar[str] = "microstrain_mip"
    title: ClassVar[str] = "MicroStrain 3DM series (MIP)"
    protocol: ClassVar[str] = "microstrain_mip"
    default_baud: ClassVar[int] = 115200
    bauds: ClassVar[tuple[int, ...]] = (115200, 921600, 460800, 230400, 57600, 19200, 9600)
    status: ClassVar[Evidence] = "verified on real bytes"
    manual: ClassVar[str] = "LORD MicroStrain, 3DM-GX5-25 Data Communications Protocol manual: MIP packets, IMU data set"


DRIVER = MicroStrainMip
