"""NovAtel OEM7 SPAN receivers, binary IMU logs."""

from imufield.acquire.driver import Driver


class NovAtelOem7(Driver):
    """NovAtel binary logs RAWIMU, RAWIMUX (S) and IMURATECORRIMUS.

    Everything is little-endian.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0 to 2  AA 44 12, or AA 44 13 for the short header
    header  28 or 12 bytes: log id at 4, length at 8 or 3
    then    time, status, then z, minus y, x of velocity and of angle
    last 4  CRC-32 of all bytes before
    ======  ==============================================================

    Values are increments over one sample of the IMU; RAWIMU does not say which IMU, so give it: ``--set imu=hg4930``.
    """

    name = "novatel_oem7"
    title = "NovAtel OEM7 SPAN, binary IMU logs"
    protocol = "novatel_oem7"
    bauds = (115200, 9600, 57600, 230400, 460800, 921600)
    wiring = "a COM port of the receiver, by model RS-232, RS-422 or 3.3 V logic; or its USB"
    status = "verified on real bytes"
    manual = "NovAtel OEM7 Commands and Logs Reference Manual: message formats, RAWIMU, RAWIMUX"


DRIVER = NovAtelOem7
