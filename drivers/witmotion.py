"""WitMotion WT901 and relatives."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import ClassVar

from imufield.acquire.driver import BY_DOCUMENT, Command, Driver, Message, choose_rate

# Registers; reading one answers with it and the three behind it.
_RATE = 0x03
_VERSION = 0x2E
_SERIAL = 0x7F
_SERIAL_END = 0x83
_READ = 0x27
# Settings are taken for some seconds after the key was written.
_KEY = 0x69
_UNLOCK = 0xB588
# Codes of the rate register besides the rates themselves.
_ONCE = 0x0C
_NEVER = 0x0D
_AS_DELIVERED = 0x06
# Code 0x0A is left out: some models take it for 125 Hz, others for 100 Hz.
_RATE_CODES = {0.2: 1, 0.5: 2, 1: 3, 2: 4, 5: 5, 10: 6, 20: 7, 50: 8, 100: 9, 200: 0x0B}
_RATES_READ_HZ = {code: rate for rate, code in _RATE_CODES.items()} | {0x0A: 125}


class WitMotion(Driver):
    """WitMotion standard protocol.

    ======  ==============================================================
    bytes   content
    ======  ==============================================================
    0       0x55
    1       what: 0x51 acceleration, 0x52 angular rate, 0x53 angle, 0x54 magnetic
    2 to 9  four numbers of 16 bits, little-endian; the fourth of 0x51 is a temperature
    10      sum of all bytes before
    ======  ==============================================================

    The fourth number of 0x52 is a temperature or, of newer Bluetooth models, the battery voltage; that of 0x53 is the version.
    A sample takes several frames, and nothing numbers them. The frames of Bluetooth (``--set form=bluetooth``, 20 bytes) and
    of memory cards (``--set form=card``, 28 bytes) have no checksum: damage in them goes unseen.
    """

    name = "witmotion"
    title = "WitMotion WT901, HWT90x"
    protocol = "witmotion"
    bauds = (9600, 115200, 230400, 460800, 921600, 57600, 38400, 19200, 4800)
    wiring = "by model: USB, RS-232, RS-485 or UART (TTL, 3.3 to 5 V)"
    status = "verified on real bytes"
    manual = "WITMOTION WitStandardProtocol_JY901: standard protocol and register map"
    variants: ClassVar[tuple[Mapping[str, object], ...]] = ({"form": "bluetooth"},)
    abilities = BY_DOCUMENT

    @classmethod
    def identity_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the questions for the registers of version and serial number; the answer does not say which they are."""
        return [read("version", _VERSION), read("serial", _SERIAL), read("serial end", _SERIAL_END)]

    @classmethod
    def state_questions(cls, heard: Collection[str]) -> Sequence[Command]:
        """Return the question for the output rate."""
        return [read("rate", _RATE)]

    @classmethod
    def start_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the key and the rate that was read; 10 Hz, as delivered, where that was none."""
        codes = [answer["registers"][0] for answer in state]
        return [order for code in codes for order in _set_code(_AS_DELIVERED if code & 0xFF in (_ONCE, _NEVER) else code)]

    @classmethod
    def stop_orders(cls, state: Sequence[Message] = ()) -> Sequence[Command]:
        """Return the key and the code for no output, not saved."""
        return _set_code(_NEVER) if state else ()

    @classmethod
    def rate_hz(cls, state: Sequence[Message]) -> float | None:
        """Return the output rate; None where nothing is sent by itself."""
        return next((_RATES_READ_HZ.get(answer["registers"][0] & 0xFF) for answer in state), None)

    @classmethod
    def rate_orders(cls, rate_hz: float, state: Sequence[Message]) -> Sequence[Command]:
        """Return the key and the rate; without a save both are forgotten at power-off."""
        return _set_code(_RATE_CODES[choose_rate(cls.title, rate_hz, _RATE_CODES)])

    @classmethod
    def restore_orders(cls, state: Sequence[Message]) -> Sequence[Command]:
        """Return the key and the code that was read."""
        return _set_code(state[0]["registers"][0])

    @classmethod
    def identity(cls, messages: Iterable[Message]) -> dict[str, str]:
        """Return serial number and version as far as registers hold any."""
        # An answer holds four registers; which ones, only the question says.
        words = dict.fromkeys(("version", "serial", "serial end"), (0, 0, 0, 0))
        words |= {message["asked"]: message["registers"] for message in messages if {"asked", "registers"} <= message.keys()}
        found: dict[str, str] = {}
        low, high, *_ = words["version"]
        # Newer firmware has three numbers in both registers; else the second is CCBW, which is none of the version.
        if high & 0x8000:
            found["firmware"] = f"{(high & 0x7FFF) << 2 | low >> 14}.{low >> 8 & 0x3F}.{low & 0xFF}"
        elif low:
            found["firmware"] = str(low)
        serial = struct.pack("<6H", *words["serial"], *words["serial end"][:2])
        text = serial.strip(b"\0 ").decode("ascii", "replace")
        if text.isalnum():
            found["serial_number"] = text
        return found


def _set_code(code: int) -> Sequence[Command]:
    return [write("key", _KEY, _UNLOCK), write("rate", _RATE, code)]


def write(name: str, register: int, value: int) -> Command:
    """Return the order to set a register, which is not answered."""
    return Command(name=name, data=struct.pack("<BBBH", 0xFF, 0xAA, register, value))


def read(name: str, register: int) -> Command:
    """Return the question for four registers from this one on."""
    return Command(
        name=name, data=struct.pack("<BBBH", 0xFF, 0xAA, _READ, register), answer=lambda message: message["kind"] == "registers"
    )


DRIVER = WitMotion
