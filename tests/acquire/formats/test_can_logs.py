"""Logs that python-can wrote come in as they were; recordings go out to a bus."""

from __future__ import annotations

import contextlib
import gzip
import random
import struct
import sys
import time
import zlib
from pathlib import Path

import can
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.formats.can_logs import begins_as_can_log, import_log, is_can_log, read_log, replay_to_bus
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.can_frames import ERROR, Frame, pack_frame, unpack_frames
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.reader import RecordingLink, read_part
from imufield.acquire.recording.recorder import Recorder
from imufield.acquire.recording.session import Session
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import concatenate
from imufield.sentences import Sentence
from tests.refused import refused

START_S = 1_700_000_000.0


def make_messages(count: int = 400) -> list[can.Message]:
    rng = random.Random(1)
    return [
        can.Message(
            timestamp=START_S + number * 0.005,
            arbitration_id=0x0CF02A80 if number % 2 else 0x08F02D80,
            data=rng.randbytes(8),
            channel=0,
        )
        for number in range(count)
    ]


@pytest.mark.parametrize("suffix", ["log", "asc", "blf", "trc", "mf4", "csv"])
def test_every_format(tmp_path: Path, suffix: str) -> None:
    if suffix == "mf4":
        pytest.importorskip("asammdf")
    path = tmp_path / f"bench.{suffix}"
    sent = make_messages()
    with can.Logger(path) as logger:
        for message in sent:
            logger(message)
    # Most tables are no logs, whatever their name.
    assert is_can_log(path) == (suffix != "csv")
    assert begins_as_can_log(path)
    chunks = list(read_log(path))
    frames = [frame for chunk in chunks for frame in unpack_frames(chunk.data)]
    assert [frame.data for frame in frames] == [bytes(message.data) for message in sent]
    assert [frame.can_id & 0x1FFFFFFF for frame in frames] == [message.arbitration_id for message in sent]
    assert [frame.time_s - frames[0].time_s for frame in frames] == pytest.approx(
        [message.timestamp - START_S for message in sent], abs=2e-3 if suffix == "trc" else 2e-6
    )
    assert all(len(chunk.data) <= 12 * 24 for chunk in chunks), "50 ms a chunk"
    assert chunks[-1].monotonic_s == frames[-1].time_s


