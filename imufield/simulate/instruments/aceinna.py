"""Aceinna sensors on a serial port: an OpenIMU (parameters) or a DMU (fields); settings are lost at power-off unless saved."""

from __future__ import annotations

import struct

from crccheck.crc import Crc16SpiFujitsu

from imufield.simulate.instruments.scripted import ScriptedInstrument, nearest
from imufield.simulate.wire.forms import WireForm

# Commands that write to memory, or set fields to be kept there.
_MEMORY = (b"sC", b"rD", b"WF", b"WE", b"UE", b"JI", b"JA", b"WA")
_NAK = b"\x15\x15"
_DMU_KEYS = (0x5330, 0x5331)
_DMU_HZ = 100  # A DMU divides this rate.
_RATES_HZ = (0, 2, 5, 10, 20, 50, 100, 200)
_DIVIDERS = (0, 1, 2, 4, 5, 10, 20, 25, 50)


class AceinnaInstrument(ScriptedInstrument):
    """An OpenIMU, or where the form is S0 or S1 an IMU381; each refuses the commands of the other."""

    sync = b"UU"
    length_at = 4
    overhead = 7

    def __init__(self, rate_hz: float, form: WireForm) -> None:
        super().__init__(rate_hz)
        self.dmu = form.frames[0].key in _DMU_KEYS
        dividers = {_DMU_HZ / divider: divider for divider in _DIVIDERS if divider}
        # Packet rate of an OpenIMU, packet rate divider of a DMU; 0: quiet.
        self.setting = dividers[nearest(dividers, rate_hz)] if self.dmu else int(nearest(_RATES_HZ[1:], rate_hz))

    def _is_whole(self, command: bytes) -> bool:
        return aceinna_packet(command[2:4], command[5:-2]) == command

    def _answer(self, command: bytes) -> bytes:
        letters, data = command[2:4], command[5:-2]
        if letters in _MEMORY:
            self.memory_writes.append(command)
            return aceinna_packet(letters, b"")
        answer = (self._answer_dmu if self.dmu else self._answer_openimu)(letters, data)
        return aceinna_packet(_NAK, letters) if answer is None else answer

    def _answer_openimu(self, letters: bytes, data: bytes) -> bytes | None:
        texts = {b"pG": b"OpenIMU300ZI 5020-3885-01 1.1.1 SN:1975000088", b"gV": b"OpenIMU300ZI IMU 1.1.1"}
        if letters in texts:
            return aceinna_packet(letters, texts[letters])
        if letters == b"gP" and data == struct.pack("<I", 4):
            return aceinna_packet(letters, data + struct.pack("<q", self.setting))
        if letters == b"uP" and data[:4] == struct.pack("<I", 4) and len(data) == 12:
            (rate_hz,) = struct.unpack("<q", data[4:])
            good = rate_hz in _RATES_HZ
            if good:
                self._set(rate_hz, rate_hz)
            return aceinna_packet(letters, struct.pack("<i", 0 if good else -1))
        return None

    def _answer_dmu(self, letters: bytes, data: bytes) -> bytes | None:
        packets = {b"ID": struct.pack(">I", 1812345678) + b"IMU381ZA-200 8350-3811-01\0", b"VR": bytes([1, 0, 9, 2, 7])}
        if letters == b"PK":
            return aceinna_packet(b"PK", b"")
        if letters == b"GP" and data in packets:
            return aceinna_packet(data, packets[data])
        if letters == b"GF" and data == struct.pack(">BH", 1, 1):
            return aceinna_packet(letters, data + struct.pack(">H", self.setting))
        if letters == b"SF" and data[:3] == struct.pack(">BH", 1, 1):
            divider = int.from_bytes(data[3:], "big")
            good = divider in _DIVIDERS
            if good:
                self._set(divider, _DMU_HZ / divider if divider else 0.0)
            return aceinna_packet(letters, struct.pack(">BH", 1, 1) if good else b"\0")
        return None

    def _set(self, setting: int, rate_hz: float) -> None:
        self.setting = setting
        self.streaming = setting != 0
        self.rate_hz = rate_hz or self.rate_hz


def aceinna_packet(letters: bytes, data: bytes) -> bytes:
    """Return a packet with its CRC: polynomial 0x1021, start 0x1D0F."""
    body = letters + bytes([len(data)]) + data
    return b"UU" + body + bytes(Crc16SpiFujitsu.calcbytes(body))
