"""Recordings made block by block, so that every byte of them is known."""

from __future__ import annotations

import itertools
import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.mcap_format import (
    CHUNK,
    CHUNK_LIMIT_BYTES,
    RECORD,
    chunk_record,
    end_of_part,
    event_message,
    link_message,
    start_of_part,
)
from imufield.acquire.recording.reader import (
    Damage,
    PartStart,
    RecordedBlock,
    RecordedEvent,
    read_blocks,
    read_part,
    read_session,
    recorded_chunks,
)
from imufield.acquire.recording.recorder import Recorder
from imufield.acquire.recording.session import Session
from imufield.errors import Reason, RecordingError, UsageError
from tests.refused import refused

START_NS = 1_700_000_000_000_000_000
METADATA = {"driver": "stim300", "protocol": {"name": "stim300", "text": "sync = [147]\n"}, "baud": 921600}

Item = Chunk | RecordedEvent


@dataclass(frozen=True)
class MadePart:
    """Bytes of a part, its blocks' places and what they hold."""

    data: bytes
    blocks: tuple[tuple[int, int, tuple[Item, ...]], ...]
    """Start, end and items of each block."""

    @property
    def items(self) -> list[Item]:
        return [item for _, _, items in self.blocks for item in items]

    @property
    def head_size(self) -> int:
        return self.blocks[0][0]

    @property
    def end_start(self) -> int:
        return self.blocks[-1][1]

    def items_before(self, position: int) -> list[Item]:
        """Items of the blocks that are complete in the first ``position`` bytes."""
        return [item for _, end, items in self.blocks if end <= position for item in items]

    def items_without(self, position: int) -> list[Item]:
        """Items of the blocks that do not contain a byte."""
        return [item for start, end, items in self.blocks if not start <= position < end for item in items]


def block_items(number: int) -> tuple[Item, ...]:
    chunks = [
        Chunk(bytes((number * 7 + k * k) % 256 for k in range(20 + i)), 100.0 + number / 7 + i / 50, START_NS + number * 9 + i)
        for i in range(3)
    ]
    event = RecordedEvent({"event": "mark", "number": number, "words": "wörld"}, START_NS + number)
    return (chunks[0], event, chunks[1], chunks[2])


def encode(item: Item, sequence: int) -> bytes:
    if isinstance(item, Chunk):
        return link_message(item.data, item.monotonic_s, item.utc_ns, sequence)
    return event_message(item.event, item.utc_ns, sequence)


def make_part(blocks: int = 4) -> MadePart:
    data = start_of_part(METADATA)
    made = []
    for number in range(blocks):
        items = block_items(number)
        record = chunk_record([encode(item, i) for i, item in enumerate(items)])
        made.append((len(data), len(data) + len(record), items))
        data += record
    return MadePart(data + end_of_part(), tuple(made))


def read_items(path: Path, damage: list[Damage] | None = None) -> list[Item]:
    return [item for item in read_part(path, damage) if not isinstance(item, PartStart)]


@pytest.fixture
def made() -> MadePart:
    return make_part()


@pytest.fixture
def short() -> MadePart:
    """A first block, one between others and a last, where each byte of them is tried."""
    return make_part(3)


def written(folder: Path, data: bytes, name: str = "part-001.mcap") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def test_a_whole_part_comes_back_exactly(made: MadePart, tmp_path: Path) -> None:
    damage: list[Damage] = []
    first, *rest = read_part(written(tmp_path, made.data), damage)
    assert first == PartStart(tmp_path / "part-001.mcap", METADATA)
    assert rest == made.items
    assert damage == []


@pytest.mark.parametrize("monotonic_s", [0.1, 1e-300, 2.0**53 + 2.0, 123456789.987654321, -5.0])
def test_arrival_times_keep_every_bit(tmp_path: Path, monotonic_s: float) -> None:
    record = chunk_record([link_message(b"x", monotonic_s, START_NS, 0)])
    (item,) = read_items(written(tmp_path, start_of_part({}) + record + end_of_part()))
    assert isinstance(item, Chunk)
    assert item.monotonic_s.hex() == monotonic_s.hex()


