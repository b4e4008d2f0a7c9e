"""Packed frames: what goes in comes out, however it is cut, and whatever stands between."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imufield.acquire.protocol.can_frame import ADAPTER_TIME, ERROR, EXTENDED, FD, REMOTE, UNIT_BYTES, Frame, pack_frame
from imufield.acquire.protocol.can_frames import Unpacker, unpack_frames
from tests.acquire.plain_frames import pack_frames, parse_candump

SIZES = (0, 1, 6, 8, 12, 16, 20, 24, 28, 32, 48, 64)


def frames_of_all_sizes(seed: int = 1, count: int = 300) -> list[Frame]:
    rng = random.Random(seed)
    frames = []
    for number in range(count):
        size = rng.choice(SIZES)
        can_id = rng.randrange(1 << 29) | EXTENDED if rng.random() < 0.5 else rng.randrange(1 << 11)
        flags = (FD if size > 8 else 0) | (ADAPTER_TIME if rng.random() < 0.2 else 0)
        frames.append(Frame(can_id, rng.randbytes(size), number * 0.001, flags))
    frames[7] = Frame(ERROR | 0x40, bytes(8), 0.007)
    frames[11] = Frame(0x123 | REMOTE, b"", 0.011)
    return frames


def test_every_size_comes_back() -> None:
    frames = frames_of_all_sizes()
    assert list(unpack_frames(pack_frames(frames))) == frames


def test_a_frame_of_8_bytes_is_24_bytes_by_the_description() -> None:
    packed = pack_frame(0x08F02D80 | EXTENDED, bytes(range(8)), 1.5)
    assert packed.hex() == "802df088" + "08" + "00" + "4eca" + "000000000000f83f" + "0001020304050607"
    assert len(pack_frame(1, bytes(9), flags=FD)) == 2 * UNIT_BYTES
    assert len(pack_frame(1, bytes(64), flags=FD)) == 4 * UNIT_BYTES
    with pytest.raises(ValueError, match="64"):
        pack_frame(1, bytes(65))


@pytest.mark.parametrize("seed", range(4))
def test_cuts_do_not_matter(seed: int) -> None:
    frames = frames_of_all_sizes(seed)
    data = pack_frames(frames)
    rng = random.Random(seed)
    unpacker, found, at = Unpacker(), 0, 0
    while at < len(data):
        step = rng.choice((1, 3, 24, 31, 200, 1000))
        block = unpacker.feed(data[at : at + step])
        for row in range(len(block)):
            frame = frames[found + row]
            assert int(block.can_id[row]) == frame.can_id
            assert block.data(np.array([row]), 64)[0, : block.size[row]].tobytes() == frame.data
        found += len(block)
        at += step
    assert found + len(unpacker.feed(b"", last=True)) == len(frames)
    assert unpacker.bytes_skipped == 0


def test_garbage_is_passed_over_and_counted() -> None:
    frames = [Frame(number, bytes([number] * 8), float(number)) for number in range(1, 40)]
    data = pack_frames(frames[:10]) + b"\x55" * 17 + pack_frames(frames[10:])
    unpacker = Unpacker()
    count = len(unpacker.feed(data)) + len(unpacker.feed(b"", last=True))
    assert count == len(frames)
    assert unpacker.bytes_skipped == 17


def test_a_long_frame_that_lost_a_part_is_no_frame() -> None:
    long = pack_frame(5, bytes(64), flags=FD)
    unpacker = Unpacker()
    data = pack_frame(1, b"a") + long[:UNIT_BYTES] + long[2 * UNIT_BYTES :] + pack_frame(2, b"b")
    block = unpacker.feed(data, last=True)
    assert block.can_id.tolist() == [1, 2]
    assert unpacker.bytes_skipped == 3 * UNIT_BYTES


@given(st.binary(max_size=400))
@settings(max_examples=300, deadline=None)
def test_any_bytes_give_frames_or_are_skipped(data: bytes) -> None:
    unpacker = Unpacker()
    got = sum(len(unpacker.feed(data[at : at + 37])) for at in range(0, len(data), 37))
    got += len(unpacker.feed(b"", last=True))
    assert unpacker.bytes_skipped <= len(data)
    assert got * UNIT_BYTES <= len(data)


def test_candump_text() -> None:
    frame = parse_candump("0cf02a80#807f008080800000")
    assert (frame.can_id, frame.data.hex()) == (0x0CF02A80 | EXTENDED, "807f008080800000")
    assert frame.text == "0CF02A80#807F008080800000"
    assert parse_candump("034#0000").text == "034#0000"
