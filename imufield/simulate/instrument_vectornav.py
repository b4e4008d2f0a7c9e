"""A VectorNav VN-100: registers by lines of text, binary or text output (UM001)."""

from __future__ import annotations

import struct
from functools import reduce
from operator import xor

from crccheck.crc import CrcXmodem

from imufield.simulate.instruments import FORCE_M_S2, RATE_RAD_S, TEMPERATURE_DEGC, ScriptedInstrument

_IMU_HZ = 800
_FLASH = ("VNWNV", "VNRFS")
_BINARY_OFF = "0,0"


class VectorNavInstrument(ScriptedInstrument):
    """Sends text (VNIMU) while no binary output is on, else output 1: TimeStartup, UncompAccel, UncompGyro, Temp."""

    def __init__(self, rate_hz: float = 100, *, binary: bool = True) -> None:
        super().__init__(rate_hz)
        self.registers = {
            1: "VN-100T-CR",
            3: "0100012345",
            4: "2.1.0.0",
            5: "115200",
            7: "40" if binary else f"{rate_hz:g}",
            75: f"1,{_IMU_HZ // round(rate_hz)},05,0001,001C" if binary else _BINARY_OFF,
            76: _BINARY_OFF,
            77: _BINARY_OFF,
        }

    @property
    def binary(self) -> bool:
        """Whether the first binary output is on."""
        return not self.registers[75].startswith("0")

    def sample(self, number: int, time_s: float) -> bytes:  # noqa: ARG002  nothing in it is numbered
        """Return one message; z points down."""
        force = (FORCE_M_S2[0], -FORCE_M_S2[1], -FORCE_M_S2[2])
        if not self.binary:
            numbers = ",".join(f"{value:+010.6f}" for value in RATE_RAD_S)
            text = f"VNIMU,-00.0350,+00.4222,-00.6643,{','.join(f'{value:+07.3f}' for value in force)},{numbers},+25.5,+084.322"
            return sentence(text)
        body = bytes.fromhex("0501001C00") + struct.pack("<Q", round(time_s * 1e9))
        body += struct.pack("<7f", *force, *RATE_RAD_S, TEMPERATURE_DEGC)
        return b"\xfa" + body + int(CrcXmodem.calc(body)).to_bytes(2, "big")

    def _cut(self, heard: bytes) -> tuple[bytes | None, bytes]:
        line, end, rest = heard.partition(b"\n")
        return (line.strip(), rest) if end else (None, heard)

    def _answer(self, command: bytes) -> bytes:
        body, _, checksum = command.decode("ascii", "replace").partition("*")
        text = body.removeprefix("$")
        if checksum != "XX" and sentence(text) != command + b"\r\n":
            return sentence("VNERR,03")
        name, *values = text.split(",")
        if name in _FLASH:
            self.memory_writes.append(command)
            return sentence(text)
        if name == "VNASY":
            self.streaming = values == ["1"]
            return sentence(text)
        if name not in ("VNRRG", "VNWRG") or not values or int(values[0]) not in self.registers:
            return sentence("VNERR,08")
        if name == "VNWRG":
            self._write(int(values[0]), ",".join(values[1:]))
        return sentence(f"{name},{int(values[0]):02d},{self.registers[int(values[0])]}")

    def _write(self, number: int, values: str) -> None:
        self.registers[number] = values
        divisor = self.registers[75].split(",")[1]
        self.rate_hz = _IMU_HZ / int(divisor) if self.binary else float(self.registers[7])


def sentence(text: str) -> bytes:
    """Return a line with its XOR."""
    return f"${text}*{reduce(xor, text.encode(), 0):02X}\r\n".encode()
