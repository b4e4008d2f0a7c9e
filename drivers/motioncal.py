"""Boards of Adafruit, Teensy and Arduino with a sketch that prints for MotionCal."""

from imufield.acquire.driver import Driver


class MotionCal(Driver):
    """Lines for the program MotionCal.

    A line is ``Raw:ax,ay,az,gx,gy,gz,mx,my,mz`` with CR LF, nine whole numbers of 16 bits: acceleration in 1/8192 g, rate in
    1/16 deg/s, magnetic field in 0.1 uT. Lines beginning with ``Uni:`` repeat the data in decimals and are ignored. There is
    no checksum, no counter and no time; sketches wait 10 ms between two samples. A step is 122 ug and 0.0625 deg/s: a unit
    whose noise is smaller is better read by a sketch of one's own (driver ``text``).

    Adafruit's sketch takes 9.8 m/s^2 for 1 g, 0.068 % less than MotionCal (``--set g_m_s2=9.8``), and cuts every number toward
    zero, by half a step on average.
    """

    name = "motioncal"
    title = "Adafruit, Teensy and Arduino boards, MotionCal lines"
    protocol = "motioncal"
    bauds = (115200,)
    wiring = "USB of the board, which is its power too"
    status = "document only"
    manual = "PaulStoffregen/MotionCal: imuread.h and serialdata.c; Adafruit AHRS library: examples/calibration"


DRIVER = MotionCal
