"""SBG Systems units on CAN."""

from imufield.acquire.driver import Driver


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

    name = "sbg_can"
    title = "SBG Systems (CAN)"
    protocol = "sbg_can"
    wire = "can"
    bauds = (500_000, 1_000_000, 250_000, 125_000)
    status = "document only"
    manual = "SBG Systems sbgECom, can/sbgCan.dbc and doc/canProtocol.md"


DRIVER = SbgCan
