"""An Xsens MTi: configuration and measurement state, requests, MTData2 (MT0101P)."""

from __future__ import annotations

import struct

from imufield.simulate.instruments.scripted import ScriptedInstrument
from imufield.simulate.wire.forms import WireForm

_ANYWHERE = {0x30, 0x10, 0x40}  # GoToConfig, GoToMeasurement and Reset are taken in measurement state, too.
_INVALID_MESSAGE = 0x04


class XsensInstrument(ScriptedInstrument):
    """Answers requests in configuration state alone, as the real one; its output configuration is kept over power-off."""

    sync = b"\xfa\xff"
    length_at = 3
    overhead = 5

    def __init__(self, rate_hz: float, form: WireForm) -> None:
        super().__init__(rate_hz)
        self.product_code = "MTi-30-2A8G4"
        self.device_id = 0x0368248C
        self.firmware = bytes([1, 8, 2]) + bytes(8)
        self.outputs = b"".join(struct.pack(">HH", identifier, round(rate_hz)) for identifier in form.frames[0].fields)

    def _is_whole(self, command: bytes) -> bool:
        return sum(command[1:]) % 256 == 0

    def _answer(self, command: bytes) -> bytes:
        message, data = command[2], command[4:-1]
        if self.streaming and message not in _ANYWHERE:
            return b""
        if message in (0x30, 0x10):
            self.streaming = message == 0x10
            return xbus_message(message + 1, b"")
        if message in (0xC0, 0x18) and data:
            self.memory_writes.append(command)
        answers = {
            0x00: self.device_id.to_bytes(4, "big"),
            0x12: self.firmware,
            0x1C: self.product_code.ljust(20).encode(),
            0xC0: self.outputs,
        }
        if message in answers:
            return xbus_message(message + 1, answers[message])
        return xbus_message(0x42, bytes([_INVALID_MESSAGE]))


def xbus_message(number: int, data: bytes) -> bytes:
    """Return a message whose bytes but the first add up to zero."""
    body = bytes([0xFF, number, len(data)]) + data
    return b"\xfa" + body + bytes([-sum(body) % 256])
