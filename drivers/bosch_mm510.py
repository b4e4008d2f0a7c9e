"""Bosch MM5.10 automotive yaw rate and acceleration sensor."""

from imufield.acquire.driver import Driver


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

    name = "bosch_mm510"
    title = "Bosch MM5.10 (CAN)"
    protocol = "bosch_mm510"
    wire = "can"
    bauds = (1_000_000, 500_000)
    status = "document only"
    manual = "public DBC text of an ABS M4 network, nodes ABS and DRS_MM5_10"


DRIVER = BoschMm510
