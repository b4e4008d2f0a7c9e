"""KVH fibre-optic IMUs 1725, 1750, 1775 and DSP-1760."""

from imufield.acquire.driver import Driver


class Kvh17xx(Driver):
    """KVH message formats A, B and C.

    Everything is big-endian.

    =======  ==============================================================
    bytes    content
    =======  ==============================================================
    0 to 3   FE 81 FF 55 (A), 56 (B), 57 (C)
    4 to 27  rotation and acceleration, float32, three each
    then     B: time in us; C: temperature and magnetic field in turn
    then     status, sequence 0 to 127; A and B: temperature
    last 4   CRC-32 of all bytes before
    =======  ==============================================================

    The message does not tell whether rotation is a rate or an increment, in rad or deg: ``--set gyroscope_output=rad/s``.
    Written from the manual (document only). Two frames of format A from a real unit decode as the manual says; no whole
    recording was at hand, and none of B and C.
    """

    name = "kvh_17xx"
    title = "KVH 1725, 1750, 1775, DSP-1760"
    protocol = "kvh_17xx"
    bauds = (921600, 460800, 230400, 115200, 4147200, 1843200, 57600, 38400, 19200, 9600)
    wiring = "RS-422, a pair each way"
    status = "document only"
    manual = "KVH 56-0298, 1775 IMU Technical Manual: message formats A, B, C"


DRIVER = Kvh17xx
