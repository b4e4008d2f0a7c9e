"""A WitMotion WT901: registers that a key unlocks, frames of 11 bytes (WitStandardProtocol_JY901)."""

from __future__ import annotations

import struct

from imufield.simulate.instruments.scripted import ScriptedInstrument, nearest
from imufield.simulate.wire.forms import WireForm

_SAVE = 0x00
_RATE = 0x03
_READ = 0x27
_KEY = 0x69  # Registers are read-only until _OPEN is written here.
_OPEN = 0xB588
_RATES_HZ = {1: 0.2, 2: 0.5, 3: 1.0, 4: 2.0, 5: 5.0, 6: 10.0, 7: 20.0, 8: 50.0, 9: 100.0, 0x0A: 125.0, 0x0B: 200.0}


class WitMotionInstrument(ScriptedInstrument):
    """Takes a register only after the key; answers questions alone, and without saying which register it was."""

    def __init__(self, rate_hz: float, form: WireForm) -> None:  # noqa: ARG002  every form has these registers
        super().__init__(rate_hz)
        codes = {rate: code for code, rate in _RATES_HZ.items()}
        serial = struct.unpack("<6H", b"WT5500001234")
        code = codes[nearest(codes, rate_hz)]
        self.registers = {_RATE: code, 0x04: 2, 0x2E: 2526, 0x2F: 1, **dict(enumerate(serial, 0x7F))}
        self._unlocked = False

    def _cut(self, received: bytes) -> tuple[bytes | None, bytes]:
        begin = received.find(b"\xff\xaa")
        if begin < 0 or len(received) < begin + 5:
            return None, received
        # No checksum: any five bytes behind the sync are a command.
        return received[begin : begin + 5], received[begin + 5 :]

    def _answer(self, command: bytes) -> bytes:
        register, value = struct.unpack("<xxBH", command)
        if register == _READ:
            return wit_frame(0x5F, [self.registers.get(value + place, 0) for place in range(4)], signed=False)
        if register == _KEY:
            self._unlocked = value == _OPEN
        elif register == _SAVE:
            self.memory_writes.append(command)
        elif self._unlocked:
            self.registers[register] = value
            self.streaming = self.registers[_RATE] in _RATES_HZ
            self.rate_hz = _RATES_HZ.get(self.registers[_RATE], self.rate_hz)
        return b""


def wit_frame(kind: int, words: list[int], *, signed: bool = True) -> bytes:
    """Return a frame of four words with the sum of its bytes."""
    body = struct.pack("<BB4h" if signed else "<BB4H", 0x55, kind, *words)
    return body + bytes([sum(body) % 256])
