"""VectorNav VN-100, VN-200 and VN-300, ASCII output."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from imufield.acquire.driver import Command, Message, choose_rate

from ._vectornav_registers import VectorNav, read, values_of, write

# Values of the register; the sensor refuses others.
_RATES_HZ = (1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200)
_FREQUENCY = 7  # Register of the asynchronous data output frequency.


class VectorNavAscii(VectorNav):
    """VectorNav lines of text.

    A line is ``$VNIMU,number,...*XX`` with CR LF or LF: XX is the XOR of what stands between dollar and star, four digits
    are a CRC-16. VNIMU, VNYMR, VNQMR and VNMAR hold samples; other lines are kept as messages. Acceleration has a
    resolution of 0.001 m/s^2 only, which is too coarse for noise: prefer the binary output.
    """

    name = "vectornav_ascii"
    title = "VectorNav VN-100/200/300, ASCII"
    protocol = "vectornav_ascii"
    status = "verified on real bytes"
    manual = "VectorNav UM001, VN-100 User Manual rev. 2.22: asynchronous ASCII output, protocol control"

    @classmethod
    def state_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the question for the output frequency."""
        return [read(_FREQUENCY)]

    @classmethod
    def rate_hz(cls, state: Sequence[Message]) -> float | None:
        """Return the output frequency."""
        found = values_of(state, _FREQUENCY)
        return float(found[0]) if found and found[0].isdecimal() else None

    @classmethod
    def rate_orders(cls, rate_hz: float, state: Sequence[Message]) -> Sequence[Command]:
        """Return the order that sets the output frequency until reset or power-off."""
        return [write(_FREQUENCY, int(choose_rate(cls.title, rate_hz, _RATES_HZ)))]


DRIVER = VectorNavAscii
