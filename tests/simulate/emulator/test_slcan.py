"""The ASCII protocol of slcan adapters, against the letters of Lawicel's manual."""

from __future__ import annotations

import os
import select
import sys
import time
import tty
from collections.abc import Iterator

import pytest

from imufield.acquire.protocol.can_frame import BIT_RATE_SWITCH, ERROR, EXTENDED, FD, REMOTE, Frame
from imufield.simulate.emulator.slcan import SlcanDevice, format_frame, parse_frame

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="this system has no pseudo-terminals")


LIMIT_S = 60.0


@pytest.fixture
def adapter() -> Iterator[tuple[SlcanDevice, int]]:
    device = SlcanDevice()
    host = os.open(device.port.address, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(host)
    os.set_blocking(host, False)
    yield device, host
    os.close(host)
    device.close()


def hear(host: int, size: int) -> bytes:
    """Read so many bytes; the system hands them over when it likes."""
    data, end_s = b"", time.monotonic() + LIMIT_S
    while len(data) < size and time.monotonic() < end_s:
        if select.select([host], [], [], 0.1)[0]:
            data += os.read(host, 4096)
    return data


def ask(adapter: tuple[SlcanDevice, int], text: bytes, size: int = 1) -> tuple[list[Frame], bytes]:
    """Say something to the adapter; return the frames it took, and its answer of so many bytes."""
    device, host = adapter
    assert os.write(host, text) == len(text)
    assert select.select([device.port._master], [], [], LIMIT_S)[0]
    return device.receive(), hear(host, size)


def test_commands(adapter: tuple[SlcanDevice, int]) -> None:
    device, host = adapter
    assert ask(adapter, b"S5\r") == ([], b"\r")
    assert ask(adapter, b"V\rN\r", 12) == ([], b"V1013\rNA123\r")
    assert ask(adapter, b"q\r") == ([], b"\a")
    device.send([Frame(1, b"a")])
    assert device.frames_dropped == 1, "the channel is closed"
    assert ask(adapter, b"O\r") == ([], b"\r")
    device.send([Frame(0x123, b"\x01\x02"), Frame(ERROR | 8, bytes(8))])
    assert hear(host, 10) == b"t12320102\r"
    assert ask(adapter, b"T18EAFF80353", 0) == ([], b"")
    assert ask(adapter, b"FF00\r", 2) == ([Frame(0x18EAFF80 | EXTENDED, b"\x53\xff\x00")], b"Z\r")
    ask(adapter, b"C\r")
    assert not device.is_open


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (Frame(0x123, b"\x11\x22"), "t12321122\r"),
        (Frame(0x08F02D80 | EXTENDED, bytes(8)), "T08F02D8080000000000000000\r"),
        (Frame(0x7 | REMOTE, b""), "r0070\r"),
        (Frame(0x9, bytes(12), flags=FD), "d0099" + "00" * 12 + "\r"),
        (Frame(0x9, bytes(12), flags=FD | BIT_RATE_SWITCH), "b0099" + "00" * 12 + "\r"),
        (Frame(0x9 | EXTENDED, b"\x01", flags=FD | BIT_RATE_SWITCH), "B00000009101\r"),
    ],
)
def test_frames_both_ways(frame: Frame, text: str) -> None:
    assert format_frame(frame) == text
    assert parse_frame(text[:-1].encode()) == frame


@pytest.mark.parametrize("line", [b"", b"t", b"t12", b"t1239", b"tXYZ1", b"t1232aa", b"t1232aazz", b"x" * 500, b"\xff\xfe"])
def test_no_frames(line: bytes) -> None:
    assert parse_frame(line) is None
