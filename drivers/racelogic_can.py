"""Racelogic IMU03 and IMU04 on CAN."""

from imufield.acquire.driver import Driver


class RacelogicCan(Driver):
    """Messages with 11-bit identifiers, two IEEE floats of 32 bits each, big-endian.

    ::

        ===  ===================  ==================
        id   bytes 0 to 3         bytes 4 to 7
        ===  ===================  ==================
        600  yaw rate, deg/s      x, g
        601  y, g                 temperature, degC
        602  pitch rate, deg/s    roll rate, deg/s
        603  z, g
        ===  ===================  ==================

    Yaw is positive clockwise and y positive to the left by the maker's pages, hence the sign in the protocol. Never tried
    on an instrument.
    """

    name = "racelogic_can"
    title = "Racelogic IMU03, IMU04 (CAN)"
    protocol = "racelogic_can"
    wire = "can"
    bauds = (500_000, 1_000_000, 250_000)
    status = "document only"
    manual = "Racelogic support pages, CAN output of IMU04"


DRIVER = RacelogicCan
