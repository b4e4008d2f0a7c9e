"""The encoder against recorded datagrams, a bit-by-bit CRC and numbers worked out by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import load_protocol
from imufield.errors import Reason, UsageError
from imufield.samples import Samples, SampleUnits, Status, make_samples
from imufield.simulate.wire.stim300 import (
    Auxiliary,
    Cluster,
    OutputUnit,
    Stim300Encoder,
    Stim300Format,
    close_datagrams,
    stim300_frames,
)
from tests.refused import refused

G = 9.80665


def bitwise_crc(message: bytes) -> int:
    """CRC-32/MPEG-2 as a shift register, zero bytes to a multiple of four included."""
    register = 0xFFFFFFFF
    for byte in message + bytes(-len(message) % 4):
        for bit in range(7, -1, -1):
            out = (register >> 31) ^ (byte >> bit & 1)
            register = (register << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if out else 0)
    return register


def crcs_of(messages: np.ndarray) -> list[int]:
    return [int.from_bytes(message[-4:].tobytes(), "big") for message in close_datagrams(messages, crlf=False)]


def block(n: int = 5, **columns: Any) -> Samples:
    base: dict[str, Any] = {
        "accelerometer": np.zeros((n, 3)),
        "gyroscope": np.zeros((n, 3)),
        "units": SampleUnits(),
        "temperature_degc": np.full(n, 25.0),
        "counter": np.arange(n),
    }
    return make_samples(np.arange(n) / 100, **{**base, **columns})


def clusters_of(decoded: dict[str, Any]) -> list[Cluster]:
    """Return what a datagram holds; temperatures are printed in degrees."""
    rates = [("gyro_raw", "gyro_status", 1, 3), ("acc_raw", "acc_status", 1, 3), ("incl_raw", "incl_status", 1, 3)]
    degrees = [(f"{name}_temp_c", f"{name}_temp_status", 256, 2) for name in ("gyro", "acc", "incl")]
    return [
        Cluster(np.rint(np.array(decoded[key]) * scale).astype(np.int64).reshape(1, -1), decoded.get(status, 0), size)
        for key, status, scale, size in (*rates, *degrees, ("aux_raw", "aux_status", 1, 3))
        if key in decoded
    ]


def test_recorded_datagrams_are_made_byte_for_byte(shared_folder: Path) -> None:
    vectors = json.loads((shared_folder / "wire" / "stim300.vectors.json").read_text())
    datagrams = [vector for vector in vectors if "gyro_raw" in vector["decoded"] and vector.get("valid", True)]
    assert len(datagrams) == 9
    for vector in datagrams:
        decoded = vector["decoded"]
        counter, latency_us = np.array([decoded["counter"]]), decoded["latency_us"]
        clusters, crlf = clusters_of(decoded), bool(decoded["trailer"])
        made = stim300_frames(int(decoded["id"], 16), clusters, counter, latency_us, crlf=crlf)
        assert made.tobytes().hex() == vector["hex"], vector["source"]


def test_crc_check_values() -> None:
    # Four zero bytes leave what the CRC catalogue lists as the residue of the sister algorithm CRC-32/BZIP2.
    assert crcs_of(np.zeros((1, 4), dtype=np.uint8)) == [bitwise_crc(bytes(4))] == [0xC704DD7B]
    assert crcs_of(np.zeros((1, 1), dtype=np.uint8)) == [0xC704DD7B]


@pytest.mark.parametrize("length", [1, 2, 3, 4, 14, 34, 59])
def test_crc_of_many_is_the_crc_of_each(length: int) -> None:
    messages = np.random.default_rng(length).integers(0, 256, (20, length), dtype=np.uint8)
    assert crcs_of(messages) == [bitwise_crc(message.tobytes()) for message in messages]


@pytest.mark.parametrize(
    ("settings", "datagram_id", "length"),
    [
        (Stim300Format(accelerometer=False, inclinometer=False), 0x90, 18),
        (Stim300Format(inclinometer=False), 0x91, 28),
        (Stim300Format(accelerometer=False), 0x92, 28),
        (Stim300Format(), 0x93, 38),
        (Stim300Format(accelerometer=False, inclinometer=False, temperature=True), 0x94, 25),
        (Stim300Format(inclinometer=False, temperature=True), 0xA5, 42),
        (Stim300Format(accelerometer=False, temperature=True), 0xA6, 42),
        (Stim300Format(temperature=True), 0xA7, 59),
        (Stim300Format(auxiliary="aux"), 0x9B, 42),
        (Stim300Format(temperature=True, auxiliary="aux"), 0xAF, 63),
        (Stim300Format(accelerometer=False, inclinometer=False, auxiliary="pps"), 0xF0, 22),
        (Stim300Format(temperature=True, auxiliary="pps"), 0xF7, 63),
    ],
)
@pytest.mark.parametrize("crlf", [True, False])
def test_content_decides_id_and_length(settings: Stim300Format, datagram_id: int, length: int, crlf: bool) -> None:
    """Ids and lengths as the datasheet's table has them."""
    frames = Stim300Encoder(replace(settings, crlf=crlf)).encode(block())
    assert frames.shape == (5, length + 2 * crlf)
    assert set(frames[:, 0].tolist()) == {datagram_id}
    body, crc = frames[0, : length - 4].tobytes(), frames[0, length - 4 : length].tobytes()
    assert int.from_bytes(crc, "big") == bitwise_crc(body)


