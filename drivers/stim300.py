"""Sensonor STIM300: tactical-grade MEMS IMU on RS-422."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from imufield.acquire.driver import BY_DOCUMENT, Command, Driver, Message, choose_rate

from ._stim300_utility import enter_utility_mode, utility

# Rates by their codes in the utility-mode command ``sm``.
_RATE_CODES = {125: 0, 250: 1, 500: 2, 1000: 3, 2000: 4}
_OUTPUTS = ("rate", "average", "increment")
# Values of the configuration datagram that the datasheet knows; a rate of 0 is an external trigger. "integrated", of which no
# sample is made, is refused: read as a rate, it would give wrong values without a warning.
_KNOWN_SETTINGS = {
    "accelerometer_range_g": (2, 5, 10, 30, 80),
    "accelerometer_output": (*_OUTPUTS, "integrated"),
    "gyroscope_output": (*_OUTPUTS, "integrated"),
    "rate_hz": (0, *_RATE_CODES),
}


class Stim300(Driver):
    """Sensonor STIM300 in normal mode, where it streams without being asked.

    Every value is big-endian. One datagram, in this order:

    ========================  =====  ======================================================
    part                      bytes  present
    ========================  =====  ======================================================
    id                        1      always; it alone tells the content and the length
    gyroscope x, y, z         9      always, 24 bits each
    gyroscope status          1      always
    accelerometer, status     10     by id
    inclinometer, status      10     by id
    gyroscope temperature     7      by id: 3 times 16 bits, status
    accelerometer temperature 7      by id
    inclinometer temperature  7      by id
    auxiliary or PPS, status  4      by id
    counter                   1      always: 2000 Hz samples modulo 256
    latency                   2      always: microseconds from sampling to sending
    CRC-32                    4      always: also covers zero bytes up to a multiple of 4
    CR LF                     2      if configured
    ========================  =====  ======================================================

    Status bits: 7 integrity, 6 start-up, 5 outside operating conditions, 4 overload, 3 channel error, 2..0 axis z, y, x.
    After power-up it sends part number, serial number and configuration once, before the first sample.

    Datagrams of samples were checked against recordings of a real unit (ids 0x93 and 0xAF). Those of part number, serial
    number, configuration, bias trim and extended error come from the datasheet alone.
    """

    name = "stim300"
    title = "Sensonor STIM300"
    protocol = "stim300"
    bauds = (921600, 460800, 1843200, 374400)
    wiring = "RS-422, a pair each way"
    answers_replace_samples = True
    status = "verified on real bytes"
    manual = "Sensonor TS1524 rev. 31, STIM300 Inertia Measurement Unit: datagrams, commands, status byte"
    abilities = BY_DOCUMENT

    @classmethod
    def identity_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the normal-mode commands N, I and C; each answer takes the place of a sample."""
        return [_datagram("part_number", b"N\r"), _datagram("serial_number", b"I\r"), *cls.state_questions(heard)]

    @classmethod
    def state_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the question for the configuration datagram."""
        return [_datagram("configuration", b"C\r")]

    @classmethod
    def rate_hz(cls, state: Sequence[Message]) -> float | None:
        """Return the rate by the configuration datagram; None with an external trigger."""
        return next((answer["rate_hz"] for answer in state if answer.get("rate_hz")), None)

    @classmethod
    def rate_orders(cls, rate_hz: float, state: Sequence[Message]) -> Sequence[Command]:
        """Return the way into utility mode, the order there and the way out. Lasts until reset or power-off."""
        code = _RATE_CODES[int(choose_rate(cls.title, rate_hz, _RATE_CODES))]
        return [*cls.stop_orders(), utility("sm", code), *cls.start_orders(state)]

    @classmethod
    def start_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the way from utility mode to normal mode."""
        return [utility("xn", is_last=True)]

    @classmethod
    def stop_orders(cls, state: Sequence[Message] = ()) -> Sequence[Command]:
        """Return the way into utility mode, where nothing is sent by itself."""
        return [enter_utility_mode()]

    @classmethod
    def read_settings(cls, messages: Iterable[Message]) -> dict[str, object]:
        """Return range, output units and rate from the newest configuration datagram."""
        found: dict[str, object] = {}
        for message in messages:
            if message["kind"] == "configuration":
                found |= {name: message[name] for name, known in _KNOWN_SETTINGS.items() if message.get(name) in known}
                ranges = [message.get(f"accelerometer_range{axis}_g") for axis in ("", "_y", "_z")]
                # One setting scales all axes: ranges that differ are no value of it, and refused.
                if len(set(ranges)) > 1:
                    found["accelerometer_range_g"] = "x {}, y {}, z {}".format(*ranges)
        return found

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:
        """Return model (the part number), serial number and firmware, as far as the messages tell them."""
        found: dict[str, str] = {}
        for message in messages:
            if message["kind"] == "part_number":
                found["model"] = f"STIM300 {part_number(bytes.fromhex(message['digits']), message['revision'])}"
            elif message["kind"] == "serial_number":
                found["serial_number"] = message["prefix"] + message["digits"]
            elif message["kind"] == "configuration":
                found["firmware"] = f"{message['firmware_revision']}, hardware {message['hardware_revision']}"
        return found


def _datagram(kind: str, data: bytes) -> Command:
    return Command(name=kind, data=data, answer=lambda message: message["kind"] == kind)


def part_number(digits: bytes, revision: str) -> str:
    """Return the part number, e.g. 84167-4400003-321, from bytes 1 to 14 of its datagram (no recording of one seen).

    Its 15 digits stand in half bytes P1 to P17 of bytes 1 to 11, '-' in bytes 4 and 8: P1 to P5 before the first (so one half
    byte is left over, taken to be the first), P6 to P11 between, P12 to P17 behind. Digits 1 to 11 are P1 to P11 and
    digit 12 is P17; digits 13 and 15 are made of two half bytes each. Values from 10 on are letters. Printed 5-7-3, as the
    datasheet's utility-mode example prints it.
    """
    _, *half = [part for byte in (*digits[:3], *digits[4:7], *digits[8:11]) for part in (byte >> 4, byte & 15)]
    values = [*half[:11], half[16], half[11] + 16 * half[15], half[12], half[13] + 16 * half[14]]
    text = "".join(chr(48 + value) if value < 10 else chr(55 + value) for value in values)
    return f"{text[:5]}-{text[5:12]}-{text[12:]} {revision}".rstrip(" -")


DRIVER = Stim300
