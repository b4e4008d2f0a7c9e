"""The index of a folder of parameter files: each is read once, whatever becomes of the index."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from imufield.deliver.history import Entry, read_history
from imufield.deliver.history_index import index_file


def test_files_are_read_once_and_again_after_a_change(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    path = write("a", "2026-03-04")
    write("b", "2026-03-05", session="b" * 64)
    (tmp_path / "a" / "session.toml").write_text('format = "imufield-session"\n')
    assert [read_history(tmp_path).read for _ in range(2)] == [3, 0]
    path.unlink()
    write("b", "2026-04-05", session="b" * 64)
    history = read_history(tmp_path)
    assert history.read >= 1
    assert [entry.created[:10] for entry in history.instruments[0].entries] == ["2026-04-05"]


def test_damaged_files_are_named_and_left_out(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    path = write("a", "2026-03-04")
    text = write("b", "2026-03-05").read_text()
    path.write_text(text[: len(text) // 2])
    history = read_history(tmp_path)
    assert len(history.instruments[0].entries) == 1
    assert len(history.faults) == 1
    assert "a/parameters.toml" in history.faults[0]


@pytest.mark.parametrize("content", [b"\xff no index at all", b"SQLite format 3\0" + b"\xff" * 4096, b"[" * 100_000])
def test_a_spoilt_index_does_no_harm(tmp_path: Path, write, content: bytes) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04")
    read_history(tmp_path)
    index_file(tmp_path).write_bytes(content)
    assert [read_history(tmp_path).read for _ in range(2)] == [1, 0]


def test_a_link_is_no_index(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04")
    read_history(tmp_path)
    place, elsewhere = index_file(tmp_path), tmp_path / "elsewhere.sqlite"
    content = place.read_bytes()
    place.rename(elsewhere)
    place.symlink_to(elsewhere)
    # Read again each time, and nothing is written behind it.
    assert [read_history(tmp_path).read for _ in range(2)] == [1, 1]
    assert elsewhere.read_bytes() == content


def test_where_no_index_can_be_written_files_are_read_again(tmp_path: Path, write, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    place = tmp_path / "a file where a folder should be"
    place.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(place))
    write("a", "2026-03-04")
    assert [read_history(tmp_path).read for _ in range(2)] == [1, 1]


def test_names_of_any_bytes_are_read_once(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04").rename(tmp_path / os.fsdecode(b"\xff.toml"))
    assert [read_history(tmp_path).read for _ in range(2)] == [1, 0]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("created", "yesterday"),
        ("numbers", 1),
        ("numbers", [{"name": "bias x"}]),
        ("gravity_m_s2", "g"),
        ("error", [1.0]),
        ("scatter", ["?"]),
        ("more", 1),
    ],
)
def test_an_index_of_another_program_is_made_anew(  # type: ignore[no-untyped-def]
    tmp_path: Path, write, key: str, value: object
) -> None:
    write("a", "2026-03-04")
    before = read_history(tmp_path)
    with closing(sqlite3.connect(index_file(tmp_path))) as index, index:
        ((text,),) = index.execute("SELECT text FROM entry").fetchall()
        index.execute("UPDATE entry SET text = ?", (json.dumps(json.loads(text) | {key: value}),))
    again = read_history(tmp_path)
    assert again.read == 1
    assert again.instruments == before.instruments
    assert read_history(tmp_path).read == 0


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE file SET name = 'zzz'",
        "UPDATE file SET name = '[1]'",
        "UPDATE file SET fault = 'zzz'",
        "UPDATE file SET name = CAST(x'ff' AS TEXT)",
        "UPDATE entry SET text = CAST(x'ff' AS TEXT)",
        "ALTER TABLE file DROP COLUMN state",
        "DROP TABLE entry",
    ],
)
def test_a_damaged_index_is_made_anew(tmp_path: Path, write, damage: str) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04")
    before = read_history(tmp_path)
    with closing(sqlite3.connect(index_file(tmp_path))) as index, index:
        index.execute(damage)
    again = read_history(tmp_path)
    assert (again.read, again.instruments) == (1, before.instruments)
    assert read_history(tmp_path).read == 0


def test_a_question_writes_nothing(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04")
    read_history(tmp_path)
    with closing(sqlite3.connect(index_file(tmp_path))) as other:
        # Another program writes meanwhile.
        other.execute("BEGIN IMMEDIATE")
        assert read_history(tmp_path).read == 0


def test_a_file_of_a_far_day_is_read_once(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    path = write("a", "2026-03-04")
    far_ns = 10_413_792_000 * 10**9  # The year 2300: more than SQLite holds in a whole number.
    os.utime(path, ns=(far_ns, far_ns))
    assert [read_history(tmp_path).read for _ in range(2)] == [1, 0]


def test_a_fault_names_its_file_from_any_folder(tmp_path: Path, write, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04")
    broken = tmp_path / "a" / "broken.toml"
    broken.write_text('format = "imufield-parameters"\nversion = 1\n')
    monkeypatch.chdir(tmp_path)
    for folder in (Path("a"), tmp_path / "a"):
        (fault,) = read_history(folder).faults
        assert str(broken) in fault


def test_several_processes_find_what_one_finds(tmp_path: Path, write, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    for number in range(5):
        write(f"{number}", f"2026-03-0{number + 1}", session=f"{number}" * 64)
    (tmp_path / "cut.toml").write_text('format = "imufield-parameters"\nversion = 1\n')
    alone = read_history(tmp_path)
    index_file(tmp_path).unlink()
    monkeypatch.setattr("imufield.deliver.history._FILES_A_WORKER", 2)
    # Two files at a time are written to the index.
    monkeypatch.setattr("imufield.deliver.history._AT_ONCE", 4)
    together = read_history(tmp_path, workers=2)
    assert together == alone
    assert together.read == 6


def test_rows_of_other_instruments_stay_unread_and_whole(tmp_path: Path, write, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    write("a", "2026-03-04")
    write("b", "2026-03-05", serial_number="N2", session="b" * 64)
    before = read_history(tmp_path)
    write("c", "2026-03-06", session="c" * 64)
    made: list[object] = []
    from_text = Entry.from_text

    def noted(text: str) -> Entry:
        made.append(json.loads(text)["serial_number"])
        return from_text(text)

    monkeypatch.setattr(Entry, "from_text", noted)
    (instrument,) = read_history(tmp_path, "N1").instruments
    assert made == ["N1", "N1"]
    assert len(instrument.entries) == 2
    monkeypatch.undo()
    # The index was written meanwhile, with the row that was not looked at.
    again = read_history(tmp_path)
    assert again.read == 0
    assert again.instruments[1:] == before.instruments[1:]
