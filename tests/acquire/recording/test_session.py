import errno
import os
import subprocess
import sys
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.recording.recorder import Recorder
from imufield.acquire.recording.session import Session
from imufield.errors import Reason, RecordingError
from tests.refused import refused

NOON = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)


def test_a_new_session_is_a_folder_of_its_time_and_model(tmp_path: Path) -> None:
    session = Session.create(tmp_path / "imufield-sessions", "STIM300 rev. B/2", {"kind": "capture"}, now=NOON)
    assert session.folder == tmp_path / "imufield-sessions" / "20260301T120000Z-STIM300-rev.-B-2"
    content = tomllib.loads((session.folder / "session.toml").read_text())
    assert content == session.metadata
    assert content["created"] == "2026-03-01T12:00:00Z"
    assert content["model"] == "STIM300 rev. B/2"
    assert content["finished"] is False
    assert session.parts == []
    assert session.name == session.folder.name


def test_values_are_written_as_plain_ones(tmp_path: Path) -> None:
    table = {
        "raw_zero": np.array([1.0, 2.5, 0.0]),
        "rate_hz": np.float64(2000.0),
        "bits": np.int64(7),
        "serial": None,
        "file": Path("a/b"),
    }
    session = Session.create(tmp_path, "imu", {"nominal": {**table, "serial": None}})
    expected = {"raw_zero": [1.0, 2.5, 0.0], "rate_hz": 2000.0, "bits": 7, "file": "a/b"}
    assert Session.open(session.folder).metadata["nominal"] == expected


def test_sessions_of_one_second_stay_apart_and_in_order(tmp_path: Path) -> None:
    folders = [Session.create(tmp_path, model, now=NOON).folder for model in ("zeta", "alpha", "zeta")]
    assert [folder.name for folder in folders] == [
        "20260301T120000Z-zeta",
        "20260301T120001Z-alpha",
        "20260301T120002Z-zeta",
    ]
    assert Session.newest(tmp_path).folder == folders[-1]


def test_the_newest_is_taken_by_its_name_and_other_folders_are_passed_over(tmp_path: Path) -> None:
    old = Session.create(tmp_path, "imu", now=NOON)
    new = Session.create(tmp_path, "imu", now=NOON.replace(day=2))
    (tmp_path / "zzz").mkdir()
    (tmp_path / "20270101T000000Z-unborn").mkdir()
    os.utime(old.folder)
    assert Session.newest(tmp_path).folder == new.folder


def test_without_a_session_the_newest_is_an_error_that_says_how_to_make_one(tmp_path: Path) -> None:
    for root in (tmp_path, tmp_path / "imufield-sessions"):
        with refused(RecordingError, Reason.NOT_A_RECORDING, str(root), key="session.none"):
            Session.newest(root)


def test_a_folder_of_the_user_s_choice(tmp_path: Path) -> None:
    session = Session.create_in(tmp_path / "deep" / "mine", "imu")
    assert Session.open(session.folder / "session.toml").folder == session.folder
    with refused(RecordingError, Reason.UNFINISHED, "mine", key="session.exists") as caught:
        Session.create_in(session.folder, "imu")
    assert caught.value.reason is Reason.UNFINISHED
    (tmp_path / "holiday").mkdir()
    (tmp_path / "holiday" / "beach.jpg").write_bytes(b"x")
    with refused(RecordingError, Reason.FOREIGN, "holiday", key="session.not_empty") as caught:
        Session.create_in(tmp_path / "holiday", "imu")
    assert caught.value.reason is Reason.FOREIGN


def test_parts_are_numbered_on_and_sorted_by_number(tmp_path: Path) -> None:
    session = Session.create(tmp_path, "imu")
    names = []
    for _ in range(3):
        path = session.add_part()
        Recorder(path, {}).close()
        names.append(path.name)
    assert names == ["part-001.mcap", "part-002.mcap", "part-003.mcap"]
    (session.folder / "part-1000.mcap").touch()
    (session.folder / "part-002.mcap.bak").touch()
    session.parts[1].unlink()
    assert [path.name for path in session.parts] == ["part-001.mcap", "part-003.mcap", "part-1000.mcap"]
    assert session.add_part().name == "part-1001.mcap"


