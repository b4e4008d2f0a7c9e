"""Aceinna OpenIMU and DMU38x/IMU38x on a serial port."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Sequence
from functools import partial

from imufield.acquire.driver import BY_DOCUMENT, Command, Driver, Message, checksum_of, choose_divisor, choose_rate

_CRC = partial(checksum_of, "CRC-16/SPI-FUJITSU")
_DMU_KINDS = frozenset({"0x5330", "0x5331"})  # Packets S0 and S1; only these instruments know the commands in capitals.
_RATES_HZ = (200, 100, 50, 20, 10, 5, 2)
_PACKET_RATE = 4  # Parameter of an OpenIMU, in Hz.
_PACKET_RATE_DIVIDER = 1  # Field of a DMU; it divides the rate below.
_DMU_HZ = 100
_QUIET = 0  # Rate and divider alike: nothing is sent by itself.
_DELIVERED_HZ = 100  # Of an OpenIMU that was quiet when it was found.


class AceinnaSerial(Driver):
    """Aceinna packets that begin with 55 55.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0, 1    0x55 0x55
    2, 3    two letters: z1, s1 (OpenIMU, little-endian), S1, S0 (DMU, big-endian)
    4       length of the payload
    from 5  payload
    last 2  CRC-16 from the letters on, high byte first
    ======  ==============================================================

    z1, s1 and S1 were checked on recordings; S0 comes from the manual alone. S1 numbers no packets: its counter is a time.
    """

    name = "aceinna_serial"
    title = "Aceinna OpenIMU, DMU38x, IMU38x (serial)"
    protocol = "aceinna_serial"
    bauds = (115200, 57600, 38400, 230400, 460800)
    wiring = "UART, 3.3 V logic"
    status = "verified on real bytes"
    manual = "OpenIMU serial messaging, openimu.readthedocs.io; Aceinna DMU38x user manual: packets S0, S1"
    abilities = BY_DOCUMENT

    @classmethod
    def identity_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the questions of the family that was heard: pG and gV, or GP for the packets ID and VR."""
        if _DMU_KINDS.intersection(heard):
            return [packet("identity", "GP", b"ID", "identity"), packet("release", "GP", b"VR", "release")]
        return [packet("ping", "pG", b"", "ping"), packet("version", "gV", b"", "version")]

    @classmethod
    def state_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the question for the packet rate, of both families while nothing was heard: each refuses the other's."""
        # GF and SF name how many fields follow, here one.
        dmu = packet("rate", "GF", struct.pack(">BH", 1, _PACKET_RATE_DIVIDER), "field")
        openimu = packet("rate", "gP", struct.pack("<I", _PACKET_RATE), "parameter")
        return [dmu] if _DMU_KINDS.intersection(heard) else [openimu] if heard else [openimu, dmu]

    @classmethod
    def rate_hz(cls, state: Sequence[Message]) -> float | None:
        """Return the packet rate; None for quiet."""
        for answer in _told(state):
            if answer["value"] != _QUIET:
                return float(_DMU_HZ / answer["value"] if answer["kind"] == "field" else answer["value"])
        return None

    @classmethod
    def start_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the packet rate that was read; 100 Hz, as delivered, where it was quiet."""
        return [_set(answer, answer["value"] or (1 if answer["kind"] == "field" else _DELIVERED_HZ)) for answer in _told(state)]

    @classmethod
    def stop_orders(cls, state: Sequence[Message] = ()) -> Sequence[Command]:
        """Return the packet rate 0, which is quiet; volatile."""
        return [_set(answer, _QUIET) for answer in _told(state)]

    @classmethod
    def rate_orders(cls, rate_hz: float, state: Sequence[Message]) -> Sequence[Command]:
        """Return SF with the divider of a DMU, or uP with the rate of an OpenIMU; both change volatile settings."""
        return [
            _set(
                answer,
                choose_divisor(cls.title, rate_hz, _DMU_HZ)
                if answer["kind"] == "field"
                else int(choose_rate(cls.title, rate_hz, _RATES_HZ)),
            )
            for answer in _told(state)
        ]

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:
        """Return model, serial number and version; an OpenIMU says the first two in one text, the number last."""
        found: dict[str, str] = {}
        for message in messages:
            if message["kind"] == "ping" and message["text"].strip("\0 "):
                # Part numbers come before the serial number, with or without "SN:" in front.
                words = message["text"].strip("\0 ").split()
                numbers = [word.removeprefix("SN:") for word in words if word.removeprefix("SN:").isdigit()]
                found["model"] = " ".join(word for word in words if word.removeprefix("SN:") not in numbers)
                found |= {"serial_number": numbers[-1]} if numbers else {}
            elif message["kind"] == "version":
                found["firmware"] = message["text"].strip("\0 ")
            elif message["kind"] == "identity":
                found |= {"model": message["model"].strip("\0 "), "serial_number": str(message["serial_number"])}
            elif message["kind"] == "release":
                found["firmware"] = ".".join(str(message[part]) for part in ("major", "minor", "patch", "stage", "build"))
        return found


def _told(state: Sequence[Message]) -> list[Message]:
    """Return the answers that hold a packet rate or its divider; a refusal holds none."""
    return [answer for answer in state if answer["kind"] in ("field", "parameter")]


def _set(answer: Message, value: int) -> Command:
    """Return the order that sets what this was the answer about, until power-off: SF of a DMU, uP of an OpenIMU."""
    if answer["kind"] == "field":
        return packet("set rate", "SF", struct.pack(">BHH", 1, _PACKET_RATE_DIVIDER, value), "field_set")
    return packet("set rate", "uP", struct.pack("<Iq", _PACKET_RATE, value), "parameter_set")


def packet(name: str, letters: str, data: bytes, answer: str) -> Command:
    """Return a packet to the instrument, answered by a message called ``answer`` or by a refusal of these letters."""
    body = letters.encode() + bytes([len(data)]) + data
    return Command(
        name=name,
        data=b"UU" + body + _CRC(body).to_bytes(2, "big"),
        answer=lambda message: message["kind"] == answer or (message["kind"] == "refused" and message["letters"] == letters),
        refusal=_refusal,
    )


def _refusal(answer: Message) -> str:
    if answer["kind"] == "refused":
        return f"it knows no {answer['letters']}"
    return f"error {answer['error']}" if answer.get("error") else ""


DRIVER = AceinnaSerial
