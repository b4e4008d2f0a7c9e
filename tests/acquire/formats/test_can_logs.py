"""Logs that python-can wrote come in as they were; recordings go out to a bus."""

from __future__ import annotations

import contextlib
import gzip
import os
import random
import re
import struct
import sys
import time
import zlib
from pathlib import Path
from typing import Any

import can
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.formats import foreign_file_reader
from imufield.acquire.formats.can_log_heads import begins_as_can_log, is_can_log
from imufield.acquire.formats.can_logs import import_log, read_log, replay_to_bus
from imufield.acquire.link.can import pack_message
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.can_frame import ERROR, EXTENDED, Frame, pack_frame
from imufield.acquire.protocol.can_frames import unpack_frames
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.reader import read_part
from imufield.acquire.recording.recorder import Recorder
from imufield.acquire.recording.session import Session
from imufield.errors import ImufieldError, Reason, RecordingError, UsageError
from imufield.samples import concatenate
from imufield.sentences import Sentence
from tests.refused import refused
from tests.told import told

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


def test_relative_times_of_an_asc_file_add_up(tmp_path: Path) -> None:
    path, lines, before_s = tmp_path / "absolute.asc", [], 0.0
    with can.Logger(path) as logger:
        for message in make_messages():
            logger(message)
    # Also lines that are no frames stand at a time of their own, which those behind them count from.
    for line in path.read_text().splitlines(keepends=True):
        stamp, _, rest = line.lstrip().partition(" ")
        if not re.fullmatch(r"\d+\.\d+", stamp):
            lines.append(line.replace("timestamps absolute", "timestamps relative"))
            continue
        half_s = (float(stamp) - before_s) / 2
        lines += [f"   {half_s:.6f} Start of something\n", f"   {half_s:.6f} {rest}"]
        before_s = float(stamp)
    relative = tmp_path / "relative.asc"
    relative.write_text("".join(lines))
    one, other = (
        [frame.time_s for chunk in read_log(each) for frame in unpack_frames(chunk.data)] for each in (path, relative)
    )
    assert len(one) == 400
    assert one[-1] - one[0] > 0.5
    assert other == pytest.approx(one, abs=1e-3)


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
    for stamp in ("1700000000005000000.0", "1" + "0" * 300 + ".0", "-1" + "0" * 300 + ".0"):
        path.write_text(f"(1700000000.005) can0 100#00\n({stamp}) can0 100#01\n")
        with Recorder(session.add_part(), {}) as recorder:
            assert import_log(path, recorder) == 2
    path.write_text("(1700000000.005) can0 100#00\n(nan) can0 100#01\n(1700000000.015) can0 100#02\n")
    losses: list[str] = []
    assert sum(1 for chunk in read_log(path, losses=losses) for _ in unpack_frames(chunk.data)) == 1
    (lost,) = losses
    assert isinstance(lost, Sentence)
    assert (lost.key, lost.values["frames"]) == ("can_logs.damaged", 1)
    assert "nan" in lost


BAD = {
    "65 bytes in a frame.log": "(1.0) can0 100#01\n(1.1) can0 100##1" + "00" * 65 + "\n",
    "a remote frame of 5000 digits.log": "(1.0) can0 100#01\n(1.1) can0 100#R" + "9" * 5000 + "\n",
    "an infinite start.trc": ";$FILEVERSION=1.1\n;$STARTTIME=1e400\n;\n     1)      1059.9  Rx         0300  1  00 \n",
    "a start beyond all dates.trc": ";$FILEVERSION=1.1\n;$STARTTIME=1e300\n;\n     1)      1059.9  Rx         0300  1  00 \n",
    "a start of nan.trc": ";$FILEVERSION=1.1\n;$STARTTIME=nan\n;\n     1)      1059.9  Rx         0300  1  00 \n",
}


