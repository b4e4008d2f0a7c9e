"""Protocol files as a user writes them for an instrument of his own, one of frames and one of lines."""

from __future__ import annotations

import struct
from collections.abc import Sequence

FRAMES = """format = "imufield-protocol"
version = 1
name = "mine"
title = "mine"
manual = "mine"
kind = "frames"
byte_order = "big"
[frame]
sync = "AA 55"
[parts]
all = [
    { name = "counter", type = "u8" },
    { name = "status", type = "u8" },
    { name = "label", type = "ascii", size = 2 },
    { name = "pair", type = "u8", count = 2 },
    { name = "share", type = "f32" },
    { name = "ax", type = "f32", unit = "m/s^2" },
    { name = "ay", type = "f32", unit = "m/s^2" },
    { name = "az", type = "f32", unit = "m/s^2" },
    { name = "gyroscope", type = "f32", count = 3, unit = "rad/s" },
    { name = "temperature", type = "i16", unit = "degC" },
]
[frames]
any = ["all"]
[samples]
accelerometer = { fields = ["ax", "ay", "az"] }
gyroscope = { fields = ["gyroscope"] }
temperature = { fields = ["temperature"] }
flags = [{ field = "status", mask = 1, flag = "start_up" }]
[clock]
counter = { field = "counter", ticks_per_s = 100 }
rate_hz = 100
"""

LINES = """format = "imufield-protocol"
version = 1
name = "mine"
title = "mine"
manual = "mine"
kind = "text"
[text]
columns = "counter,ax,ay,az,gx,gy,gz,temperature"
[samples]
accelerometer = { fields = ["ax", "ay", "az"], unit = "g" }
gyroscope = { fields = ["gx", "gy", "gz"], unit = "deg/s" }
temperature = { fields = ["temperature"], unit = "degC" }
[clock]
counter = { field = "counter", modulus = 65536, ticks_per_s = 100 }
"""


def changed(text: str, *changes: tuple[str, str]) -> str:
    """Return a protocol file with each text replaced once by another."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def frame(
    counter: bytes = b"\0",
    status: bytes = b"\0",
    acceleration: Sequence[float] = (1.0, 2.0, 3.0),
    temperature: int = 25,
) -> bytes:
    """Return one frame; counter and status as their bytes stand in it."""
    numbers = struct.pack(">2s2Bf3f3fh", b"ok", 0, 0, 0.5, *acceleration, 0.1, 0.2, 0.3, temperature)
    return b"\xaa\x55" + counter + status + numbers
