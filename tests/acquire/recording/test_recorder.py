import errno
import functools
import itertools
import os
import random
import shutil
import struct
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording import recorder as recorder_module
from imufield.acquire.recording.reader import Damage, PartStart, RecordedEvent, read_part
from imufield.acquire.recording.recorder import MESSAGE_LIMIT_BYTES, Recorder, packed
from imufield.errors import Reason, RecordingError
from imufield.samples import Status
from tests.interrupts import ends, interrupted_at
from tests.refused import refused

START_NS = 1_700_000_000_000_000_000


def numbered(number: int, size: int = 100) -> Chunk:
    return Chunk(struct.pack("<Q", number).ljust(size, b"."), number * 0.02, START_NS + number)


def numbers_in(path: Path, damage: list[Damage] | None = None) -> list[int]:
    return [struct.unpack_from("<Q", item.data)[0] for item in read_part(path, damage) if isinstance(item, Chunk)]


def test_chunks_and_events_come_back_in_order(tmp_path: Path) -> None:
    path = tmp_path / "part-001.mcap"
    metadata = {"driver": "stim300", "raw_zero": np.array([1.0, 2.0, 3.0]), "folder": tmp_path, "flag": Status.START_UP}
    with Recorder(path, metadata) as recorder:
        recorder.write_chunk(numbered(1))
        recorder.write_event({"event": "accepted", "residual": np.float64(0.5)})
        recorder.write_chunk(numbered(2))
    damage: list[Damage] = []
    first, one, event, two = read_part(path, damage)
    assert isinstance(first, PartStart)
    assert first.metadata == {"driver": "stim300", "raw_zero": [1.0, 2.0, 3.0], "folder": str(tmp_path), "flag": 16}
    assert [one, two] == [numbered(1), numbered(2)]
    assert isinstance(event, RecordedEvent)
    assert event.event == {"event": "accepted", "residual": 0.5}
    assert damage == []


def test_what_was_packed_beforehand_is_read_as_what_was_written(tmp_path: Path) -> None:
    chunks = [numbered(number, 300_000) for number in range(20)]
    with Recorder(tmp_path / "packed.mcap", {}, first=packed(chunks)) as recorder:
        recorder.write_chunk(numbered(20))
    damage: list[Damage] = []
    assert [item for item in read_part(tmp_path / "packed.mcap", damage) if isinstance(item, Chunk)] == [*chunks, numbered(20)]
    assert damage == []


def test_events_are_stamped_by_the_host_clock(tmp_path: Path) -> None:
    before_ns = time.time_ns()
    with Recorder(tmp_path / "part-001.mcap", {}) as recorder:
        recorder.write_event({"event": "done"})
    (event,) = [item for item in read_part(recorder.path) if isinstance(item, RecordedEvent)]
    assert before_ns <= event.utc_ns <= time.time_ns()


def test_what_was_written_is_on_disk_without_closing(tmp_path: Path) -> None:
    path = tmp_path / "part-001.mcap"
    recorder = Recorder(path, {})
    recorder.write_chunk(numbered(7))
    deadline_s = time.monotonic() + 60.0
    while numbers_in(path) != [7] and time.monotonic() < deadline_s:
        time.sleep(0.05)
    damage: list[Damage] = []
    assert numbers_in(path, damage) == [7]
    assert [entry.torn_end for entry in damage] == [True]
    recorder.close()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "part-001.mcap"
    path.write_bytes(b"an hour of somebody's work")
    with refused(RecordingError, Reason.FOREIGN, "part-001.mcap") as caught:
        Recorder(path, {})
    assert caught.value.values["errno"] == errno.EEXIST
    assert path.read_bytes() == b"an hour of somebody's work"


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with refused(RecordingError, Reason.FOREIGN, "missing") as caught:
        Recorder(tmp_path / "missing" / "part-001.mcap", {})
    assert caught.value.values["errno"] == errno.ENOENT


def test_closing_twice_is_allowed_and_writing_afterwards_is_not(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "part-001.mcap", {})
    recorder.close()
    recorder.close()
    with pytest.raises(ValueError, match="closed"):
        recorder.write_chunk(numbered(1))


def test_a_message_too_long_to_be_read_again_is_refused(tmp_path: Path) -> None:
    with Recorder(tmp_path / "part-001.mcap", {}) as recorder, pytest.raises(ValueError, match=r"\d+ bytes"):
        recorder.write_chunk(Chunk(bytes(MESSAGE_LIMIT_BYTES), 0.0, 0))


def test_several_threads_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "part-001.mcap"
    with Recorder(path, {}) as recorder:

        def write(offset: int) -> None:
            for number in range(offset, offset + 500):
                recorder.write_chunk(numbered(number, 2000))

        threads = [threading.Thread(target=write, args=(offset,)) for offset in (0, 500, 1000, 1500)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    numbers = numbers_in(path)
    assert sorted(numbers) == list(range(2000))
    for offset in (0, 500, 1000, 1500):
        own = [number for number in numbers if offset <= number < offset + 500]
        assert own == sorted(own)


def test_a_slow_disk_makes_the_caller_wait_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "BACKLOG_LIMIT_BYTES", 20_000)
    monkeypatch.setattr(recorder_module, "BLOCK_BYTES", 10_000)
    path = tmp_path / "part-001.mcap"
    with Recorder(path, {}) as recorder:
        for number in range(300):
            recorder.write_chunk(numbered(number, 1000))
            assert recorder._waiting_bytes <= 20_000 + 1100
    assert numbers_in(path) == list(range(300))


