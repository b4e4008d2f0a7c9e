"""Bosch MM5.10 automotive yaw rate and acceleration sensor."""

from __future__ import annotations

from typing import ClassVar

from imufield.acquire.driver import Driver, Evidence, Wire


class BoschMm510(Driver):
    """Messages with 11-bit identifiers, words of 16 bits, little-endian, 0x8000 is zero.

    ::

        ===  ==================================  =========================================
        id   bytes 0 and 1                       bytes 4 and 5
        ===  ==================================  =========================================
        174  yaw rate, raw / 200 - 163.84 deg/s  y, raw * 0.000127465 - 4.1768 g
        178  roll rate, the same                 x, the same
        17C                                      z, the same
        ===  ==================================  =========================================

    There is no pitch rate, so the accelerometer alone is read. In the ABS M4 network of Bosch Motorsport the identifiers
    are 070, 080 and 576: copy the DBC file and change them. Status, counter and checksum are not public. Never tried on
    an instrument.
    """

    name: ClassVar[str] = "bosch_mm510"
    title: ClassVar[str] = "Bosch MM5.10 (CAN)"
    protocol: ClassVar[str] = "bosch_mm510"
    wire: ClassVar[Wire] = "can"
    default_baud: ClassVar[int] = 1_000_000
    bauds: ClassVar[tuple[int, ...]] = (1_000_000, 500_000)
    status: ClassVar[Evidence] = "document only"
    manual: ClassVar[str] = "public DBC text of an ABS M4 network, nodes ABS and DRS_MM5_10"


DRIVER = BoschMm510
