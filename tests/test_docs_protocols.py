"""The example of docs/protocols.md decodes the frames it describes."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol

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


def example(kind: str) -> str:
    """Return the one protocol of this kind that the page shows."""
    blocks = re.findall(r"^```toml\n(.*?)^```", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    (block,) = [one for one in blocks if f'kind = "{kind}"' in one]
    return str(block)


def test_the_example_of_lines_decodes(tmp_path: Path) -> None:
    (tmp_path / "my_logger.toml").write_text(example("text"), encoding="utf-8")
    protocol = load_protocol(tmp_path / "my_logger.toml")
    decoder = Decoder(protocol)
    lines = [f"$HOME,{(65530 + k) % 65536},512,{498 - k},811,20.5\r\n" for k in range(SAMPLES)]
    samples = decoder.feed("".join(["# begin\r\n", *lines]).encode(), 0.1)
    assert len(samples) == SAMPLES
    assert protocol.units.accelerometer == "count"
    np.testing.assert_array_equal(samples.accelerometer[:, 1], 498 - np.arange(SAMPLES))
    np.testing.assert_array_equal(samples.accelerometer[:, 2], 811)
    np.testing.assert_array_equal(protocol.nominal.raw_zero, 512)
    np.testing.assert_allclose(samples.temperature_degc, 20.5)
    np.testing.assert_allclose(np.diff(samples.time_s), 0.01)


def test_the_example_decodes(tmp_path: Path) -> None:
    block = example("frames")
    (tmp_path / "my_imu.toml").write_text(block, encoding="utf-8")
    decoder = Decoder(load_protocol(tmp_path / "my_imu.toml"))
    samples = decoder.feed(b"".join(frame(counter) for counter in range(SAMPLES)), 0.1)
    assert len(samples) == SAMPLES
    np.testing.assert_allclose(samples.accelerometer[:, 0], 9.80665)
    np.testing.assert_allclose(samples.accelerometer[:, 2], -9.80665 * np.arange(SAMPLES) / 2**18, atol=1e-12)
    np.testing.assert_allclose(samples.gyroscope[:, 1], np.pi / 2)
    np.testing.assert_allclose(samples.temperature_degc, 25.25)
    np.testing.assert_allclose(np.diff(samples.time_s), 0.005)
