"""Fields of frames as samples, in protocol files of a user's own."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.protocol.protocol import parse_protocol
from imufield.samples import Samples, Status, concatenate
from tests.acquire.own_protocols import FRAMES, changed, frame

COUNTER = '{ name = "counter", type = "u8" }'
CODES = {"i8": ">b", "i16": ">h", "i32": ">i", "i64": ">q", "u8": ">B", "u64": ">Q"}
G = 9.80665


def decode(text: str, frames: list[bytes], rate_hz: float = 0.0) -> tuple[Samples, Decoder]:
    """Decode frame by frame; with a rate, each arrives at its time."""
    decoder = Decoder(parse_protocol(text))
    arrivals = [n / rate_hz if rate_hz else float("nan") for n in range(len(frames))]
    blocks = [decoder.feed(data, at_s) for data, at_s in zip(frames, arrivals, strict=True)]
    return concatenate([*blocks, decoder.flush()]), decoder


def counted(kind: str, first: int, numbers: range) -> list[bytes]:
    """Return frames whose counter began at a number and wraps as its type does; every hundredth is lost."""
    size = struct.calcsize(CODES[kind])
    wrapped = [(first + n) % (1 << 8 * size) for n in numbers if n % 100 != 50]
    return [frame(value.to_bytes(size, "big")) for value in wrapped]


@pytest.mark.parametrize("rate_hz", [0.0, 99.0])
@pytest.mark.parametrize(
    ("kind", "first"),
    [("i8", 100), ("i16", 2**15 - 200), ("i32", 2**31 - 200), ("i64", -300), ("u64", 0), ("u64", 2**63 - 200)],
)
def test_a_counter_of_any_whole_type_wraps_where_its_bits_end(kind: str, first: int, rate_hz: float) -> None:
    text = changed(FRAMES, (COUNTER, COUNTER.replace("u8", kind)))
    samples, decoder = decode(text, counted(kind, first, range(1000)), rate_hz)
    assert len(samples) == 990
    assert (decoder.statistics.samples_lost, decoder.statistics.losses_estimated) == (10, 0)
    assert np.flatnonzero(samples.status & np.uint32(Status.AFTER_GAP)).tolist() == [50 + 99 * n for n in range(10)]
    assert samples.time_s[-1] - samples.time_s[0] == pytest.approx(9.99)
    if kind[-2:] == "64":
        assert samples.counter.min() >= 0, "-1 stands for no counter"
    else:
        modulus = 1 << 8 * struct.calcsize(CODES[kind])
        assert samples.counter.tolist() == [(first + n) % modulus for n in range(1000) if n % 100 != 50]


@pytest.mark.parametrize("rate_hz", [0.0, 99.0])
@pytest.mark.parametrize(("kind", "modulus"), [("i8", 100), ("i16", 1000), ("i16", 60_000), ("i64", 1000)])
def test_a_counter_with_a_sign_wraps_where_the_protocol_says(kind: str, modulus: int, rate_hz: float) -> None:
    stated = ("counter = { field", f"counter = {{ modulus = {modulus}, field")
    text = changed(FRAMES, (COUNTER, COUNTER.replace("u8", kind)), stated)
    kept = [number for number in range(3000) if number % 100 != 50]
    frames = [frame(struct.pack(CODES[kind], number % modulus - modulus // 2)) for number in kept]
    samples, decoder = decode(text, frames, rate_hz)
    assert (decoder.statistics.samples_lost, decoder.statistics.losses_estimated) == (30, 0)
    assert samples.time_s[-1] - samples.time_s[0] == pytest.approx(29.99)
    assert samples.counter.tolist() == [(number + modulus // 2) % modulus for number in kept], "from 0 on"


@pytest.mark.parametrize("kind", ["i16", "i32"])
def test_a_time_stamp_with_a_sign_wraps_too(kind: str) -> None:
    text = changed(FRAMES, (COUNTER, COUNTER.replace("u8", kind)), ("counter = { field", "time = { field"))
    bits = 8 * struct.calcsize(CODES[kind])
    samples, decoder = decode(text, counted(kind, 2 ** (bits - 1) - 200, range(1000)))
    assert (decoder.statistics.samples_lost, decoder.statistics.clock_resets) == (10, 0)
    assert samples.time_s[-1] - samples.time_s[0] == pytest.approx(9.99)


def test_a_scale_of_the_temperature_counts() -> None:
    text = changed(
        FRAMES,
        ('type = "i16", unit', 'type = "i16", scale = 2, offset = 40, unit'),
        ('{ fields = ["temperature"] }', '{ fields = ["temperature"], scale = 0.1 }'),
    )
    samples, _ = decode(text, [frame(temperature=105)])
    assert samples.temperature_degc.tolist() == pytest.approx([25.0])


def test_each_axis_is_scaled_by_its_own_unit() -> None:
    text = changed(
        FRAMES,
        ('"ax", type = "f32", unit = "m/s^2"', '"ax", type = "f32", unit = "g"'),
        ('"ay", type = "f32", unit = "m/s^2"', '"ay", type = "f32", offset = 500, unit = "mg"'),
    )
    samples, _ = decode(text, [frame(acceleration=(1.0, 1500.0, 3.0))])
    np.testing.assert_allclose(samples.accelerometer, [[G, 2 * G, 3.0]])


@pytest.mark.parametrize(("kind", "mask"), [("u64", 1 << 63), ("i64", 1 << 63), ("u32", 1 << 31), ("i8", 1 << 7)])
def test_the_highest_bit_may_be_a_flag(kind: str, mask: int) -> None:
    text = changed(FRAMES, ('"status", type = "u8"', f'"status", type = "{kind}"'), ("mask = 1,", f"mask = {mask},"))
    size = int(kind[1:]) // 8
    samples, _ = decode(text, [frame(bytes([n]), value.to_bytes(size, "big")) for n, value in enumerate((0, mask, mask - 1))])
    assert [bool(status & np.uint32(Status.START_UP)) for status in samples.status] == [False, True, False]
