"""Ten seconds of every instrument at rest, made byte by byte, independently of the decoders; and what is no instrument."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
from crccheck.crc import Crc32Base, Crc32Mpeg2, CrcKermit

from imufield.acquire.link import Chunk
from imufield.simulate.instrument_aceinna import AceinnaInstrument
from imufield.simulate.instrument_microstrain import MicroStrainInstrument
from imufield.simulate.instrument_stim300 import Stim300Instrument
from imufield.simulate.instrument_vectornav import VectorNavInstrument
from imufield.simulate.instrument_witmotion import WitMotionInstrument
from imufield.simulate.instrument_xsens import XsensInstrument
from imufield.simulate.instruments import ScriptedInstrument

DURATION_S = 2.5
CHUNK_S = 0.02
G = 9.80665


class _NovatelCrc(Crc32Base):  # type: ignore[misc]
    """CRC-32 of NovAtel logs: that of Ethernet without the inversions."""

    _names = ("novatel",)
    _width = 32
    _poly = 0x04C11DB7
    _initvalue = 0
    _reflect_input = True
    _reflect_output = True
    _xor_output = 0
    _check_result = 0


def kvh(number: int, _: float) -> bytes:
    body = bytes.fromhex("FE81FF55") + struct.pack(">6f", 1e-5, 2e-5, -1e-5, 0.01, -0.02, 0.998)
    body += struct.pack(">BBh", 0x77, number % 128, 31)
    return body + struct.pack(">I", Crc32Mpeg2.calc(body))


def sbg(number: int, time_s: float) -> bytes:
    force = [round(value * 1048576) for value in (0.1, 0.2, -9.79)]
    data = struct.pack("<IH3i3ih", round(time_s * 1e6) % 2**32, 0x7F, *force, 100, -200, 50, 25 * 256)
    body = struct.pack("<BBH", 44, 0, len(data)) + data
    return b"\xff\x5a" + body + struct.pack("<H", CrcKermit.calc(body)) + b"\x33"


def _raw_imu(time_s: float) -> tuple[float, int, list[int]]:
    return 100.0 + time_s, 0x77, [round(9.79 / 200 * 2**29), 100, -200, 5, 6, 7]


def novatel(number: int, time_s: float) -> bytes:
    seconds, status, values = _raw_imu(time_s)
    body = struct.pack("<BBHdI6i", 0, 58, 2300, seconds, status, *values)
    frame = struct.pack("<3sBHHI", b"\xaa\x44\x13", len(body), 1462, 2300, round(seconds * 1000)) + body
    return frame + struct.pack("<I", _NovatelCrc.calc(frame))


def novatel_ascii(number: int, time_s: float) -> bytes:
    seconds, status, values = _raw_imu(time_s)
    text = f"RAWIMUSXA,2300,{seconds:.3f};00,58,2300,{seconds:.6f},{status:08x},{','.join(map(str, values))}"
    return f"%{text}*{_NovatelCrc.calc(text.encode()):08x}\r\n".encode()


def lines(number: int, time_s: float) -> bytes:
    return f"{time_s:.4f},0.1203,-0.2301,9.7912,0.0011,-0.0021,0.0004\r\n".encode()


def bluetooth(number: int, _: float) -> bytes:
    words = [round(value / G / 16 * 32768) for value in (0.1, -0.2, 9.79)] + [1, -2, 3, 100, -200, 300 + number % 3]
    return struct.pack("<BB9h", 0x55, 0x61, *words)


def nmea(number: int, time_s: float) -> bytes:
    sentences = ("GPGGA,120013.800,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,", "GPVTG,054.7,T,034.4,M,005.5,N,010.2,K")
    return b"".join(f"${text}*{reduce(xor, text.encode(), 0):02X}\r\n".encode() for text in sentences)


def _of(instrument: ScriptedInstrument) -> Callable[[int, float], bytes]:
    return instrument.sample


INSTRUMENTS: dict[str, tuple[str, float, Callable[[int, float], bytes]]] = {
    "stim300": ("stim300", 500, _of(Stim300Instrument(500))),
    "xsens": ("xsens_mtdata2", 100, _of(XsensInstrument())),
    "vectornav binary": ("vectornav_binary", 100, _of(VectorNavInstrument())),
    "vectornav ascii": ("vectornav_ascii", 40, _of(VectorNavInstrument(40, binary=False))),
    "microstrain GX5": ("microstrain_mip", 100, _of(MicroStrainInstrument())),
    "microstrain CV7": ("microstrain_mip", 500, _of(MicroStrainInstrument(500, legacy=False))),
    "aceinna z1": ("aceinna_serial", 100, _of(AceinnaInstrument())),
    "aceinna S1": ("aceinna_serial", 100, _of(AceinnaInstrument(dmu=True))),
    "witmotion": ("witmotion", 20, _of(WitMotionInstrument(20))),
    "witmotion bluetooth": ("witmotion", 50, bluetooth),
    "kvh": ("kvh_17xx", 1000, kvh),
    "sbg": ("sbg_sbgecom", 200, sbg),
    "novatel": ("novatel_oem7", 200, novatel),
    "novatel ascii": ("novatel_oem7_ascii", 100, novatel_ascii),
    "lines": ("text", 50, lines),
}
"""By name: driver, rate in Hz, bytes of one sample."""


def stream(name: str) -> tuple[bytes, float]:
    """Return bytes and how many of them come in a second."""
    _, rate_hz, sample = INSTRUMENTS[name]
    data = b"".join(sample(number, number / rate_hz) for number in range(int(DURATION_S * rate_hz)))
    return data, len(data) / DURATION_S


def others(name: str) -> tuple[bytes, float]:
    """Return bytes that no driver reads."""
    rng = np.random.default_rng(77)
    data = {
        "noise": rng.integers(0, 256, 100_000, dtype=np.uint8).tobytes(),
        "wrong bit rate": rng.choice(np.array([0, 0x80, 0xE0, 0xFE, 0xFF], dtype=np.uint8), 60_000).tobytes(),
        "many 55": rng.choice(np.array([0x55, 0x51, 0x52, 0x61, 0], dtype=np.uint8), 60_000).tobytes(),
        "nmea": b"".join(nmea(number, 0.0) for number in range(100)),
        "log": b"boot ok\r\nsensor ready 1,2,3\r\nvalue=12.5 7 8 9 1 2 3\r\n" * 300,
        "temperatures": b"".join(f"{number},21.5,22.0,21.7,40,41,42\n".encode() for number in range(300)),
        "zeros": bytes(20_000),
    }[name]
    return data, len(data) / DURATION_S


OTHERS = ("noise", "wrong bit rate", "many 55", "nmea", "log", "temperatures", "zeros")


def flipped(data: bytes, probability: float = 1e-4, seed: int = 5) -> bytes:
    """Return the bytes with one bit turned in some of them."""
    rng = np.random.default_rng(seed)
    hit = rng.random(len(data)) < probability
    bits = np.where(hit, 1 << rng.integers(0, 8, len(data)), 0).astype(np.uint8)
    return (np.frombuffer(data, dtype=np.uint8) ^ bits).tobytes()


def chunks(data: bytes, bytes_per_s: float) -> Iterator[Chunk]:
    """Yield the bytes as a port hands them out."""
    size = max(round(bytes_per_s * CHUNK_S), 1)
    for number, at in enumerate(range(0, len(data), size)):
        yield Chunk(data[at : at + size], 1000.0 + (number + 1) * CHUNK_S, 0)


def recording(shared: Path, name: str) -> bytes:
    """Return the first bytes of a recording of a real instrument."""
    paths = {
        "stim300": "stim300/stim300_0x93_crlf_125hz_30g_motion_corrupt_tail_ubc3.bin",
        "xsens": "xsens_mtdata2/mti_g_710_output_1.bin",
        "vectornav binary": "vectornav_binary/vn100_F00294_mixed_log.bin",
        "microstrain": "microstrain_mip/mip_data_first_180000_bytes.bin",
        "aceinna z1": "aceinna_serial/openimu_z1.raw",
        "aceinna S1": "aceinna_serial/imu381_S1_scale1.raw",
    }
    return (shared / "captures" / paths[name]).read_bytes()[:20_000]


RECORDED = {
    "stim300": "stim300",
    "xsens": "xsens_mtdata2",
    "vectornav binary": "vectornav_binary",
    "microstrain": "microstrain_mip",
    "aceinna z1": "aceinna_serial",
    "aceinna S1": "aceinna_serial",
}