def test_the_mcap_package_reads_the_same(made: MadePart, tmp_path: Path) -> None:
    path = written(tmp_path, made.data)
    with path.open("rb") as file:
        messages = [
            (channel.topic, message)
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        ]
    with path.open("rb") as file:
        (metadata,) = [record for record in StreamReader(file).records if isinstance(record, Metadata)]
    assert [topic for topic, _ in messages] == ["link" if isinstance(item, Chunk) else "events" for item in made.items]
    for (_, message), item in zip(messages, made.items, strict=True):
        assert message.log_time == item.utc_ns
        if isinstance(item, Chunk):
            assert message.data == struct.pack("<d", item.monotonic_s) + item.data
        else:
            assert json.loads(message.data) == item.event
    assert json.loads(metadata.metadata["json"]) == METADATA


def test_every_prefix_gives_its_complete_blocks(short: MadePart, tmp_path: Path) -> None:
    for size in range(1, len(short.data)):
        damage: list[Damage] = []
        assert read_items(written(tmp_path, short.data[:size]), damage) == short.items_before(size)
        assert len(damage) == 1
        assert damage[0].torn_end
        assert damage[0].offset + damage[0].length_bytes == size


def test_a_file_cut_behind_its_last_block_says_so(made: MadePart, tmp_path: Path) -> None:
    damage: list[Damage] = []
    read_items(written(tmp_path, made.data[: made.end_start]), damage)
    assert len(damage) == 1
    assert damage[0].torn_end


@pytest.mark.parametrize("mask", [0x01, 0x04, 0x80, 0xFF])
def test_one_damaged_byte_costs_its_block_and_is_named(short: MadePart, tmp_path: Path, mask: int) -> None:
    for position in range(short.head_size, short.end_start):
        data = bytearray(short.data)
        data[position] ^= mask
        damage: list[Damage] = []
        items = read_items(written(tmp_path, bytes(data)), damage)
        if items == short.items:
            # The times in the head of a chunk are not used; nothing was lost, so nothing is reported.
            assert damage == []
            continue
        assert items == short.items_without(position)
        (start,) = [start for start, end, _ in short.blocks if start <= position < end]
        assert [(entry.offset, entry.torn_end) for entry in damage] == [(start, False)]
        assert f"byte {start}" in damage[0].what


@pytest.mark.parametrize("mask", [0x01, 0xFF])
def test_damage_before_and_behind_the_blocks_costs_none_of_them(short: MadePart, tmp_path: Path, mask: int) -> None:
    for position in (*range(short.head_size), *range(short.end_start, len(short.data))):
        data = bytearray(short.data)
        data[position] ^= mask
        assert read_items(written(tmp_path, bytes(data))) == short.items


def test_a_hole_of_any_size_costs_what_it_covers(made: MadePart, tmp_path: Path) -> None:
    (start, _, _), (_, end, _) = made.blocks[1], made.blocks[2]
    data = made.data[:start] + bytes(end - start) + made.data[end:]
    damage: list[Damage] = []
    kept = [*made.blocks[0][2], *made.blocks[3][2]]
    assert read_items(written(tmp_path, data), damage) == kept
    assert [(entry.offset, entry.length_bytes) for entry in damage] == [(start, end - start)]
    data = made.data[: start + 5] + made.data[end:]
    assert read_items(written(tmp_path, data)) == kept


def test_a_chunk_is_found_across_a_long_stretch_of_noise(made: MadePart, tmp_path: Path) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (1 << 20) - 3, dtype=np.uint8).tobytes()
    start = made.blocks[2][0]
    damage: list[Damage] = []
    assert read_items(written(tmp_path, made.data[:start] + noise + made.data[start:]), damage) == made.items
    assert [entry.length_bytes for entry in damage] == [len(noise)]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not a recording at all, just some text of a user",
        b"\x00" * 200,
        b"\x89PNG\r\n\x1a\n" + bytes(100),
    ],
)
def test_foreign_files_are_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = written(tmp_path, content, "holiday.jpg")
    with refused(RecordingError, Reason.NOT_A_RECORDING, str(path)) as caught:
        read_items(path)
    assert caught.value.reason is Reason.NOT_A_RECORDING
    assert str(path) in caught.value.message


def test_mcap_of_another_program_is_refused(tmp_path: Path) -> None:
    data = start_of_part({}).replace(b"\x08\x00\x00\x00imufield", b"\x08\x00\x00\x00ros2prof")
    with refused(RecordingError, Reason.NOT_A_RECORDING, key="part_file.other_mcap"):
        read_items(written(tmp_path, data))


