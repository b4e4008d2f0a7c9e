"""SBG Systems units on CAN."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence, Wire


class SbgCan(Driver):
    """Messages with 11-bit identifiers, little-endian.

    ::

        ====================  ===  ======================================================
        IMU information       120  u32 time in us, u16 status, i16 / 100 degC
        acceleration          121  3 x i16 / 100 m/s^2
        angular rate          122  3 x i16 / 1000 rad/s
        ====================  ===  ======================================================

    The time is the instrument's own, so losses are counted exactly. Never tried on an instrument.
    """

    name: ClassVar[str] = "sbg_can"
    title: ClassVar[str] = "SBG Systems (CAN)"
    protocol: ClassVar[str] = "sbg_can"
    wire: ClassVar[Wire] = "can"
    default_baud: ClassVar[int] = 500_000
    bauds: ClassVar[tuple[int, ...]] = (500_000, 1_000_000, 250_000, 125_000)
    status: ClassVar[Evidence] = "document only"
    manual: ClassVar[str] = "SBG Systems sbgECom, can/sbgCan.dbc and doc/canProtocol.md"


DRIVER = SbgCan
