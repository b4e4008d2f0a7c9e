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

    There is no pitch rate, so the accelerometer alone is read. Bosch prints bytes and identifiers, which are set by order, in
    its MM510 Calibration Sheet, and the scales in the manual of its ABS M5 kit, where the identifiers are 070, 080 and 576:
    copy the DBC file and change them. The other bytes are reserved. Never tried on an instrument.
    """

    name = "bosch_mm510"
    title = "Bosch MM5.10 (CAN)"
    protocol = "bosch_mm510"
    wire = "can"
    bauds = (1_000_000, 500_000)
    status = "document only"
    manual = "Bosch Engineering, MM510 Calibration Sheet, 2016: CAN matrix; Bosch Motorsport, ABS M5 Kit manual: CAN protocol"


DRIVER = BoschMm510
