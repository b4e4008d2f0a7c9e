"""Instruments that print numbers: home-made units, loggers, evaluation boards."""

from imufield.acquire.driver import Driver


class Text(Driver):
    """Anything that sends one line of numbers for each sample.

    A line is ``[prefix] number delimiter number ... [*XX] LF``, CR before LF allowed. XX is an NMEA checksum; lines
    without it have none, so damage to them goes unseen. Which number is what, their units and the sample rate are settings.

    For pulse counts of each sample, as frequency-output accelerometers give, set columns=counter,ax,ay,az,gx,gy,gz,
    accelerometer_unit=pulse, gyroscope_unit=pulse, increments=true and rate_hz=100, each with ``--set``.
    """

    name = "text"
    title = "any instrument that prints lines of numbers"
    protocol = "text"
    bauds = (115200, 9600, 57600, 230400, 460800, 921600, 38400, 19200)
    wiring = "USB of a board, RS-232, RS-422 or UART, as its maker says"
    status = "verified on real bytes"
    manual = "imufield, docs/protocols.md: lines of numbers; NMEA 0183 for the optional checksum"


DRIVER = Text
