"""A VectorNav VN-100: registers by lines of text, binary or text output (UM001)."""

from __future__ import annotations

from functools import reduce
from operator import xor

from imufield.simulate.instruments.scripted import ScriptedInstrument, nearest
from imufield.simulate.wire.forms import WireForm

_IMU_HZ = 800  # A binary output divides this rate.
_FLASH = ("VNWNV", "VNRFS")
_BINARY_OFF = "0,0"
_RATES_HZ = (1, 2, 4, 5, 10, 20, 25, 40, 50, 100, 200)


class VectorNavInstrument(ScriptedInstrument):
    """Sends text, or the first binary output; the other two outputs are off."""

    def __init__(self, rate_hz: float, form: WireForm) -> None:
        super().__init__(rate_hz)
        masks = form.frames[0].masks
        self.writable = 75 if masks else 7  # The register of the rate; the others stay as they are.
        words = "".join(f",{masks[at + 1]:02X}{masks[at]:02X}" for at in range(1, len(masks) - 1, 2))
        output = f"1,{max(round(_IMU_HZ / rate_hz), 1)},{masks[:1].hex().upper()}{words}"
        self.registers = {
            1: "VN-100T-CR",
            3: "0100012345",
            4: "2.1.0.0",
            5: "115200",
            7: "40" if masks else f"{nearest(_RATES_HZ, rate_hz):g}",
            75: output if masks else _BINARY_OFF,
            76: _BINARY_OFF,
            77: _BINARY_OFF,
        }

    def _cut(self, received: bytes) -> tuple[bytes | None, bytes]:
        line, end, rest = received.partition(b"\n")
        return (line + end, rest) if end else (None, received)

    def _answer(self, command: bytes) -> bytes:
        command = command.strip()
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
        if name not in ("VNRRG", "VNWRG"):
            return sentence("VNERR,04")
        number = int(values[0]) if values and values[0].isdecimal() else 0
        if number not in self.registers:
            return sentence("VNERR,08")
        if name == "VNWRG" and not self._write(number, values[1:]):
            return sentence("VNERR,07")
        return sentence(f"{name},{number:02d},{self.registers[number]}")

    def _write(self, number: int, values: list[str]) -> bool:
        """Write a rate; return whether it is valid."""
        before = self.registers[number].split(",")
        # Register 75 has port, divider of the rate, groups and fields; register 7 the rate alone.
        at = 1 if number == 75 else 0
        same = values[:at] + values[at + 1 :] == before[:at] + before[at + 1 :]
        if number != self.writable or not same or not values[at].isdecimal() or int(values[at]) == 0:
            return False
        if number == 7 and int(values[0]) not in _RATES_HZ:
            return False
        self.registers[number] = ",".join(values)
        self.rate_hz = _IMU_HZ / int(values[1]) if number == 75 else float(values[0])
        return True


def sentence(text: str) -> bytes:
    """Return a line with its XOR."""
    return f"${text}*{reduce(xor, text.encode(), 0):02X}\r\n".encode()
