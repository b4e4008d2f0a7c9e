"""A MicroStrain sensor: idle and resume, device information, message format by base rate and decimation (DCP manual)."""

from __future__ import annotations

import struct

from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.simulate.instruments import FORCE_M_S2, RATE_RAD_S, ScriptedInstrument

_UNKNOWN_COMMAND, _BAD_VALUE = 0x01, 0x03
_SAVE = 3


class MicroStrainInstrument(ScriptedInstrument):
    """A GX5 (``legacy``: commands 0x06 and 0x08) or a CV7 (0x0E and 0x0F); the other generation's are refused."""

    def __init__(self, rate_hz: float = 100, *, legacy: bool = True) -> None:
        self.legacy = legacy
        self.base_hz = 1000 if legacy else 500
        decimation = round(self.base_hz / rate_hz)
        self.format = [(0x04, decimation), (0x05, decimation), (0x12 if legacy else 0xD5, decimation), (0x06, 5 * decimation)]
        super().__init__(rate_hz)

    def sample(self, number: int, time_s: float) -> bytes:
        """Return one packet of set 0x80, in every fifth of which is a magnetic field."""
        acceleration = (value / STANDARD_GRAVITY_M_S2 for value in FORCE_M_S2)
        fields = _field(0x04, struct.pack(">3f", *acceleration)) + _field(0x05, struct.pack(">3f", *RATE_RAD_S))
        if self.legacy:
            fields += _field(0x12, struct.pack(">dHH", time_s, 2300, 6))
        else:
            fields += _field(0xD5, struct.pack(">Q", round(time_s * 1e9)))
        if number % 5 == 0:
            fields += _field(0x06, struct.pack(">3f", 0.1, 0.2, 0.3))
        return mip_packet(0x80, fields)

    def _cut(self, heard: bytes) -> tuple[bytes | None, bytes]:
        begin = heard.find(b"\x75\x65")
        if begin < 0 or len(heard) < begin + 6 or len(heard) < begin + 6 + heard[begin + 3]:
            return None, heard
        end = begin + 6 + heard[begin + 3]
        frame = heard[begin:end]
        good = mip_packet(frame[2], frame[4:-2]) == frame
        return (frame, heard[end:]) if good else (b"", heard[begin + 2 :])

    def _answer(self, command: bytes) -> bytes:
        fields, answers = command[4:-2], b""
        while fields:
            answers += self._carry_out(command[2], fields[1], fields[2 : fields[0]])
            fields = fields[fields[0] :]
        return mip_packet(command[2], answers) if answers else b""

    def _carry_out(self, descriptor_set: int, number: int, data: bytes) -> bytes:
        base = {0x01: b"", 0x02: b"", 0x03: self._information(), 0x06: b""}
        if descriptor_set == 0x01 and number in base:
            self.streaming = {0x02: False, 0x06: True}.get(number, self.streaming)
            return _acknowledgement(number, 0) + base[number]
        if descriptor_set == 0x0C and data[:1] == bytes([_SAVE]):
            self.memory_writes.append(bytes([number]) + data)
            return _acknowledgement(number, 0)
        if descriptor_set == 0x0C and number in ((0x06, 0x08) if self.legacy else (0x0E, 0x0F)):
            return self._settings(number, data)
        return _acknowledgement(number, _UNKNOWN_COMMAND)

    def _settings(self, number: int, data: bytes) -> bytes:
        data_set = b"" if self.legacy else b"\x80"
        if number in (0x06, 0x0E):
            return _acknowledgement(number, 0) + _field(number + 0x7D if self.legacy else 0x8E, data_set + _u16(self.base_hz))
        if data[0] == 1:
            held = data[1 + len(data_set) :]
            fields = [(held[at], int.from_bytes(held[at + 1 : at + 3], "big")) for at in range(1, len(held), 3)]
            if held[0] != len(fields) or any(decimation == 0 for _, decimation in fields):
                return _acknowledgement(number, _BAD_VALUE)
            self.format = fields
            self.rate_hz = self.base_hz / dict(fields)[0x04]
            return _acknowledgement(number, 0)
        listed = b"".join(bytes([one]) + _u16(decimation) for one, decimation in self.format)
        return _acknowledgement(number, 0) + _field(
            0x80 if self.legacy else 0x8F, data_set + bytes([len(self.format)]) + listed
        )

    def _information(self) -> bytes:
        names = ("3DM-GX5-25" if self.legacy else "3DM-CV7-AHRS", "6251-4220", "6251.123456", "I042Y", "5g, 300d/s")
        return _field(0x81, _u16(1134) + b"".join(name.rjust(16).encode() for name in names))


def mip_packet(descriptor_set: int, fields: bytes) -> bytes:
    """Return a packet with its two running sums."""
    data = bytes([0x75, 0x65, descriptor_set, len(fields)]) + fields
    first = second = 0
    for byte in data:
        first = (first + byte) % 256
        second = (second + first) % 256
    return data + bytes([first, second])


def _field(number: int, data: bytes) -> bytes:
    return bytes([len(data) + 2, number]) + data


def _acknowledgement(number: int, error: int) -> bytes:
    return _field(0xF1, bytes([number, error]))


def _u16(value: int) -> bytes:
    return value.to_bytes(2, "big")
