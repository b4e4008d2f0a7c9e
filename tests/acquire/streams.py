"""One second and a half of every instrument at rest, byte by byte, independently of the decoders; and what is no instrument."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import cache, reduce
from operator import xor
from pathlib import Path

import numpy as np
from crccheck.crc import Crc32Base, Crc32Mpeg2, CrcKermit, CrcXmodem

from imufield.acquire.link.serial import Chunk
from imufield.samples import Samples, SampleUnits
from imufield.simulate.instruments.aceinna import aceinna_packet
from imufield.simulate.instruments.microstrain import mip_field, mip_packet
from imufield.simulate.instruments.stim300 import Stim300Device
from imufield.simulate.instruments.vectornav import sentence
from imufield.simulate.instruments.witmotion import wit_frame
from imufield.simulate.instruments.xsens import xbus_message
from imufield.simulate.wire.stim300 import Stim300Format

DURATION_S = 1.5
CHUNK_S = 0.02
G = 9.80665
DEGREE = 0.017453292519943295
FORCE_M_S2 = (0.12, -0.23, 9.79)
RATE_RAD_S = (0.001, -0.002, 0.0005)
TEMPERATURE_DEGC = 25.5


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


STIM300_AT_ONCE = 250


@cache
def stim300_frames(first: int) -> bytes:
    """Return the frames from one on; encoded together they take a hundredth of the time, and no byte depends on it."""
    n = STIM300_AT_ONCE
    several = Samples(
        time_s=np.zeros(n),
        accelerometer=np.tile(FORCE_M_S2, (n, 1)),
        gyroscope=np.tile(RATE_RAD_S, (n, 1)),
        temperature_degc=np.full(n, TEMPERATURE_DEGC),
        counter=np.arange(first, first + n),
        status=np.zeros(n, dtype=np.uint32),
        units=SampleUnits(),
    )
    return Stim300Device(Stim300Format(rate_hz=500, accelerometer_range_g=30)).encode(several).data.tobytes()


def stim300(number: int, time_s: float) -> bytes:
    place = number % STIM300_AT_ONCE
    frames = stim300_frames(number - place)
    size = len(frames) // STIM300_AT_ONCE
    return frames[place * size : (place + 1) * size]


def xsens(number: int, time_s: float) -> bytes:
    parts = (
        (0x1020, struct.pack(">H", number % 65536)),
        (0x1060, struct.pack(">I", round(time_s * 10000) % 2**32)),
        (0x4020, struct.pack(">3f", *FORCE_M_S2)),
        (0x8020, struct.pack(">3f", *RATE_RAD_S)),
        (0x0810, struct.pack(">f", TEMPERATURE_DEGC)),
    )
    return xbus_message(0x36, b"".join(struct.pack(">HB", one, len(data)) + data for one, data in parts))


def vectornav_binary(_: int, time_s: float) -> bytes:
    """Output 1: TimeStartup, UncompAccel, UncompGyro, Temp; z points down."""
    force = (FORCE_M_S2[0], -FORCE_M_S2[1], -FORCE_M_S2[2])
    body = bytes.fromhex("0501001C00") + struct.pack("<Q", round(time_s * 1e9))
    body += struct.pack("<7f", *force, *RATE_RAD_S, TEMPERATURE_DEGC)
    return b"\xfa" + body + int(CrcXmodem.calc(body)).to_bytes(2, "big")


def vectornav_ascii(_: int, __: float) -> bytes:
    force = ",".join(f"{value:+07.3f}" for value in (FORCE_M_S2[0], -FORCE_M_S2[1], -FORCE_M_S2[2]))
    rate = ",".join(f"{value:+010.6f}" for value in RATE_RAD_S)
    return sentence(f"VNIMU,-00.0350,+00.4222,-00.6643,{force},{rate},+25.5,+084.322")


def microstrain(number: int, time: bytes) -> bytes:
    """Return one packet of set 0x80, in every fifth of which is a magnetic field."""
    acceleration = (value / G for value in FORCE_M_S2)
    fields = mip_field(0x04, struct.pack(">3f", *acceleration)) + mip_field(0x05, struct.pack(">3f", *RATE_RAD_S)) + time
    if number % 5 == 0:
        fields += mip_field(0x06, struct.pack(">3f", 0.1, 0.2, 0.3))
    return mip_packet(0x80, fields)


def gx5(number: int, time_s: float) -> bytes:
    return microstrain(number, mip_field(0x12, struct.pack(">dHH", time_s, 2300, 6)))


def cv7(number: int, time_s: float) -> bytes:
    return microstrain(number, mip_field(0xD5, struct.pack(">Q", round(time_s * 1e9))))


def openimu(_: int, time_s: float) -> bytes:
    rate_deg_s = [value / DEGREE for value in RATE_RAD_S]
    return aceinna_packet(b"z1", struct.pack("<I9f", round(time_s * 1e6) % 2**32, *FORCE_M_S2, *rate_deg_s, 0.2, 0.0, 0.4))


def dmu(_: int, time_s: float) -> bytes:
    counts = [round(value / G * 65536 / 20) for value in FORCE_M_S2]
    counts += [round(value / DEGREE * 65536 / 1260) for value in RATE_RAD_S]
    counts += [round(TEMPERATURE_DEGC * 65536 / 200)] * 4
    return aceinna_packet(b"S1", struct.pack(">10hHH", *counts, round(time_s * 327680) % 65536, 0))


def witmotion(_: int, __: float) -> bytes:
    temperature = round(TEMPERATURE_DEGC * 100)
    force = [round(value / G / 16 * 32768) for value in FORCE_M_S2]
    rate = [round(value / DEGREE / 2000 * 32768) for value in RATE_RAD_S]
    frames = ((0x51, [*force, temperature]), (0x52, [*rate, temperature]), (0x53, [10, -20, 30, 11608]))
    return b"".join(wit_frame(kind, words) for kind, words in frames)


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


INSTRUMENTS: dict[str, tuple[str, float, Callable[[int, float], bytes]]] = {
    "stim300": ("stim300", 500, stim300),
    "xsens": ("xsens_mtdata2", 100, xsens),
    "vectornav binary": ("vectornav_binary", 100, vectornav_binary),
    "vectornav ascii": ("vectornav_ascii", 40, vectornav_ascii),
    "microstrain GX5": ("microstrain_mip", 100, gx5),
    "microstrain CV7": ("microstrain_mip", 500, cv7),
    "aceinna z1": ("aceinna_serial", 100, openimu),
    "aceinna S1": ("aceinna_serial", 100, dmu),
    "witmotion": ("witmotion", 20, witmotion),
    "witmotion bluetooth": ("witmotion", 50, bluetooth),
    "kvh": ("kvh_17xx", 1000, kvh),
    "sbg": ("sbg_sbgecom", 200, sbg),
    "novatel": ("novatel_oem7", 200, novatel),
    "novatel ascii": ("novatel_oem7_ascii", 100, novatel_ascii),
    "lines": ("text", 50, lines),
}
"""By name: driver, rate in Hz, bytes of one sample."""


@cache
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