def test_import_makes_a_session_that_decodes(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with can.Logger(path) as logger:
        for message in make_messages():
            logger(message)
    session = Session.create(tmp_path / "sessions", "drive")
    with Recorder(session.add_part(), {}) as recorder:
        assert import_log(path, recorder) == 400
    decoder = Decoder(load_protocol("j1939_imu"))
    chunks = [item for item in read_part(session.parts[0]) if isinstance(item, Chunk)]
    blocks = [decoder.feed(chunk.data, chunk.monotonic_s) for chunk in chunks]
    samples = concatenate([*blocks, decoder.flush()])
    assert len(samples) == 200
    assert decoder.statistics.losses_estimated == 0


def test_a_damaged_time_stamp_costs_no_frame_or_is_said(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    session = Session.create(tmp_path / "sessions", "drive")
    path.write_text("(1700000000.005) can0 100#00\n(1700000000005000000.0) can0 100#01\n")
    with Recorder(session.add_part(), {}) as recorder:
        assert import_log(path, recorder) == 2
    path.write_text("(1700000000.005) can0 100#00\n(nan) can0 100#01\n(1700000000.015) can0 100#02\n")
    losses: list[str] = []
    assert sum(1 for chunk in read_log(path, losses=losses) for _ in unpack_frames(chunk.data)) == 1
    (lost,) = losses
    assert isinstance(lost, Sentence)
    assert (lost.key, lost.values["frames"]) == ("can_logs.damaged", 1)
    assert "nan" in lost


def test_a_cut_blf_says_what_is_missing(tmp_path: Path) -> None:
    whole = tmp_path / "whole.blf"
    with can.Logger(whole) as logger:
        for message in make_messages(20_000):
            logger(message)
    content = whole.read_bytes()
    for size in (len(content) // 3, len(content) // 2, len(content) - 40):
        path = tmp_path / "cut.blf"
        path.write_bytes(content[:size])
        losses: list[str] = []
        count = sum(1 for chunk in read_log(path, losses=losses) for _ in unpack_frames(chunk.data))
        assert 0 < count < 20_000
        with refused(RecordingError, Reason.DAMAGED, str(path), key="can_logs.cut") as caught:
            list(read_log(path))
        named = {"path": str(path), "size": size, "whole": len(content), "frames": count, "most": 20_000}
        assert caught.value.values == named
        assert losses == [caught.value.message]
    losses = []
    assert sum(1 for chunk in read_log(whole, losses=losses) for _ in unpack_frames(chunk.data)) == 20_000
    assert losses == []


def test_a_logger_that_never_ended_and_a_torn_gzip(tmp_path: Path) -> None:
    path = tmp_path / "open.blf"
    logger = can.BLFWriter(path)
    for message in make_messages(5000):
        logger(message)
    logger.file.flush()
    content = path.read_bytes()
    logger.stop()
    path.write_bytes(content)
    losses: list[str] = []
    assert 0 < sum(1 for chunk in read_log(path, losses=losses) for _ in unpack_frames(chunk.data)) < 5000
    assert [getattr(lost, "key", None) for lost in losses] == ["can_logs.never_closed"]
    text = tmp_path / "drive.log"
    with can.Logger(text) as log:
        for message in make_messages(20_000):
            log(message)
    packed = gzip.compress(text.read_bytes())
    (tmp_path / "drive.log.gz").write_bytes(packed[: len(packed) // 2])
    losses = []
    assert sum(1 for chunk in read_log(tmp_path / "drive.log.gz", losses=losses) for _ in unpack_frames(chunk.data)) > 1000
    assert [getattr(lost, "key", None) for lost in losses] == ["can_logs.damaged"]


def test_logs_are_told_from_others_of_the_same_suffix(tmp_path: Path) -> None:
    for suffix in ("log", "asc", "blf", "trc"):
        path = tmp_path / f"bench.{suffix}"
        with can.Logger(path) as logger:
            for message in make_messages(3):
                logger(message)
        assert begins_as_can_log(path), suffix
        path.write_text("0.0 1 2 3\n0.1 1 2 3\n")
        assert not begins_as_can_log(path)
    assert not begins_as_can_log(tmp_path / "nowhere.log")


def test_damaged_mf4_is_an_error_or_a_loss(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("asammdf")
    path, bad = tmp_path / "whole.mf4", tmp_path / "bad.mf4"
    with can.Logger(path) as logger:
        for message in make_messages():
            logger(message)
    content, rng = path.read_bytes(), random.Random(3)
    for number in range(16):
        damaged = bytearray(content if number % 4 else content[: rng.randrange(len(content))])
        for _ in range(5 if damaged else 0):
            damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        bad.write_bytes(damaged)
        with contextlib.suppress(RecordingError):
            assert sum(1 for chunk in read_log(bad) for _ in unpack_frames(chunk.data)) <= len(make_messages())
    assert capfd.readouterr().err == ""


def zeros_packed(mebibytes: int) -> bytes:
    """Return so many zeros, deflated: the pieces between two full flushes are alike."""
    packer = zlib.compressobj(9)
    first = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    again = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    end = packer.flush()[:-4]
    return first + again * (mebibytes - 1) + end + struct.pack(">HH", (mebibytes << 20) % 65521, 1)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux enforces RLIMIT_AS, by which a reader is limited")
def test_mf4_that_asks_for_too_much_memory_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("asammdf")
    assert len(zlib.decompress(zeros_packed(3))) == 3 << 20
    path = tmp_path / "trap.mf4"
    with can.Logger(path) as logger:
        for message in make_messages():
            logger(message)
    content, size = bytearray(path.read_bytes()), 4096 << 20
    data_at, group_at = content.index(b"##DZ"), content.index(b"##CG")
    row_bytes = struct.unpack_from("<I", content, data_at + 28)[0]
    # The group refers to its data by their place in the file.
    (link_at,) = (at for at in range(0, len(content) - 8, 8) if struct.unpack_from("<Q", content, at)[0] == data_at)
    packed = zeros_packed(size >> 20)
    struct.pack_into("<Q", content, link_at, len(content))
    struct.pack_into("<Q", content, group_at + 24 + 6 * 8 + 8, size // row_bytes)
    content += b"##DZ" + bytes(4) + struct.pack("<QQ2sBBIQQ", 48 + len(packed), 0, b"DT", 0, 0, 0, size, len(packed)) + packed
    path.write_bytes(content)
    with refused(RecordingError, Reason.DAMAGED, str(path), "MiB", key="can_logs.memory"):
        list(read_log(path))


def test_mf4_without_its_package_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "drive.mf4"
    path.write_bytes(b"MDF     4.10")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with refused(UsageError, Reason.MISSING_PACKAGE, "asammdf", "pip install 'imufield[mf4]'"):
        list(read_log(path))


def test_two_buses_must_be_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    path.write_text("(1.0) can0 123#00\n(1.1) can1 123#01\n(1.2) can0 123#02\n")
    with refused(UsageError, Reason.USAGE, "can0", "can1", key="can_logs.several_buses") as caught:
        list(read_log(path))
    assert caught.value.values["channels"] == ("can0", "can1")
    (chunk, *_) = read_log(path, channel="can1")
    assert [frame.data for frame in unpack_frames(chunk.data)] == [b"\x01"]
    with refused(RecordingError, Reason.NOT_A_RECORDING, "can7"):
        list(read_log(path, channel="can7"))


@pytest.mark.parametrize("suffix", ["log", "asc", "blf", "trc"])
@pytest.mark.parametrize("content", [b"", b"garbage\n\x00\xff\xfe" * 20])
def test_what_is_no_log(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        list(read_log(path))
    assert str(path) in str(caught.value)
    with refused(RecordingError, Reason.NOT_A_RECORDING, "nowhere"):
        list(read_log(tmp_path / f"nowhere.{suffix}"))


def test_other_names_are_no_logs() -> None:
    assert not is_can_log("table.csv")
    assert is_can_log("bench.asc.gz")


def test_replay_to_a_bus(tmp_path: Path) -> None:
    session = Session.create(tmp_path, "replay")
    frames = [Frame(0x100, bytes([number]), 5.0 + number * 0.01) for number in range(30)]
    with Recorder(session.add_part(), {}) as recorder:
        for begin in range(0, 30, 10):
            data = b"".join(pack_frame(frame.can_id, frame.data, frame.time_s) for frame in frames[begin : begin + 10])
            recorder.write_chunk(Chunk(data + pack_frame(ERROR | 8, bytes(8), 5.0), 5.1 + begin * 0.01, 0))
    channel = f"replay-{id(session)}"
    with can.Bus(channel, "virtual") as bus:
        begin_s = time.monotonic()
        assert replay_to_bus(RecordingLink(session), f"virtual:{channel}", pace=2.0) == 30
        assert time.monotonic() - begin_s > 0.13, "0.29 s at twice the pace"
        heard = [bus.recv(0.1) for _ in range(30)]
        assert [bytes(message.data) for message in heard if message] == [frame.data for frame in frames]
        assert replay_to_bus(RecordingLink(session), f"virtual:{channel}", pace=None) == 30
    with pytest.raises(UsageError):
        replay_to_bus(RecordingLink(session), f"virtual:{channel}", pace=0.0)