@pytest.mark.parametrize("name", BAD)
def test_what_no_bus_sends_is_damage(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / name
    path.write_text(BAD[name])
    with pytest.raises(ImufieldError) as caught:
        list(read_log(path))
    assert name in caught.value.message
    assert capfd.readouterr().err == ""


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
    for number in range(8):
        damaged = bytearray(content if number % 4 else content[: rng.randrange(len(content))])
        for _ in range(5 if damaged else 0):
            damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        bad.write_bytes(damaged)
        with contextlib.suppress(RecordingError):
            assert sum(1 for chunk in read_log(bad) for _ in unpack_frames(chunk.data)) <= len(make_messages())
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no named pipes in folders")
@pytest.mark.parametrize("name", ["x.log", "x.csv", "x.asc", "x.log.gz"])
def test_a_pipe_by_the_name_of_a_log_hangs_nothing(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    assert not begins_as_can_log(tmp_path / name)


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
    with refused(RecordingError, Reason.DAMAGED, str(path), "MiB", key="can_logs.from_the_first"):
        list(read_log(path))


def test_mf4_without_its_package_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "drive.mf4"
    path.write_bytes(b"MDF     4.10")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with refused(UsageError, Reason.MISSING_PACKAGE, "asammdf", "pip install '.[mf4]'"):
        list(read_log(path))


@pytest.mark.parametrize("fault", ["ImportError('no such library')", "ValueError('numpy.dtype size changed')"])
def test_mf4_whose_package_cannot_be_imported_is_not_called_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    path, package = tmp_path / "drive.mf4", tmp_path / "packages" / "asammdf"
    path.write_bytes(b"MDF     4.10")
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(f"raise {fault}\n")
    monkeypatch.syspath_prepend(package.parent)
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    cause = fault.split("'")[1]
    with refused(UsageError, Reason.MISSING_PACKAGE, "asammdf", cause, key="errors.broken_package"):
        list(read_log(path))


def two_buses(path: Path) -> None:
    """Log 3 frames of bus 0 and 2000 of bus 1."""
    with can.Logger(path) as logger:
        for number, message in enumerate(make_messages(2003)):
            message.channel = int(number >= 3)
            logger(message)


def test_a_damage_is_told_by_the_frames_of_all_buses(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    two_buses(path)
    with path.open("a") as file:
        file.write("(nan) can0 100#00\n")
    losses: list[str] = []
    names = {line.split()[1] for line in path.read_text().splitlines()}
    for name in names:
        list(read_log(path, channel=name, losses=losses))
    assert [(getattr(lost, "key", None), lost.values["frames"]) for lost in losses if isinstance(lost, Sentence)] == [
        ("can_logs.damaged", 2003)
    ] * len(names)
    with refused(RecordingError, Reason.NOT_A_RECORDING, "2003", "vcan7", key="can_logs.no_frame_of_channel"):
        list(read_log(path, channel="vcan7"))


def test_a_log_cut_before_its_first_frame_is_not_called_empty(tmp_path: Path) -> None:
    path = tmp_path / "cut.blf"
    two_buses(path)
    content = path.read_bytes()
    path.write_bytes(content[:200])
    with refused(RecordingError, Reason.DAMAGED, str(path), key="can_logs.cut") as caught:
        list(read_log(path))
    assert (caught.value.values["frames"], caught.value.values["most"]) == (0, 2003)


def test_a_reader_that_ends_before_the_first_frame_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "whole.blf"
    two_buses(path)
    dies = tmp_path / "dies.py"
    dies.write_text("raise SystemExit(3)\n")
    monkeypatch.setattr(foreign_file_reader, "__file__", str(dies))
    with refused(RecordingError, Reason.DAMAGED, str(path), "(3)", key="can_logs.from_the_first"):
        list(read_log(path))


def test_every_frame_comes_as_python_can_reads_it(tmp_path: Path) -> None:
    kinds: list[dict[str, Any]] = [
        {"arbitration_id": 0x123, "is_extended_id": False, "data": b""},
        {"arbitration_id": 0x1ABCDEF0, "data": bytes(range(8)), "is_rx": False},
        {"arbitration_id": 0x123, "is_extended_id": False, "is_remote_frame": True, "dlc": 8},
        {
            "arbitration_id": 0x456,
            "is_fd": True,
            "bitrate_switch": True,
            "error_state_indicator": True,
            "data": bytes(range(64)),
        },
        {"arbitration_id": 0x40, "is_error_frame": True, "data": bytes(range(8))},
    ]
    for reader, name in ((can.BLFReader, "bench.blf"), (can.ASCReader, "bench.asc"), (can.CSVReader, "bench.csv")):
        path = tmp_path / name
        with can.Logger(path) as logger:
            # The clock steps back once, as in logs that were joined.
            for number, kind in enumerate(kinds * 4):
                logger(can.Message(timestamp=START_S + number * 1e-3 + 1 / 3 - 60 * (number > 12), channel=0, **kind))
        options: dict[str, Any] = {"relative_timestamp": False} if reader is can.ASCReader else {}
        plain = b"".join(pack_message(message, message.timestamp) for message in reader(path, **options))
        assert b"".join(chunk.data for chunk in read_log(path)) == plain, name


def blf(*objects: bytes) -> bytes:
    """Return a BLF file with one container that is not packed."""
    body = struct.pack("<H6xL4x", 0, 0) + b"".join(objects)
    head = struct.pack("<4sL8BQQLL16H", b"LOGG", 144, *[0] * 8, 0, 0, len(objects), 0, *[0] * 16).ljust(144, b"\0")
    return head + struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(body), 10) + body


def blf_frame(number: int, *, size: int = 48, kind: int = 1) -> bytes:
    """Return a frame as an object of a BLF file; its size says where the next one stands."""
    head = struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, size, kind, 2, 0, 0, number * 5_000_000)
    return head + struct.pack("<HBBL8s", 1, 0, 8, 256, bytes(8))


@pytest.mark.parametrize("kind", [1, 99], ids=["frame", "other"])
def test_a_blf_that_leads_back_to_itself(tmp_path: Path, kind: int) -> None:
    path = tmp_path / "circle.blf"
    path.write_bytes(blf(blf_frame(0, size=0, kind=kind)))
    with refused(RecordingError, Reason.DAMAGED, str(path), key="can_logs.from_the_first"):
        list(read_log(path))
    path.write_bytes(blf(*map(blf_frame, range(3)), blf_frame(3, size=0, kind=kind), blf_frame(4)))
    losses: list[str] = []
    assert sum(1 for chunk in read_log(path, losses=losses) for _ in unpack_frames(chunk.data)) == 3
    assert [getattr(lost, "key", None) for lost in losses] == ["can_logs.damaged"]


@pytest.mark.parametrize("suffix", ["log", "asc"])
def test_a_small_log_that_unpacks_to_gigabytes(tmp_path: Path, suffix: str) -> None:
    path, text = tmp_path / f"drive.{suffix}", tmp_path / f"drive.{suffix}.gz"
    with can.Logger(path) as logger:
        for message in make_messages(2):
            logger(message)
    lines = path.read_bytes().splitlines(keepends=True)
    with gzip.open(text, "wb") as packed:
        packed.write(b"".join(lines[:-2]))
        for _ in range(30):
            packed.write(lines[-2] * 20_000)
    losses: list[str] = []
    assert 0 < sum(len(chunk.data) // 24 for chunk in read_log(text, losses=losses)) < 500_000
    assert [getattr(lost, "key", None) for lost in losses] == ["can_logs.damaged"]
    assert "MiB" in losses[0]


@pytest.mark.parametrize("suffix", ["log", "asc", "trc", "csv"])
def test_a_line_without_end(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"drive.{suffix}.gz"
    with gzip.open(path, "wb", compresslevel=1) as packed:
        for _ in range(100):
            packed.write(b"1" * 1_000_000)
    with refused(RecordingError, Reason.DAMAGED, str(path), "65536", key="can_logs.from_the_first"):
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


@pytest.mark.parametrize("number", ["20000080", "20000004", "20000040", "3FFFFFFF"])
def test_error_frames_of_candump_are_those_of_their_bus(tmp_path: Path, number: str) -> None:
    path = tmp_path / "faults.log"
    path.write_text(f"(1.0) can0 123#00\n(1.1) can0 {number}#0004000000000001\n(1.2) can0 0CF02A80#02 T\n(1.3) can1 123#03\n")
    frames = [frame for chunk in read_log(path, channel="can0") for frame in unpack_frames(chunk.data)]
    error = int(number, 16) | EXTENDED
    assert [frame.can_id for frame in frames] == [0x123, error, 0x0CF02A80 | EXTENDED]
    assert [frame.data.hex() for frame in frames] == ["00", "0004000000000001", "02"]
    with refused(UsageError, Reason.USAGE, key="can_logs.several_buses") as caught:
        list(read_log(path))
    assert caught.value.values["channels"] == ("can0", "can1")


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
        assert replay_to_bus(session, f"virtual:{channel}", pace=2.0) == 30
        assert time.monotonic() - begin_s > 0.13, "0.29 s at twice the pace"
        heard = [bus.recv(0.1) for _ in range(30)]
        assert [bytes(message.data) for message in heard if message] == [frame.data for frame in frames]
        assert replay_to_bus(session, f"virtual:{channel}", pace=None) == 30
    with pytest.raises(UsageError):
        replay_to_bus(session, f"virtual:{channel}", pace=0.0)


def test_lines_of_a_candump_that_are_no_frames_are_left_out_and_told(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with can.Logger(path) as logger:
        for message in make_messages(50):
            logger(message)
    lines = path.read_text().splitlines()
    # Where the power was cut, and what somebody wrote between.
    path.write_text("\n".join([*lines[:20], lines[20][:25], *lines[21:30], "restarted", "", *lines[30:], lines[0][:30]]))
    losses: list[str] = []
    assert sum(len(list(unpack_frames(chunk.data))) for chunk in read_log(path, losses=losses)) == 49
    (lost,) = told(losses, "can_logs.bad_lines")
    assert (lost.values["lines"], lost.values["first"]) == (3, 21)
    assert len(losses) == 1
