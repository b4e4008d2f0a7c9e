"""Status bits of frames, made by hand after the instruments' manuals: which of them make a sample unusable."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Literal

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.can_frame import Frame
from imufield.acquire.protocol.checksum import make_checksum
from imufield.acquire.protocol.protocol import load_protocol
from imufield.samples import Samples, Status, concatenate
from tests.acquire.plain_frames import pack_frames


def sample_of(name: str, frame: bytes, given: Mapping[str, object]) -> Samples:
    decoder = Decoder(load_protocol(name, given))
    return concatenate([decoder.feed(frame), decoder.flush()])


def with_crc(algorithm: str, covered: bytes, order: Literal["little", "big"], **parameters: int) -> bytes:
    crc = make_checksum(algorithm, **parameters).of_rows(np.frombuffer(covered, dtype=np.uint8).reshape(1, -1))
    return covered + int(crc[0]).to_bytes(4 if "32" in algorithm else 2, order)


def sbg(status: int) -> bytes:
    """Return IMU_DATA: 1 m/s^2 and 2 rad/s on each axis."""
    body = struct.pack("<IH13f", 1000, status, *[1.0] * 3, *[2.0] * 3, 20.0, *[0.0] * 6)
    return b"\xff\x5a" + with_crc("CRC-16/KERMIT", b"\x03\x00" + struct.pack("<H", len(body)) + body, "little") + b"\x33"


def vectornav(saturation: int) -> bytes:
    body = b"\x04" + struct.pack("<H", 1 << 2 | 1 << 3 | 1 << 11) + struct.pack("<6fH", *[1.0] * 6, saturation)
    return b"\xfa" + with_crc("CRC-16/XMODEM", body, "big")


def aceinna(status: int) -> bytes:
    body = b"S1\x18" + struct.pack(">10hHH", *[100] * 10, 0, status)
    return b"\x55\x55" + with_crc("CRC-16/SPI-FUJITSU", body, "big")


def novatel(info: int) -> bytes:
    body = struct.pack("<BBHdI6i", info, 68, 2300, 1.0, 0, *[1] * 6)
    return with_crc(
        "CRC-32/ISO-HDLC", b"\xaa\x44\x13\x28" + struct.pack("<HHI", 1462, 2300, 1000) + body, "little", start=0, final=0
    )


RELEVANT = Status.INSTRUMENT_FAULT | Status.ACCELEROMETER_SATURATED | Status.GYROSCOPE_SATURATED
SATURATED = Status.ACCELEROMETER_SATURATED, Status.GYROSCOPE_SATURATED


@pytest.mark.parametrize(
    ("name", "frame", "flag"),
    [
        # sbgECom, sbgEComLogImu.h; VectorNav, SENSSAT of its library; DMU38x manual, BIT status; OEM7 reference, RAWIMUX.
        ("sbg_sbgecom", sbg(0x300), Status.GOOD),
        ("sbg_sbgecom", sbg(0x200), SATURATED[0]),
        ("sbg_sbgecom", sbg(0x100), SATURATED[1]),
        ("vectornav_binary", vectornav(0x0007), Status.GOOD),
        *(("vectornav_binary", vectornav(1 << bit), SATURATED[bit > 5]) for bit in range(3, 9)),
        ("aceinna_serial", aceinna(0x1000), Status.GOOD),
        ("aceinna_serial", aceinna(0x0001), Status.INSTRUMENT_FAULT),
        ("novatel_oem7", novatel(0x04), Status.GOOD),
        ("novatel_oem7", novatel(0x01), Status.INSTRUMENT_FAULT),
        ("novatel_oem7", novatel(0x02), Status.INSTRUMENT_FAULT),
    ],
)
def test_bits_that_make_a_sample_unusable(name: str, frame: bytes, flag: Status) -> None:
    samples = sample_of(name, frame, {"log": "imu_data"} if name.startswith("sbg") else {})
    assert [int(status) & RELEVANT for status in samples.status] == [flag]


@pytest.mark.parametrize(("status", "flag"), [(0x300, Status.GOOD), (0x200, SATURATED[0]), (0x100, SATURATED[1])])
def test_the_same_bits_on_a_bus(status: int, flag: Status) -> None:
    frames = [
        Frame(can_id, data, number * 0.01 + (can_id & 3) * 2e-4)
        for number in range(60)
        for can_id, data in (
            (0x120, struct.pack("<IHh", number * 10_000, status, 2000)),
            (0x121, struct.pack("<3h", 0, 0, -980)),
            (0x122, struct.pack("<3h", 1, 2, 3)),
        )
        # Status and time come in one frame: without it there is no sample, and none that is flagged wrongly.
        if (number, can_id) != (30, 0x120)
    ]
    decoder = Decoder(load_protocol("sbg_can"))
    samples = concatenate([decoder.feed(pack_frames(frames)), decoder.flush()])
    assert [int(each) & RELEVANT for each in samples.status] == [flag] * 59
    assert np.flatnonzero(samples.status & Status.AFTER_GAP).tolist() == [30]


def test_the_bit_of_the_short_log_scales_no_other() -> None:
    samples = sample_of("sbg_sbgecom", sbg(0x700), {"log": "imu_data"})
    assert samples.gyroscope.tolist() == [[2.0, 2.0, 2.0]]
