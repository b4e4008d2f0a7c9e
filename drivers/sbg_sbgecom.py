"""SBG Systems Ellipse, Ekinox, Apogee and Quanta."""

from imufield.acquire.driver import Driver


class SbgEcom(Driver):
    """sbgECom frames.

    Everything is little-endian.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0, 1    FF 5A
    2, 3    log, class
    4, 5    length of the data
    from 6  data
    then 2  CRC-16 from byte 2 on
    last    0x33
    ======  ==============================================================

    IMU_SHORT is taken, or IMU_DATA with ``--set log=imu_data``. Never tried on bytes of an instrument.
    """

    name = "sbg_sbgecom"
    title = "SBG Systems (sbgECom)"
    protocol = "sbg_sbgecom"
    bauds = (115200, 921600, 460800, 230400, 57600, 38400, 19200, 9600)
    wiring = "by model and setting: RS-232, RS-422, or UART (3.3 V logic)"
    status = "document only"
    manual = "SBG Systems sbgECom library (MIT): binary protocol, logs IMU_DATA and IMU_SHORT"


DRIVER = SbgEcom
