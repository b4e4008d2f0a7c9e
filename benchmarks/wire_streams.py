"""Clean streams of every byte-stream format, made here: random values, counters and time stamps that go on, good checksums."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.protocol.checksum import make_checksum

Rows = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Stream:
    name: str
    protocol: str
    settings: dict[str, object]
    data: bytes
    frames: int
    is_fixed: bool
    """Whether the layout is fixed by the key; else fields or masks tell it."""


def _rows(frames: int, head: bytes, body: bytes) -> Rows:
    return np.tile(np.frombuffer(head + body, dtype=np.uint8), (frames, 1))


def _put(rows: Rows, at: int, kind: str, values: NDArray[Any]) -> None:
    raw = np.ascontiguousarray(values.astype(kind)).view(np.uint8).reshape(len(rows), -1)
    rows[:, at : at + raw.shape[1]] = raw


def _closed(rows: Rows, algorithm: str, first: int, kind: str, **more: int) -> bytes:
    value = make_checksum(algorithm, **more).of_rows(rows[:, first:])
    return np.hstack([rows, np.ascontiguousarray(value.astype(kind)).view(np.uint8).reshape(len(rows), -1)]).tobytes()


def _floats(frames: int) -> NDArray[np.float32]:
    return np.random.default_rng(1).normal(size=(frames, 6)).astype(np.float32)


def xsens(frames: int) -> Stream:
    """Counter, time, status, acceleration, rate: 60 bytes."""
    number = np.arange(frames)
    parts = [("1020", 2), ("1060", 4), ("E020", 4), ("4020", 12), ("8020", 12)]
    body = b"".join(bytes.fromhex(did) + bytes([size]) + bytes(size) for did, size in parts)
    rows = _rows(frames, b"\xfa\xff\x36" + bytes([len(body)]), body)
    _put(rows, 7, ">u2", number)
    _put(rows, 12, ">u4", number * 25)
    _put(rows, 26, ">f4", _floats(frames)[:, :3])
    _put(rows, 41, ">f4", _floats(frames)[:, 3:])
    return Stream("Xsens MTData2", "xsens_mtdata2", {}, _closed(rows, "SUM-8/NEGATED", 1, "u1"), frames, False)


def microstrain(frames: int) -> Stream:
    """Reference time, time step, acceleration, rate: 54 bytes."""
    body = b"\x0a\xd5" + bytes(8) + b"\x0a\xd6" + bytes(8) + b"\x0e\x04" + bytes(12) + b"\x0e\x05" + bytes(12)
    rows = _rows(frames, b"\x75\x65\x80" + bytes([len(body)]), body)
    _put(rows, 6, ">u8", np.arange(frames) * 1_000_000)
    _put(rows, 26, ">f4", _floats(frames)[:, :3])
    _put(rows, 40, ">f4", _floats(frames)[:, 3:])
    return Stream("MicroStrain MIP", "microstrain_mip", {}, _closed(rows, "FLETCHER-16/MOD-256", 0, ">u2"), frames, False)


def microstrain_mixed(frames: int) -> Stream:
    """The same with a shorter attitude packet behind every fourth."""
    first = np.frombuffer(microstrain(frames * 4 // 5).data, dtype=np.uint8).reshape(-1, 54)
    rows = _rows(len(first) // 4, b"\x75\x65\x82\x0e", b"\x0e\x05" + bytes(12))
    second = np.frombuffer(_closed(rows, "FLETCHER-16/MOD-256", 0, ">u2"), dtype=np.uint8).reshape(-1, 20)
    data = np.hstack([first.reshape(len(second), -1), second]).tobytes()
    return Stream("MicroStrain MIP, two lengths", "microstrain_mip", {}, data, 5 * len(second), False)


def vectornav(frames: int) -> Stream:
    """Time, uncompensated acceleration and rate, temperature: 44 bytes."""
    rows = _rows(frames, b"\xfa\x05\x01\x00\x1c\x00", bytes(36))
    _put(rows, 6, "<u8", np.arange(frames) * 1_250_000)
    _put(rows, 14, "<f4", _floats(frames))
    return Stream("VectorNav binary", "vectornav_binary", {}, _closed(rows, "CRC-16/XMODEM", 1, ">u2"), frames, False)


def aceinna(frames: int) -> Stream:
    """z1: 47 bytes."""
    rows = _rows(frames, b"\x55\x55z1\x28", bytes(40))
    _put(rows, 5, "<u4", np.arange(frames) * 5000 % 2**32)
    _put(rows, 9, "<f4", _floats(frames))
    return Stream("Aceinna z1", "aceinna_serial", {}, _closed(rows, "CRC-16/SPI-FUJITSU", 2, ">u2"), frames, True)


def witmotion(frames: int) -> Stream:
    """Acceleration and rate by turns: 11 bytes each."""
    rows = _rows(frames, b"\x55\x51", bytes(8))
    rows[1::2, 1] = 0x52
    rows[:, 2:10] = np.random.default_rng(1).integers(0, 256, (frames, 8))
    return Stream("WitMotion", "witmotion", {"rate_hz": 100}, _closed(rows, "SUM-8", 0, "u1"), frames, True)


def novatel(frames: int) -> Stream:
    """RAWIMUSX: 56 bytes."""
    rows = _rows(frames, b"\xaa\x44\x13\x28\xb6\x05", bytes(46))
    _put(rows, 16, "<f8", np.arange(frames) * 0.005)
    _put(rows, 28, "<i4", (_floats(frames) * 1e5).astype(np.int64))
    data = _closed(rows, "CRC-32/ISO-HDLC", 0, "<u4", start=0, final=0)
    return Stream("NovAtel RAWIMUSX", "novatel_oem7", {"imu": "hg4930"}, data, frames, True)


def kvh(frames: int) -> Stream:
    """Format A: 36 bytes."""
    rows = _rows(frames, b"\xfe\x81\xff\x55", bytes(24) + b"\x77\x00\x00\x19")
    _put(rows, 4, ">f4", _floats(frames))
    rows[:, 29] = np.arange(frames) % 128
    return Stream("KVH 17xx A", "kvh_17xx", {}, _closed(rows, "CRC-32/MPEG-2", 0, ">u4"), frames, True)


def sbg(frames: int) -> Stream:
    """IMU_SHORT: 41 bytes."""
    rows = _rows(frames, b"\xff\x5a\x2c\x00" + struct.pack("<H", 32), bytes(4) + b"\x00\x03" + bytes(26))
    _put(rows, 6, "<u4", np.arange(frames) * 5000 % 2**32)
    _put(rows, 12, "<i4", (_floats(frames) * 1e5).astype(np.int64))
    closed = np.frombuffer(_closed(rows, "CRC-16/KERMIT", 2, "<u2"), dtype=np.uint8).reshape(frames, -1)
    data = np.hstack([closed, np.full((frames, 1), 0x33, dtype=np.uint8)]).tobytes()
    return Stream("SBG IMU_SHORT", "sbg_sbgecom", {}, data, frames, True)


STREAMS: tuple[Callable[[int], Stream], ...] = (
    xsens,
    microstrain,
    microstrain_mixed,
    vectornav,
    aceinna,
    witmotion,
    novatel,
    kvh,
    sbg,
)