def test_what_is_missing_or_a_folder_is_an_error_of_its_own(tmp_path: Path) -> None:
    for path in (tmp_path / "part-009.mcap", tmp_path):
        with refused(RecordingError, Reason.NOT_A_RECORDING, str(path)) as caught:
            read_items(path)
        assert caught.value.reason is Reason.NOT_A_RECORDING


def test_newer_versions_are_refused(tmp_path: Path) -> None:
    for data in (
        start_of_part({}).replace(b"\x07\x00\x00\x00version\x01\x00\x00\x001", b"\x07\x00\x00\x00version\x01\x00\x00\x002"),
        b"\x89MCAP1\r\n" + bytes(100),
    ):
        with refused(RecordingError, Reason.NEWER, "version") as caught:
            read_items(written(tmp_path, data))
        assert caught.value.reason is Reason.NEWER


def sealed(content: bytes, *, size: int | None = None) -> bytes:
    """A chunk record with a right checksum around anything."""
    packed = zstandard.ZstdCompressor().compress(content)
    head = CHUNK.pack(0, 0, len(content) if size is None else size, zlib.crc32(content), 4, b"zstd", len(packed))
    return RECORD.pack(Opcode.CHUNK, len(head) + len(packed)) + head + packed


@pytest.mark.parametrize(
    "content",
    [
        b"garbage",
        bytes(100),
        link_message(b"", 0.0, START_NS, 0)[:-1],
        link_message(b"x", 0.0, START_NS, 0) + b"?",
        event_message({}, START_NS, 0)[:-1] + b"?",
        struct.pack("<BQHIQQ", 5, 22 + 2, 2, 0, 0, 0) + b"12",
        struct.pack("<BQHIQQ", 5, 22 + 4, 1, 0, 0, 0) + b"1234",
        struct.pack("<BQHIQQ", 5, 21, 1, 0, 0, 0),
        struct.pack("<BQHIQQ", 5, 1 << 62, 1, 0, 0, 0),
    ],
)
def test_a_sealed_chunk_of_nonsense_is_left_out_and_named(made: MadePart, tmp_path: Path, content: bytes) -> None:
    start = made.blocks[1][0]
    damage: list[Damage] = []
    data = made.data[:start] + sealed(content) + made.data[start:]
    assert read_items(written(tmp_path, data), damage) == made.items
    assert [entry.offset for entry in damage] == [start]


def test_damage_is_told_in_the_order_of_the_file(made: MadePart, tmp_path: Path) -> None:
    start, unusable, damage = made.blocks[1][0], sealed(b"garbage"), list[Damage]()
    broken = unusable[:-1] + bytes([unusable[-1] ^ 1])
    read_items(written(tmp_path, made.data[:start] + unusable + broken + made.data[start:]), damage)
    assert [entry.offset for entry in damage] == [start, start + len(unusable)]


def test_messages_of_other_channels_are_passed_over(made: MadePart, tmp_path: Path) -> None:
    start = made.blocks[1][0]
    damage: list[Damage] = []
    data = made.data[:start] + sealed(struct.pack("<BQHIQQ", 5, 22, 7, 0, 0, 0)) + made.data[start:]
    assert read_items(written(tmp_path, data), damage) == made.items
    assert damage == []


def test_a_packed_bomb_is_not_unpacked(made: MadePart, tmp_path: Path) -> None:
    start = made.blocks[1][0]
    bomb = sealed(bytes(CHUNK_LIMIT_BYTES + 1))
    lie = sealed(bytes(CHUNK_LIMIT_BYTES + 1), size=10)
    damage: list[Damage] = []
    data = made.data[:start] + bomb + lie + made.data[start:]
    assert read_items(written(tmp_path, data), damage) == made.items
    assert [entry.offset for entry in damage] == [start, start + len(bomb)]


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    pieces=st.lists(
        st.one_of(
            st.binary(max_size=60),
            st.builds(lambda opcode, body: RECORD.pack(opcode, len(body)) + body, st.integers(0, 255), st.binary(max_size=80)),
            st.builds(sealed, st.binary(max_size=80)),
            st.builds(lambda number: chunk_record([encode(item, 0) for item in block_items(number)]), st.integers(0, 9)),
            st.just(end_of_part()),
        ),
        max_size=6,
    ),
    head=st.sampled_from([start_of_part(METADATA), start_of_part({})[:40], b"\x89MCAP0\r\n", b""]),
)
def test_any_bytes_give_items_or_a_recording_error(tmp_path: Path, pieces: list[bytes], head: bytes) -> None:
    path = written(tmp_path, head + b"".join(pieces))
    try:
        items = read_items(path)
    except RecordingError:
        return
    assert all(isinstance(item, Chunk | RecordedEvent) for item in items)


