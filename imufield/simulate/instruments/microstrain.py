"""A MicroStrain sensor: idle and resume, device information, message format by base rate and decimation (DCP manual)."""

from __future__ import annotations

from imufield.simulate.instruments.scripted import ScriptedInstrument
from imufield.simulate.wire.forms import WireForm

# Error codes of an acknowledgement.
_UNKNOWN_COMMAND = 0x01
_BAD_VALUE = 0x03
# Function selectors, the first byte of a settings command.
_SAVE = 3
_APPLY = 1
_READ = 2
_GPS_TIME = 0x12


class MicroStrainInstrument(ScriptedInstrument):
    """A GX5 where the form has a GPS time (commands 0x06 and 0x08), else a CV7 (0x0E and 0x0F); the other's are refused."""

    sync = b"\x75\x65"
    length_at = 3
    overhead = 6

    def __init__(self, rate_hz: float, form: WireForm) -> None:
        super().__init__(rate_hz)
        sent = form.frames[0].fields
        self.legacy = _GPS_TIME in sent
        self.base_hz = 1000 if self.legacy else 500
        decimation = max(round(self.base_hz / rate_hz), 1)
        self.format = [(descriptor, decimation) for descriptor in sent]  # Descriptor and decimation of each field.

    def _is_whole(self, command: bytes) -> bool:
        return mip_packet(command[2], command[4:-2]) == command

    def _answer(self, command: bytes) -> bytes:
        fields, answers = command[4:-2], b""
        # The length of a field counts length and descriptor too, so it is at least 2.
        while len(fields) >= 2 and 2 <= fields[0] <= len(fields):
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
            answering = number + 0x7D if self.legacy else 0x8E
            return _acknowledgement(number, 0) + mip_field(answering, data_set + _u16(self.base_hz))
        if data[:1] == bytes([_APPLY]):
            return _acknowledgement(number, 0 if self._apply(data[1 + len(data_set) :]) else _BAD_VALUE)
        if data[:1] != bytes([_READ]):
            return _acknowledgement(number, _BAD_VALUE)
        listed = b"".join(bytes([descriptor]) + _u16(decimation) for descriptor, decimation in self.format)
        answer = data_set + bytes([len(self.format)]) + listed
        return _acknowledgement(number, 0) + mip_field(0x80 if self.legacy else 0x8F, answer)

    def _apply(self, listed: bytes) -> bool:
        """Take over a message format, the fields that are sent, all at one decimation; return whether it is valid."""
        # A count, then descriptor and decimation (two bytes) of each field.
        fields = [(listed[at], int.from_bytes(listed[at + 1 : at + 3], "big")) for at in range(1, len(listed) - 2, 3)]
        good = len(listed) == 1 + 3 * len(fields) and listed[0] == len(fields) and all(decimation for _, decimation in fields)
        # It sends one kind of packet: other fields, or fields at rates of their own, are not emulated.
        same = [descriptor for descriptor, _ in fields] == [descriptor for descriptor, _ in self.format]
        good = good and same and len({decimation for _, decimation in fields}) == 1
        if good:
            self.format = fields
            self.rate_hz = self.base_hz / fields[0][1]
        return good

    def _information(self) -> bytes:
        names = ("3DM-GX5-25" if self.legacy else "3DM-CV7-AHRS", "6251-4220", "6251.123456", "I042Y", "5g, 300d/s")
        return mip_field(0x81, _u16(1134) + b"".join(name.rjust(16).encode() for name in names))


def mip_packet(descriptor_set: int, fields: bytes) -> bytes:
    """Return a packet with its two running sums."""
    data = bytes([0x75, 0x65, descriptor_set, len(fields)]) + fields
    first = second = 0
    for byte in data:
        first = (first + byte) % 256
        second = (second + first) % 256
    return data + bytes([first, second])


def mip_field(number: int, data: bytes) -> bytes:
    """Return a field with its length and descriptor."""
    return bytes([len(data) + 2, number]) + data


def _acknowledgement(number: int, error: int) -> bytes:
    return mip_field(0xF1, bytes([number, error]))


def _u16(value: int) -> bytes:
    return value.to_bytes(2, "big")
