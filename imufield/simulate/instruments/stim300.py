"""A STIM300 after datasheet TS1524 rev. 31: its datagrams, and its answers in normal, service and utility mode.

At power-on it sends part number, serial number and configuration, then 281 ms of datagrams with the start-up bit and the rates
at full scale, then data. All commands of normal mode are answered. In service and utility mode a host can enter, ask for the
identity, set the sample rate until power-off (utility alone), and leave. The byte maps of the special datagrams come from the
datasheet only; no recording of them is known.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from crccheck.crc import Crc8Smbus

from imufield.calibrate.model.grades import GRADES
from imufield.dataclass import dataclass, replace
from imufield.samples import Samples, Status
from imufield.simulate.instruments.device import Answer, Device, Frames
from imufield.simulate.wire.stim300 import Stim300Encoder, Stim300Format, close_datagrams

COMMAND_END = b"\r"
_LONGEST_COMMAND = 256  # Bytes kept while waiting for the end of a command; those of a STIM300 have at most some 60.
# At start-up the rates are at full scale, beyond the 400 deg/s of the range.
_START_UP_RATE_RAD_S = np.radians(480.0)
# Codes of the configuration datagram; a rate or baud without one has the last code.
_RATE_CODES = {125: 0, 250: 1, 500: 2, 1000: 3, 2000: 4}
_BAUD_CODES = {374400: 0, 460800: 1, 921600: 2, 1843200: 3}
_RANGE_CODES = {10: 0, 2: 2, 5: 3, 30: 4, 80: 6}
_OUTPUT_CODES = {"rate": 0, "increment": 1, "average": 2}
_UNITS_A_GRADE = 10**12  # Far more than anyone emulates: the serial numbers of two grades do not meet.
_UTILITY_ERROR = 1
_UTILITY_VALUE_ERROR = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Stim300Identity:
    """Who the emulated unit is."""

    part_number: str = "84167-4400003-321"
    """15 digits; the dashes stand where the datagram has them."""
    revision: str = "K"
    serial_number: str = "25581846020020"
    """14 digits, sent behind an N."""
    hardware_revision: str = "E"
    firmware_revision: int = 31

    @classmethod
    def of_seed(cls, seed: int, grade: str = "tactical") -> Self:
        """Return who the instrument of this seed and grade is; 1 of the tactical grade has the serial number above."""
        places = [*GRADES]
        of_grade = _UNITS_A_GRADE * (places.index(grade) - places.index("tactical"))
        number = (int(cls().serial_number) + of_grade + seed - 1) % 10**14
        return cls(serial_number=f"{number:014d}")


class Stim300Device(Device):
    """A STIM300 that answers its commands.

    Parameters
    ----------
    settings : Stim300Format, optional
    identity : Stim300Identity, optional
    baud : int, optional
    """

    start_up_s = 0.281
    answers_replace_samples = True

    def __init__(
        self, settings: Stim300Format | None = None, identity: Stim300Identity | None = None, baud: int = 921600
    ) -> None:
        self.format = settings or Stim300Format()
        self.identity = identity or Stim300Identity()
        self.baud = baud
        self._encoder = Stim300Encoder(self.format)
        self.memory_writes: list[bytes] = []  # Commands that would have changed memory that outlives the power.
        self._saved = self.format  # In flash: what a power-on finds.
        self._mode = "normal"
        self._received = b""

    @property
    def rate_hz(self) -> float:
        """Sample rate now."""
        return self.format.rate_hz

    @property
    def streaming(self) -> bool:
        """Whether the unit is in normal mode."""
        return self._mode == "normal"

    def encode(self, samples: Samples) -> Frames:
        """Return the datagrams of a block."""
        starting = (samples.status & np.uint32(Status.START_UP)) != 0
        if np.any(starting):
            samples = replace(samples, gyroscope=np.where(starting[:, np.newaxis], _START_UP_RATE_RAD_S, samples.gyroscope))
        frames = self._encoder.encode(samples)
        length = frames.shape[1]
        ends = np.arange(1, len(frames) + 1, dtype=np.int64) * length
        return Frames(frames.reshape(-1), ends, ends - 1 - (2 if self.format.crlf else 0))

    def power_on(self) -> bytes:
        """Return part number, serial number and configuration datagrams."""
        self._mode = "normal"
        self._use(self._saved)
        return self._part_number() + self._serial_number() + self._configuration()

    def jump_counter(self, by: int) -> None:
        """Let the counter jump."""
        self._encoder.counter_offset += by

    def receive(self, data: bytes) -> Answer:
        """Return the answers to the commands that are complete now; each ends with a carriage return."""
        *commands, rest = (self._received + data).split(COMMAND_END)
        self._received = rest[-_LONGEST_COMMAND:]
        answers = [self.answer(command.strip(b"\n")) for command in commands]
        return Answer(b"".join(answer.data for answer in answers), any(answer.resets for answer in answers))

    def answer(self, command: bytes) -> Answer:
        """Return the answer to a command in the present mode; unknown ones are passed over in normal mode."""
        if self._mode == "service":
            return self._answer_service(command)
        if self._mode == "utility":
            return self._answer_utility(command)
        if command == b"R":
            return Answer(resets=True)
        if command in (b"SERVICEMODE", b"UTILITYMODE"):
            self._mode = command[:7].decode().lower()
            return Answer(b"\r>" if command == b"SERVICEMODE" else utility_message("#UTILITYMODE"))
        # Bias trim and extended error: zeros, which stand for no trim and no error.
        datagrams = {
            b"N": self._part_number(),
            b"I": self._serial_number(),
            b"C": self._configuration(),
            b"T": self._special(0xD1, 0xD2, bytes(35)),
            b"E": self._special(0xBE, 0xBF, bytes(16)),
        }
        return Answer(datagrams.get(command, b""))

    def _answer_service(self, command: bytes) -> Answer:
        echo = command + b"\r"
        if command.startswith(b"x"):
            self._mode = "normal"
            return Answer(echo, resets=command in (b"x i", b"x I"))
        if command.startswith(b"i"):
            echo += f"SERIAL NUMBER = N{self.identity.serial_number}\r".encode("ascii")
        return Answer(echo + b">")

    def _answer_utility(self, command: bytes) -> Answer:
        text = command.decode("ascii", "replace")
        body = text[: text.rfind(",")]
        if not text.startswith("$") or utility_message(body) != command + COMMAND_END:
            return Answer(utility_message(f"#{body[1:]},{_UTILITY_ERROR}"))
        name = body[1:]
        if name in ("xn", "xi"):
            self._mode = "normal"
            return Answer(utility_message(f"#{name},0"), resets=name == "xi")
        if name == "save":
            self.memory_writes.append(command)
        if name.startswith("sm,"):
            rates = {str(code): rate_hz for rate_hz, code in _RATE_CODES.items()}
            rate_hz = rates.get(name.removeprefix("sm,"))
            if rate_hz is None:
                return Answer(utility_message(f"#sm,{_UTILITY_VALUE_ERROR}"))
            self._use(replace(self.format, rate_hz=rate_hz))
            return Answer(utility_message("#sm,0"))
        known = {
            "isn": f"N{self.identity.serial_number}",
            "ix": f"{self.identity.part_number},{self.identity.revision}",
            "irng": ",".join(["400"] * 3 + [str(self.format.accelerometer_range_g)] * 3 + ["1.7"] * 3 + ["NA"]),
        }
        if name not in known:
            return Answer(utility_message(f"#{name},{_UTILITY_ERROR}"))
        return Answer(utility_message(f"#{name},0,{known[name]}"))

    def _use(self, settings: Stim300Format) -> None:
        # The counter goes on where it is.
        if settings != self.format:
            offset = self._encoder.counter_offset
            self.format, self._encoder = settings, Stim300Encoder(settings)
            self._encoder.counter_offset = offset

    def _special(self, plain_id: int, crlf_id: int, body: bytes) -> bytes:
        datagram_id = crlf_id if self.format.crlf else plain_id
        message = np.frombuffer(bytes([datagram_id]) + body, dtype=np.uint8)
        return close_datagrams(message[np.newaxis], crlf=self.format.crlf).tobytes()

    def _part_number(self) -> bytes:
        digits = [int(character, 36) for character in self.identity.part_number if character != "-"][:15]
        # P1 to P11 are the first digits; digit 12 is P17, 13 is P12 + 16 P16, 14 is P13, 15 is P14 + 16 P15.
        nibbles = [*digits[:11], digits[12] & 15, digits[13], digits[14] & 15, digits[14] >> 4, digits[12] >> 4, digits[11]]
        packed = _pack_nibbles([0, *nibbles])
        body = packed[:3] + b"-" + packed[3:6] + b"-" + packed[6:9] + bytes(3) + self.identity.revision.encode("ascii")
        return self._special(0xB1, 0xB3, body)

    def _serial_number(self) -> bytes:
        body = b"N" + _pack_nibbles([int(digit) for digit in self.identity.serial_number]) + bytes(7)
        return self._special(0xB5, 0xB7, body)

    def _configuration(self) -> bytes:
        use = self.format
        range_code = _RANGE_CODES[use.accelerometer_range_g]
        content = (
            (use.auxiliary != "none") << 4 | use.temperature << 3 | use.inclinometer << 2 | use.accelerometer << 1 | use.crlf
        )
        # Bytes 4 to 12: active axes and output unit of each cluster, and the codes of its filters.
        body = bytearray(21)
        body[0:2] = self.identity.hardware_revision.encode("ascii") + bytes([self.identity.firmware_revision])
        body[2] = _RATE_CODES.get(round(use.rate_hz), 5) << 5 | content
        body[3] = _BAUD_CODES.get(self.baud, 15) << 4
        body[4] = 0x70 | _OUTPUT_CODES[use.gyroscope_output]
        body[5], body[6] = 0x44, 0x40
        body[7] = (0x70 if use.accelerometer else 0) | _OUTPUT_CODES[use.accelerometer_output]
        body[8], body[9] = 0x44, 0x40
        body[10], body[11], body[12] = 0x70 if use.inclinometer else 0, 0x44, 0x40
        body[13] = 0x08 if use.auxiliary == "pps" else 0
        body[16], body[17] = range_code << 4 | range_code, range_code << 4
        return self._special(0xBC, 0xBD, bytes(body))


def utility_message(body: str) -> bytes:
    """Return a message of utility mode: body, comma, decimal CRC-8 of both (polynomial 0x07, start 0xFF), carriage return."""
    covered = f"{body},".encode("ascii", "replace")
    return covered + str(Crc8Smbus.calc(covered, initvalue=0xFF)).encode("ascii") + COMMAND_END


def _pack_nibbles(nibbles: list[int]) -> bytes:
    return bytes(high << 4 | low for high, low in zip(nibbles[0::2], nibbles[1::2], strict=True))
