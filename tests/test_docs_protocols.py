"""The example of docs/protocols.md decodes the frames it describes."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol import load_protocol

PAGE = Path(__file__).resolve().parent.parent / "docs" / "protocols.md"
SAMPLES = 20


def crc16_ccitt_false(data: bytes) -> int:
    """Compute bit by bit what the protocol asks a library for."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x1021 if crc & 0x8000 else 0)
            crc &= 0xFFFF
    return crc


def frame(counter: int) -> bytes:
    numbers = [round(1.0 * 2**18), 0, -counter, 0, round(90.0 * 2**14), 0]
    body = b"\xaa\x55" + struct.pack("<H", counter) + b"".join(struct.pack("<i", number)[:3] for number in numbers)
    body += struct.pack("<h", 525)
    return body + struct.pack("<H", crc16_ccitt_false(body))


def test_the_example_decodes(tmp_path: Path) -> None:
    (block,) = re.findall(r"^```toml\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    (tmp_path / "my_imu.toml").write_text(block, encoding="utf-8")
    decoder = Decoder(load_protocol(tmp_path / "my_imu.toml"))
    samples = decoder.feed(b"".join(frame(counter) for counter in range(SAMPLES)), 0.1)
    assert len(samples) == SAMPLES
    np.testing.assert_allclose(samples.accelerometer[:, 0], 9.80665)
    np.testing.assert_allclose(samples.accelerometer[:, 2], -9.80665 * np.arange(SAMPLES) / 2**18, atol=1e-12)
    np.testing.assert_allclose(samples.gyroscope[:, 1], np.pi / 2)
    np.testing.assert_allclose(samples.temperature_degc, 25.25)
    np.testing.assert_allclose(np.diff(samples.time_s), 0.005)
