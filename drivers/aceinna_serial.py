"""Aceinna OpenIMU and DMU38x/IMU38x on a serial port."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence


class AceinnaSerial(Driver):
    """Aceinna packets that begin with 55 55.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0, 1    0x55 0x55
    2, 3    two letters: z1, s1 (OpenIMU, little-endian), S1, S0 (DMU, big-endian)
    4       length of the payload
    from 5  payload
    last 2  CRC-16 from the letters on, high byte first
    ======  ==============================================================

    z1, s1 and S1 were checked on recordings; S0 comes from the manual alone. S1 numbers no packets: its counter is a time.
    """

    name: ClassVar[str] = "aceinna_serial"
    title: ClassVar[str] = "Aceinna OpenIMU, DMU38x, IMU38x (serial)"
    protocol: ClassVar[str] = "aceinna_serial"
    default_baud: ClassVar[int] = 115200
    bauds: ClassVar[tuple[int, ...]] = (115200, 57600, 38400, 230400, 460800)
    status: ClassVar[Evidence] = "verified on real bytes"
    manual: ClassVar[str] = "OpenIMU serial messaging, openimu.readthedocs.io; Aceinna DMU38x user manual: packets S0, S1"


DRIVER = AceinnaSerial