def test_updates_are_on_disk_and_bad_ones_change_nothing(tmp_path: Path) -> None:
    session = Session.create(tmp_path, "imu")
    session.update({"site": {"gravity_m_s2": 9.81}}, finished=True)
    assert session.finished
    again = Session.open(session.folder)
    assert again.finished
    assert again.metadata == session.metadata
    before = (session.folder / "session.toml").read_bytes()
    with refused(RecordingError, Reason.UNKNOWN_KEY, "colour", key="session_record.unknown_key") as caught:
        session.update(colour="red")
    assert caught.value.values["key"] == "colour"
    assert caught.value.reason is Reason.UNKNOWN_KEY
    with refused(RecordingError, Reason.DAMAGED, "finished"):
        session.update(finished="yes")
    assert (session.folder / "session.toml").read_bytes() == before
    assert "colour" not in session.metadata


@pytest.mark.parametrize(
    ("content", "reason", "key", "facts"),
    [
        (b"format = ", Reason.DAMAGED, "toml_and_json.no_toml", ()),
        (b"\xff\xfe", Reason.DAMAGED, "toml_and_json.no_text", ("line 1", "UTF-8")),
        (
            b'format = "something"\nversion = 1\n',
            Reason.FOREIGN,
            "session_record.format",
            ("something", "imufield-session"),
        ),
        (b'format = "imufield-session"\nversion = 2\n', Reason.NEWER, "session_record.newer", ("2",)),
        (b'format = "imufield-session"\n', Reason.NEWER, "session_record.newer", ("version",)),
        (
            b'format = "imufield-session"\nversion = 1\ncolour = 1\n',
            Reason.UNKNOWN_KEY,
            "session_record.unknown_key",
            ("colour",),
        ),
        (b'format = "imufield-session"\nversion = 1\nsite = 1\n', Reason.DAMAGED, "session_record.type", ("site",)),
    ],
)
def test_a_session_file_that_cannot_be_used_says_why(
    tmp_path: Path, content: bytes, reason: Reason, key: str, facts: tuple[str, ...]
) -> None:
    (tmp_path / "session.toml").write_bytes(content)
    with refused(RecordingError, reason, *facts, key=key) as caught:
        Session.open(tmp_path)
    assert caught.value.reason is reason
    assert str(tmp_path) in caught.value.message


def test_what_is_no_session_says_so(tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    file.touch()
    for path in (tmp_path, tmp_path / "missing", file):
        with refused(RecordingError, Reason.NOT_A_RECORDING, str(path), key="session.no_session") as caught:
            Session.open(path)
        assert caught.value.reason is Reason.NOT_A_RECORDING


def test_a_session_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    file.touch()
    for make in (Session.create, Session.create_in):
        with refused(RecordingError, Reason.FOREIGN, str(file), os.strerror(errno.ENOTDIR)):
            make(file / "below", "imu")


def test_two_locks_exclude_each_other(tmp_path: Path) -> None:
    session = Session.create(tmp_path, "imu")
    other = Session.open(session.folder)
    with session.lock():
        with refused(RecordingError, Reason.LOCKED, str(os.getpid()), key="session.locked_by") as caught, other.lock():
            pass
        assert caught.value.reason is Reason.LOCKED
    with other.lock():
        pass


def test_a_killed_program_leaves_no_lock(tmp_path: Path) -> None:
    session = Session.create(tmp_path, "imu")
    code = (
        "import sys, time\nfrom imufield.acquire.recording.session import Session\n"
        "with Session.open(sys.argv[1]).lock():\n    print('locked', flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(session.folder)], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "locked\n"
        with refused(RecordingError, Reason.LOCKED) as caught, session.lock():
            pass
        # Windows keeps others from reading the locked bytes, and with them the number.
        assert caught.value.values["process"] == (str(child.pid) if hasattr(os, "pread") else "")
        child.kill()
    with session.lock():
        pass
