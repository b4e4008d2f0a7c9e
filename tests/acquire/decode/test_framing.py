"""Framing against the definition carried out one byte after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from imufield.acquire.decode.framing import Framer
from imufield.acquire.protocol.protocol import load_protocol, parse_protocol

RULE = load_protocol("stim300").frame
assert RULE is not None
SlowFrames = Callable[[bytes], list[int]]
MakeDatagram = Callable[..., bytes]


def frames_of(data: bytes, cuts: Sequence[int] = ()) -> tuple[list[int], Framer]:
    """Return the starts of all frames in the whole stream, and the framer."""
    assert RULE is not None
    framer = Framer(RULE)
    starts: list[int] = []
    edges = [0, *sorted(cuts), len(data)]
    for begin, end in pairwise(edges):
        starts += _offsets(framer, data[begin:end], end)
    return starts + _offsets(framer, b"", len(data), last=True), framer


def _offsets(framer: Framer, part: bytes, end: int, *, last: bool = False) -> list[int]:
    block = framer.feed(part, last=last)
    starts: list[int] = (block.starts + (end - len(block.data))).tolist()
    return starts


def stream(datagram: MakeDatagram, n: int, *, crlf: bool = True) -> bytes:
    rng = np.random.default_rng(n)
    values = rng.integers(-(1 << 23), 1 << 23, (n, 6)).tolist()
    return b"".join(
        datagram(i, gyroscope=tuple(row[:3]), accelerometer=tuple(row[3:]), crlf=crlf) for i, row in enumerate(values)
    )


@pytest.mark.parametrize("crlf", [True, False])
def test_clean_stream_whole_bytewise_and_at_random_cuts(datagram: MakeDatagram, crlf: bool) -> None:
    data = stream(datagram, 200, crlf=crlf)
    step = len(data) // 200
    wanted = [step * i for i in range(200)]
    rng = np.random.default_rng(5)
    for cuts in ([], range(len(data)), *(rng.integers(0, len(data), 40).tolist() for _ in range(5))):
        starts, framer = frames_of(data, list(cuts))
        assert starts == wanted
        assert framer.bytes_skipped == 0
        assert framer.frames_bad_checksum == 0


def test_bytes_before_and_after_and_twice(datagram: MakeDatagram) -> None:
    one = datagram(7)
    for before in (b"", b"\x93", b"\x93" * 100, b"noise\r\n", bytes(range(256))):
        starts, framer = frames_of(before + one + one + b"\x93\x00\xff")
        assert starts == [len(before), len(before) + len(one)]
        assert framer.bytes_skipped == len(before) + 3


def test_every_kind_of_datagram_in_one_stream(
    lengths: dict[int, int], finish: Callable[[bytes], bytes], slow_frames: SlowFrames
) -> None:
    rng = np.random.default_rng(1)
    data = b""
    for _ in range(300):
        key = int(rng.choice(list(lengths)))
        body = bytes([key]) + rng.bytes(lengths[key] - 5)
        data += finish(body) + (b"\r\n" if rng.random() < 0.5 else b"")
    starts, framer = frames_of(data, rng.integers(0, len(data), 30).tolist())
    assert starts == slow_frames(data)
    assert len(starts) == 300
    assert framer.bytes_skipped == 0


@pytest.mark.parametrize("seed", range(6))
def test_damage_loses_no_intact_frame_and_accepts_no_bad_one(
    datagram: MakeDatagram, slow_frames: SlowFrames, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(stream(datagram, 600, crlf=seed % 2 == 0))
    for at in np.flatnonzero(rng.random(len(data)) < 2e-3):
        data[at] ^= 1 << int(rng.integers(8))
    if seed >= 2:
        for at in sorted(rng.integers(0, len(data), 20), reverse=True):
            del data[at : at + int(rng.integers(1, 60))]
    if seed >= 4:
        for at in sorted(rng.integers(0, len(data), 20), reverse=True):
            data[at:at] = rng.bytes(int(rng.integers(1, 90)))
    wanted = slow_frames(bytes(data))
    whole, first = frames_of(bytes(data))
    cut, second = frames_of(bytes(data), rng.integers(0, len(data), 100).tolist())
    assert whole == cut == wanted
    assert first.bytes_skipped == second.bytes_skipped
    assert first.frames_bad_checksum == second.frames_bad_checksum > 0


def test_lost_bytes_are_counted_exactly(datagram: MakeDatagram) -> None:
    data = stream(datagram, 50)
    framer = frames_of(data[: 30 * 10] + b"\x00" * 11 + data[30 * 10 : 30 * 20] + data[30 * 20 + 1 :])[1]
    assert framer.bytes_skipped == 11 + 29
    # The header of frame 20 is what was lost, so no header of a known kind stands behind frame 19.
    assert framer.frames_bad_checksum == 0


def test_a_false_header_hides_no_frame(datagram: MakeDatagram, lengths: dict[int, int]) -> None:
    for key in lengths:
        data = bytes([key]) + datagram(1) + datagram(2) + datagram(3)
        assert frames_of(data)[0] == [1, 31, 61]
        assert frames_of(data[:31], range(31))[0] == [1]


def test_frame_made_of_headers(finish: Callable[[bytes], bytes], slow_frames: SlowFrames) -> None:
    frame = finish(b"\x93" * 34)
    data = b"\x93" * 37 + frame * 40 + b"\x93" * 5 + frame
    assert frames_of(data, range(0, len(data), 7))[0] == slow_frames(data)
    assert len(frames_of(data)[0]) == 41


def test_a_frame_inside_a_damaged_one_is_found(finish: Callable[[bytes], bytes], slow_frames: SlowFrames) -> None:
    inner = finish(b"\x90" + bytes(range(13)))
    outer = [bytearray(finish(b"\xaf" + bytes([i]) * 58)) for i in range(30)]
    outer[10][20:38] = inner
    # Here the inner frame reaches over the end of the damaged one and takes the place of the intact frame behind it.
    outer[20][50:63] = inner[:13]
    outer[21][:5] = inner[13:]
    data = b"".join(bytes(frame) for frame in outer)
    wanted = slow_frames(data)
    assert 10 * 63 + 20 in wanted
    assert 20 * 63 + 50 in wanted
    assert frames_of(data)[0] == wanted
    assert frames_of(data, range(len(data)))[0] == wanted


@pytest.mark.parametrize("frames_a_read", [7, 20])
@pytest.mark.parametrize("keys", [b"\x91", b"\x91\x92"])
def test_bad_frames_in_reads_like_those_before(
    finish: Callable[[bytes], bytes],
    slow_frames: SlowFrames,
    monkeypatch: pytest.MonkeyPatch,
    keys: bytes,
    frames_a_read: int,
) -> None:
    rng = np.random.default_rng(3)
    frames = [bytearray(finish(keys[i % len(keys)].to_bytes() + rng.bytes(23)) + b"\r\n") for i in range(140)]
    length = len(frames[0])
    # Alone, two in a row, the first of a read and the last of one.
    for bad in (45, 50, 51, 80, 84, 119):
        frames[bad][12] ^= 4
    data = b"".join(frames)
    wanted = slow_frames(data)
    assert len(wanted) == 134
    assert RULE is not None
    framer, again = Framer(RULE), []

    def watched(buffer: NDArray[np.uint8]) -> object:
        again.append(Framer._as_before(framer, buffer))
        return again[-1]

    monkeypatch.setattr(framer, "_as_before", watched)
    found: list[tuple[int, str]] = []
    for begin in range(0, len(data), frames_a_read * length):
        block = framer.feed(data[begin : begin + frames_a_read * length])
        places = (block.starts + begin + frames_a_read * length - len(block.data)).tolist()
        found += zip(places, [framer.layout(shape).kind for shape in block.shapes.tolist()], strict=True)
    # Neither all good nor nothing like before: what is tested here.
    assert sum(each is not None and not isinstance(each, tuple) for each in again) >= 2
    assert found == [(start, f"0x{data[start]:02X}") for start in wanted]
    assert framer.bytes_skipped == 6 * length
    assert framer.frames_bad_checksum == 5


def test_half_a_trailer_at_the_end_of_a_read(datagram: MakeDatagram) -> None:
    data = datagram(1) + datagram(2, crlf=False) + b"\r" + datagram(3)
    starts, framer = frames_of(data, range(len(data)))
    assert starts == [0, 30, 59] == frames_of(data)[0]
    assert framer.bytes_skipped == 1 == frames_of(data)[1].bytes_skipped


def test_a_lone_trailer_in_a_stream_without_is_no_skip(datagram: MakeDatagram) -> None:
    one = datagram(1, crlf=False)
    # The trailer and 26 other bytes take the place of one frame, so that the ones behind stay in step.
    data = one * 5 + b"\r\n" + bytes(26) + one * 5
    for cuts in (range(0), range(len(data))):
        starts, framer = frames_of(data, list(cuts))
        assert starts == [28 * i for i in range(11) if i != 5]
        assert framer.bytes_skipped == 26


@pytest.mark.parametrize("size", [1 << 12, 1 << 18])
def test_noise_gives_nothing_and_is_counted(size: int, slow_frames: SlowFrames) -> None:
    noise = np.random.default_rng(9).bytes(size)
    starts, framer = frames_of(noise, range(0, size, 5000))
    assert starts == []
    assert framer.bytes_skipped == size


@settings(max_examples=60, deadline=None)
@given(
    pieces=st.lists(st.tuples(st.one_of(st.binary(max_size=80), st.integers(0, 255)), st.integers(1, 80)), max_size=12),
    places=st.lists(st.integers(0, 400), max_size=5),
)
def test_any_bytes_as_by_the_definition(
    datagram: MakeDatagram, slow_frames: SlowFrames, pieces: list[tuple[bytes | int, int]], places: list[int]
) -> None:
    data = b"".join((datagram(piece) if isinstance(piece, int) else piece)[:size] for piece, size in pieces)
    cuts = [place % (len(data) + 1) for place in places]
    assert frames_of(data, cuts)[0] == slow_frames(data) == frames_of(data)[0]


def test_sync_bytes_wide_keys_and_sums_stand_on_the_same_engine() -> None:
    text = """
        format = "imufield-protocol"
        version = 1
        name = "own"
        title = "own"
        manual = "none"
        kind = "frames"
        byte_order = "little"
        [frame]
        sync = "55 AA"
        key = { at = 2, type = "u16", byte_order = "big" }
        checksum = { algorithm = "SUM-16", from = 2 }
        [parts]
        body = [{ name = "accelerometer", type = "i24", count = 3 }]
        long = [{ name = "more", type = "f64" }]
        [frames]
        0x7A31 = ["body"]
        0x7A32 = ["body", "long"]
        [samples]
        accelerometer = { fields = ["accelerometer"], unit = "count" }
        """
    rule = parse_protocol(text).frame
    assert rule is not None
    bodies = [b"\x7a\x31" + bytes(range(9)), b"\x7a\x32" + bytes(range(17)), b"\x7a\x33" + bytes(9)]
    frames = [b"\x55\xaa" + body + (sum(body) % 65536).to_bytes(2, "little") for body in bodies]
    data = b"\x55" + b"".join(frames * 20) + b"\x55\xaa"
    framer = Framer(rule)
    found = [framer.feed(data[i : i + 3]).shapes.tolist() for i in range(0, len(data), 3)]
    assert [framer.layout(shape).kind for shape in chain.from_iterable(found)] == ["0x7A31", "0x7A32"] * 20
    assert framer.frames_bad_checksum == 0
    framer.feed(b"", last=True)
    assert framer.bytes_skipped == 1 + 20 * len(frames[2]) + 2