def session_of(folder: Path, *parts: bytes) -> Session:
    session = Session.create(folder, "made")
    for number, data in enumerate(parts, start=1):
        written(session.folder, data, f"part-{number:03d}.mcap")
    return session


def test_a_session_is_read_part_by_part(made: MadePart, tmp_path: Path) -> None:
    session = session_of(tmp_path, made.data[: made.blocks[2][0] + 5], b"", made.data)
    damage: list[Damage] = []
    items = list(read_session(session, damage))
    starts = [item.path.name for item in items if isinstance(item, PartStart)]
    assert starts == ["part-001.mcap", "part-003.mcap"]
    assert [item for item in items if not isinstance(item, PartStart)] == [*made.items_before(made.blocks[1][1]), *made.items]
    assert [entry.path.name for entry in damage] == ["part-001.mcap", "part-002.mcap"]


@pytest.mark.parametrize(
    ("numbers", "gone"),
    [
        ((1, 2), None),
        ((1, 3), ("reader.part_gone", "part-002.mcap")),
        ((2,), ("reader.part_gone", "part-001.mcap")),
        ((1, 9), ("reader.parts_gone", "part-002.mcap to part-008.mcap")),
    ],
)
def test_parts_that_are_gone_are_named(tmp_path: Path, numbers: tuple[int, ...], gone: tuple[str, str] | None) -> None:
    # Not copies of each other: those count once.
    session = Session.create(tmp_path, "made")
    for number in numbers:
        written(session.folder, make_part(2 + number).data, f"part-{number:03d}.mcap")
    for read in (read_session, read_blocks):
        damage: list[Damage] = []
        list(read(session, damage))
        assert [getattr(entry.what, "key", None) for entry in damage] == ([] if gone is None else [gone[0]])
        assert gone is None or gone[1] in damage[0].what


def make_flow(times_s: list[float], size: int = 10, events_after: tuple[int, ...] = ()) -> bytes:
    records = []
    for i, time_s in enumerate(times_s):
        messages = [link_message(bytes([i % 256]) * size, time_s, START_NS + i, i)]
        if i in events_after:
            messages.append(event_message({"i": i}, START_NS + i, i))
        records.append(chunk_record(messages))
    return start_of_part(METADATA) + b"".join(records) + end_of_part()


def blocks_of(session: Session, **options: float) -> Iterator[RecordedBlock]:
    return (item for item in read_blocks(session, **options) if isinstance(item, RecordedBlock))  # type: ignore[arg-type]  # block_bytes is an int here


def test_blocks_join_chunks_and_keep_their_arrival_times(tmp_path: Path) -> None:
    times_s = [5.0 + i * 0.02 for i in range(120)]
    session = session_of(tmp_path, make_flow(times_s), make_flow(times_s[:5]))
    blocks = list(blocks_of(session))
    assert [len(block.monotonic_s) for block in blocks] == [51, 51, 18, 5]
    assert b"".join(block.data for block in blocks[:3]) == b"".join(bytes([i]) * 10 for i in range(120))
    assert np.concatenate([block.monotonic_s for block in blocks[:3]]).tolist() == times_s
    assert blocks[1].monotonic_s[-1] == times_s[101]
    assert blocks[1].utc_ns == START_NS + 101
    assert blocks[3].end.tolist() == [10, 20, 30, 40, 50]


def test_blocks_end_at_size_silence_and_events(tmp_path: Path) -> None:
    times_s = [0.0, 0.02, 0.04, 1.5, 1.52, 1.54, 1.56]
    session = session_of(tmp_path, make_flow(times_s, events_after=(4,)))
    items = [item for item in read_blocks(session) if not isinstance(item, PartStart)]
    assert [len(item.monotonic_s) if isinstance(item, RecordedBlock) else item.event for item in items] == [3, 2, {"i": 4}, 2]
    assert [len(block.data) for block in blocks_of(session, block_bytes=20)] == [20, 10, 20, 20]
    assert [len(block.data) for block in blocks_of(session, span_s=0.0)] == [10] * 7


