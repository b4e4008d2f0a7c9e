"""Xsens MTi-600 series on CAN."""

from imufield.acquire.driver import Driver


class XsensCan(Driver):
    """One message for each quantity.

    11-bit identifiers (the defaults; each can be set to another), big-endian::

        ==================  ===  =====================================
        group counter       006  u16
        status word         011  u32, bits as in MTData2
        rate of turn        032  3 x i16 / 512 rad/s
        acceleration        034  3 x i16 / 256 m/s^2
        temperature         051  i16 / 256 degC
        ==================  ===  =====================================

    An MTi sends on CAN only what was chosen over its serial interface, nothing as delivered, and takes no command
    here. Switch the group counter on: with it losses are counted exactly. Resolution is coarse: 0.0039 m/s^2 and
    0.11 deg/s; use the serial interface for anything but a check.

    Never tried on an instrument; that numbers are big-endian is what every public description assumes.
    """

    name = "xsens_can"
    title = "Xsens MTi-600 series (CAN)"
    protocol = "xsens_can"
    wire = "can"
    bauds = (250_000, 500_000, 1_000_000, 125_000)
    status = "document only"
    manual = "Xsens MT1604P rev. A (2019), by public descriptions"


DRIVER = XsensCan