def test_si_values_become_the_integers_of_the_datasheet() -> None:
    samples = block(
        1, accelerometer=np.array([[G, -G / 2, 0.0]]), gyroscope=np.radians([[1.0, -1.0, 0.5]]), counter=np.array([300])
    )
    frame = Stim300Encoder(Stim300Format(rate_hz=1000.0)).encode(samples)[0].tobytes()
    integers = [int.from_bytes(frame[k : k + 3], "big", signed=True) for k in (1, 4, 7, 11, 14, 17, 21, 24, 27)]
    assert integers == [2**14, -(2**14), 2**13, 2**19, -(2**18), 0, 2**22, -(2**21), 0]
    assert frame[31] == 600 % 256
    assert int.from_bytes(frame[32:34], "big") == 506


def test_increments_have_their_own_scale() -> None:
    settings = Stim300Format(
        rate_hz=500.0, gyroscope_output="increment", accelerometer_output="increment", accelerometer_range_g=30
    )
    samples = block(1, accelerometer=np.full((1, 3), 8.0), gyroscope=np.radians(np.full((1, 3), 100.0)))
    frame = Stim300Encoder(settings).encode(samples)[0].tobytes()
    assert int.from_bytes(frame[1:4], "big") == round(100 / 500 * 2**21)
    assert int.from_bytes(frame[11:14], "big") == round(8 / 500 * 2**21)


def test_values_beyond_the_range_stay_at_its_end() -> None:
    frame = Stim300Encoder(Stim300Format()).encode(block(1, accelerometer=np.array([[1e4, -1e4, 0.0]])))[0].tobytes()
    assert frame[11:14] == b"\x7f\xff\xff"
    assert frame[14:17] == b"\x80\x00\x00"


def test_status_bytes() -> None:
    status = np.array([0, Status.START_UP, Status.ACCELEROMETER_SATURATED, Status.GYROSCOPE_INVALID, Status.INSTRUMENT_FAULT])
    accelerometer = np.zeros((5, 3))
    accelerometer[2, 1] = 10 * G
    frames = Stim300Encoder(Stim300Format()).encode(block(accelerometer=accelerometer, status=status.astype(np.uint32)))
    assert frames[:, 10].tolist() == [0, 0x40, 0, 0x0F, 0x80]
    assert frames[:, 20].tolist() == [0, 0x40, 0x12, 0, 0x80]


def test_counter_wraps_and_jumps() -> None:
    encoder = Stim300Encoder(Stim300Format(rate_hz=125.0))
    assert encoder.format.counter_step == 16
    encoder.counter_offset = 5
    assert encoder.encode(block(20))[:, 31].tolist() == [(16 * k + 5) % 256 for k in range(20)]


def test_unknown_range_is_refused() -> None:
    with refused(UsageError, Reason.USAGE, "7 g", "2, 5, 10, 30, 80", key="stim300.range") as caught:
        Stim300Encoder(Stim300Format(accelerometer_range_g=7))
    assert caught.value.values["accelerometer_range_g"] == 7


@pytest.mark.parametrize("temperature", [False, True])
@pytest.mark.parametrize("auxiliary", ["none", "aux", "pps"])
@pytest.mark.parametrize("output", ["rate", "increment"])
@pytest.mark.parametrize("range_g", [5, 80])
def test_decoder_reads_back_what_was_encoded(temperature: bool, auxiliary: Auxiliary, output: OutputUnit, range_g: int) -> None:
    rng = np.random.default_rng(range_g)
    sent = block(300, accelerometer=4 * rng.standard_normal((300, 3)), gyroscope=rng.standard_normal((300, 3)))
    settings = Stim300Format(
        rate_hz=500.0,
        accelerometer=True,
        inclinometer=True,
        temperature=temperature,
        auxiliary=auxiliary,
        crlf=True,
        accelerometer_range_g=range_g,
        gyroscope_output=output,
        accelerometer_output=output,
    )
    names = {"accelerometer_range_g": range_g, "accelerometer_output": output, "gyroscope_output": output, "rate_hz": 500}
    got = Decoder(load_protocol("stim300", names)).feed(Stim300Encoder(settings).encode(sent).tobytes(), 0.0)
    # One step of the wire, as a rate; increments have 8 times finer steps in m/s, 128 times finer ones in degrees.
    step_m_s2 = 2.0 ** -{5: 20, 80: 16}[range_g] * (G if output == "rate" else 500 / 8)
    step_rad_s = np.radians(2.0**-14 if output == "rate" else 500 * 2.0**-21)
    assert np.abs(got.accelerometer_rate() - sent.accelerometer).max() <= 0.51 * step_m_s2
    assert np.abs(got.gyroscope_rate() - sent.gyroscope).max() <= 0.51 * step_rad_s
    assert np.array_equal(got.counter, 4 * np.arange(300) % 256)
    if temperature:
        assert got.temperature_degc.tolist() == [25.0] * 300