def one_by_one(times_s: list[float], sizes: list[int], *, block_bytes: float, span_s: float) -> list[int]:
    """Return how many chunks each block has, by the rule as it is said."""
    counts, first_s, last_s, held = list[int](), 0.0, 0.0, 0
    for time_s, size in zip(times_s, sizes, strict=True):
        if not counts or held + size > block_bytes or time_s - first_s > span_s or abs(time_s - last_s) > 0.25:
            counts.append(0)
            first_s, held = time_s, 0
        counts[-1] += 1
        last_s, held = time_s, held + size
    return counts


@given(
    steps=st.lists(st.tuples(st.sampled_from((0.0, 0.02, 0.2, 0.25, 0.3, -0.1, -5.0, np.nan)), st.integers(0, 30)), min_size=1),
    cuts=st.sets(st.integers(0, 40)),
    limits=st.fixed_dictionaries({"block_bytes": st.integers(1, 100), "span_s": st.sampled_from((0.0, 0.3, 1.0))}),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
def test_blocks_are_the_same_however_chunks_were_packed(
    tmp_path: Path, steps: list[tuple[float, int]], cuts: set[int], limits: dict[str, float]
) -> None:
    times_s, sizes = np.nancumsum([step for step, _ in steps]), [size for _, size in steps]
    times_s[np.isnan([step for step, _ in steps])] = np.nan
    messages = [link_message(bytes(size), time_s, 0, 0) for time_s, size in zip(times_s.tolist(), sizes, strict=True)]
    edges = [0, *sorted(cut for cut in cuts if 0 < cut < len(messages)), len(messages)]
    packed = b"".join(chunk_record(messages[begin:end]) for begin, end in itertools.pairwise(edges))
    session = session_of(tmp_path, start_of_part(METADATA) + packed + end_of_part())
    blocks = list(blocks_of(session, **limits))
    assert [len(block.monotonic_s) for block in blocks] == one_by_one(times_s.tolist(), sizes, **limits)
    np.testing.assert_array_equal(np.concatenate([block.monotonic_s for block in blocks]), times_s)
    assert np.concatenate([np.diff(block.end, prepend=0) for block in blocks]).tolist() == sizes


def test_the_chunks_of_a_session_are_those_of_its_sound_parts(made: MadePart, tmp_path: Path) -> None:
    """An empty part, and the copy of one, are passed over as everywhere; a torn end is told."""
    session = session_of(tmp_path, made.data, b"", made.data, made.data[: made.end_start])
    chunks = [item for item in made.items if isinstance(item, Chunk)]
    damage: list[Damage] = []
    assert list(recorded_chunks(session, damage)) == chunks + chunks
    assert [entry.torn_end for entry in damage] == [True, False, True]


class CountingClock:
    """A clock that only passes while somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic_s(self) -> float:
        return self.now_s

    def utc_ns(self) -> int:
        return 0

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


def test_a_paced_recording_takes_its_time(tmp_path: Path) -> None:
    times_s = [5.0, 5.5, 7.0]
    clock = CountingClock()
    # Each run has a clock of its own.
    session = session_of(tmp_path, make_flow(times_s), make_flow([900.0, 901.0], size=11))
    passed_s = [(chunk.monotonic_s, clock.now_s - 1000.0) for chunk in recorded_chunks(session, pace=2.0, clock=clock)]
    assert passed_s == [(5.0, 0.0), (5.5, 0.25), (7.0, 1.0), (900.0, 1.0), (901.0, 1.5)]
    with refused(UsageError, Reason.USAGE) as caught:
        list(recorded_chunks(session_of(tmp_path, b""), pace=0.0))
    assert caught.value.values["pace"] == 0


def test_an_imported_dump_has_no_pace(tmp_path: Path) -> None:
    session = Session.create(tmp_path, "dump", {"kind": "import"})
    with Recorder(session.add_part(), {}, clock=CountingClock()) as recorder:
        for _ in range(3):
            recorder.write_chunk(Chunk(b"bytes", float("nan"), 0))
    clock = CountingClock()
    assert [chunk.data for chunk in recorded_chunks(session, pace=1.0, clock=clock)] == 3 * [b"bytes"]
    assert clock.now_s == 1000.0
