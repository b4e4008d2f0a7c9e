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

    By the maker's pages y is positive to the left, yaw clockwise and pitch with the nose up, hence the signs in the protocol.
    Roll is positive "counterclockwise", seen from where is not said: from the front, or the axes would be left-handed. Never
    tried on an instrument.
    """

    name = "racelogic_can"
    title = "Racelogic IMU03, IMU04 (CAN)"
    protocol = "racelogic_can"
    wire = "can"
    bauds = (500_000, 1_000_000, 250_000)
    status = "document only"
    manual = "Racelogic support pages, CAN output of IMU04"


DRIVER = RacelogicCan
