"""NovAtel OEM7 SPAN receivers, ASCII IMU logs."""

from imufield.acquire.driver import Driver


class NovAtelOem7Ascii(Driver):
    """NovAtel ASCII logs RAWIMUA, RAWIMUSA, RAWIMUXA and RAWIMUSXA.

    A line is ``#header;log*checksum`` (``%`` for the short header), numbers between commas, the CRC-32 in eight digits over
    what stands between the first character and the star. Order and scale are those of the binary logs: z, minus y, x;
    increments in units of the IMU, which one has to give: ``--set imu=hg4930``.
    """

    name = "novatel_oem7_ascii"
    title = "NovAtel OEM7 SPAN, ASCII IMU logs"
    protocol = "novatel_oem7_ascii"
    bauds = (115200, 9600, 57600, 230400, 460800, 921600)
    wiring = "a COM port of the receiver, by model RS-232, RS-422 or 3.3 V logic; or its USB"
    status = "verified on real bytes"
    manual = "NovAtel OEM7 Commands and Logs Reference Manual: ASCII messages, RAWIMU, RAWIMUX"


DRIVER = NovAtelOem7Ascii