def write_until_error(recorder: Recorder, size: int) -> RecordingError:
    deadline_s, number = time.monotonic() + 60.0, 0
    while time.monotonic() < deadline_s:
        try:
            recorder.write_chunk(numbered(number, size))
        except RecordingError as error:
            return error
        number += 1
        time.sleep(0.01)
    raise AssertionError("the recorder never noticed")


@pytest.mark.skipif(os.name != "posix", reason="Windows refuses to delete a file that is open")
def test_a_deleted_folder_is_noticed(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    recorder = Recorder(folder / "part-001.mcap", {})
    shutil.rmtree(folder)
    error = write_until_error(recorder, 100)
    assert error.reason is Reason.FOREIGN
    assert error.values["errno"] == errno.ENOENT
    with refused(RecordingError, Reason.FOREIGN, "part-001.mcap") as caught:
        recorder.write_event({})
    assert caught.value.values["errno"] == errno.ENOENT
    recorder.close()


def test_an_error_nobody_was_told_of_is_raised_on_closing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path / "part-001.mcap", {})

    def fail(_: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    recorder.write_chunk(numbered(1))
    with refused(RecordingError, Reason.DAMAGED, "Input/output error") as caught:
        recorder.close()
    assert caught.value.values["errno"] == errno.EIO
    recorder.close()


def test_a_full_disk_at_the_start_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with refused(RecordingError, Reason.DISK_FULL, "part-001.mcap") as caught:
        Recorder(tmp_path / "part-001.mcap", {})
    assert caught.value.values["errno"] == errno.ENOSPC
    assert caught.value.reason is Reason.DISK_FULL
    assert list(tmp_path.iterdir()) == []


FILL = textwrap.dedent("""
    import random, resource, sys
    from imufield.acquire.link.serial import Chunk
    from imufield.acquire.recording.recorder import Recorder
    from imufield.errors import Reason, RecordingError
    import struct

    noise = random.Random(1)
    limit = int(sys.argv[2])
    recorder = Recorder(sys.argv[1], {})
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    number = 0
    try:
        while True:
            recorder.write_chunk(Chunk(struct.pack("<Q", number) + noise.randbytes(4096), float(number), number))
            number += 1
    except RecordingError as error:
        assert error.reason is Reason.DISK_FULL, error
        print(error)
    recorder.close()
""")


@pytest.mark.skipif(os.name != "posix", reason="Windows has no RLIMIT_FSIZE to stand for a full disk")
@pytest.mark.parametrize("limit", [5_000, 3_000_000])
def test_a_full_disk_is_an_error_and_what_was_written_stays(tmp_path: Path, limit: int) -> None:
    # A limit on the file size ends a write in its middle, as a full disk does.
    path = tmp_path / "part-001.mcap"
    run = subprocess.run(
        [sys.executable, "-c", FILL, str(path), str(limit)], capture_output=True, text=True, timeout=900, check=True
    )
    assert "free some space" in run.stdout
    assert path.stat().st_size == limit
    damage: list[Damage] = []
    numbers = numbers_in(path, damage)
    assert numbers == list(range(len(numbers)))
    # Blocks are 1 MiB and the message that fills them: at most one of them is torn. A message takes less than 4200 bytes.
    assert len(numbers) * 4200 > limit - (1 << 20) - 16384
    assert [entry.torn_end for entry in damage] == [True]


RECORD = textwrap.dedent("""
    import collections, struct, sys, time
    from imufield.acquire.link.serial import Chunk
    from imufield.acquire.recording.recorder import Recorder

    recorder = Recorder(sys.argv[1], {"driver": "stim300"})
    print("started", flush=True)
    handed = collections.deque()
    number = 0
    while True:
        recorder.write_chunk(Chunk(struct.pack("<Q", number) + bytes(400), number * 0.005, number))
        handed.append((time.monotonic(), number))
        while handed[0][0] < time.monotonic() - 1.0:
            print(handed.popleft()[1], flush=True)
        number += 1
        time.sleep(0.005)
""")


def record_and_kill(path: Path, after_s: float) -> int:
    """Kill a recording child ``after_s`` seconds after its start; return the last number it called safe, -1 if none."""
    with subprocess.Popen([sys.executable, "-c", RECORD, str(path)], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "started\n"
        time.sleep(after_s)
        child.kill()
        lines = child.stdout.read().split("\n")
    complete = lines[:-1]
    return int(complete[-1]) if complete else -1


def test_twenty_killed_recorders_lose_at_most_the_last_second(tmp_path: Path) -> None:
    moments = random.Random(20)
    waits_s = [moments.uniform(0.0, 3.0) for _ in range(20)]
    safe: dict[int, int] = {}

    def run(first: int) -> None:
        # A few at a time, so that a small machine does not starve the children.
        for i in range(first, 20, 10):
            safe[i] = record_and_kill(tmp_path / f"part-{i:03d}.mcap", waits_s[i])

    threads = [threading.Thread(target=run, args=(first,)) for first in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in range(20):
        numbers = numbers_in(tmp_path / f"part-{i:03d}.mcap")
        assert numbers == list(range(len(numbers)))
        assert len(numbers) > safe[i]
    assert max(safe.values()) > 100


def test_an_interrupt_leaves_the_recorder_whole(tmp_path: Path) -> None:
    for moment in itertools.count(1):
        path = tmp_path / f"part-{moment:03d}.mcap"
        recorder = Recorder(path, {})
        recorder.write_chunk(numbered(1))
        was_interrupted = interrupted_at(moment, functools.partial(recorder.write_chunk, numbered(2)))
        assert ends(recorder.close)
        damage: list[Damage] = []
        assert numbers_in(path, damage) in ([1], [1, 2])
        assert damage == []
        if not was_interrupted:
            break
    assert moment > 1
