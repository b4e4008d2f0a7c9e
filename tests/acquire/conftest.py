"""Streams made byte by byte, and a framer that is slow and obvious."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from crccheck.crc import Crc32Mpeg2

sys.path.insert(0, str(Path(__file__).parent))

# fmt: off
LENGTHS = {
    0x90: 18, 0x91: 28, 0x92: 28, 0x93: 38, 0x94: 25, 0x97: 45, 0xA5: 42, 0xA6: 42, 0xA7: 59,
    0x98: 22, 0x99: 32, 0x9A: 32, 0x9B: 42, 0x9C: 29, 0xAD: 46, 0xAE: 46, 0xAF: 63,
    0xF0: 22, 0xF1: 32, 0xF2: 32, 0xF3: 42, 0xF4: 29, 0xF5: 46, 0xF6: 46, 0xF7: 63,
    0xB1: 20, 0xB3: 20, 0xB5: 20, 0xB7: 20, 0xBC: 26, 0xBD: 26, 0xD1: 40, 0xD2: 40, 0xBE: 21, 0xBF: 21,
}
# fmt: on
"""Bytes of every STIM300 datagram without CR LF, as the datasheet prints them."""


def _finish(body: bytes) -> bytes:
    return body + struct.pack(">I", Crc32Mpeg2.calc(body + bytes(-len(body) % 4)))


def _datagram(
    counter: int,
    *,
    gyroscope: tuple[int, int, int] = (1, -2, 3),
    accelerometer: tuple[int, int, int] = (4, -5, 524288),
    gyroscope_status: int = 0,
    accelerometer_status: int = 0,
    crlf: bool = True,
) -> bytes:
    body = b"\x91"
    for values, status in ((gyroscope, gyroscope_status), (accelerometer, accelerometer_status)):
        body += b"".join(value.to_bytes(3, "big", signed=True) for value in values) + bytes([status])
    return _finish(body + bytes([counter % 256]) + b"\x01\xfa") + b"\r\n" * crlf


def _slow_frames(data: bytes) -> list[int]:
    """Return the starts of all frames by the definition, one position after another."""
    starts, at = [], 0
    while at < len(data):
        length = LENGTHS.get(data[at])
        if length and at + length <= len(data) and _finish(data[at : at + length - 4]) == data[at : at + length]:
            starts.append(at)
            at += length
            at += 2 * (data[at : at + 2] == b"\r\n")
        else:
            at += 1
    return starts


@pytest.fixture(scope="session")
def lengths() -> dict[int, int]:
    """Return the length of each STIM300 datagram by its id."""
    return LENGTHS


@pytest.fixture(scope="session")
def finish() -> Callable[[bytes], bytes]:
    """Return a function that appends the CRC of a STIM300 datagram."""
    return _finish


@pytest.fixture(scope="session")
def datagram() -> Callable[..., bytes]:
    """Return a function that makes one STIM300 datagram 0x91."""
    return _datagram


@pytest.fixture(scope="session")
def slow_frames() -> Callable[[bytes], list[int]]:
    """Return the independent framer."""
    return _slow_frames
