"""``imufield sessions``: what is listed of each session, from what stands beside the recordings."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.errors import Reason
from imufield.files import DEFAULT_ROOT
from imufield.sentences import printable
from tests.commands.told import fails, missing, says


@pytest.fixture
def folder(solved_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of five sessions: solved, not solved, unfinished, one damaged and one with damaged parameters."""
    monkeypatch.chdir(tmp_path)
    root = tmp_path / DEFAULT_ROOT
    for day, name in enumerate(("solved", "raw", "stopped", "broken", "cut"), 1):
        session = root / f"2026030{day}T101500Z-{name}"
        shutil.copytree(solved_session, session, ignore=shutil.ignore_patterns("*.mcap"))
        more = {"created": f"2026-03-0{day}T10:15:00Z", "instrument": {"driver": "stim300", "serial_number": f"N{day}"}}
        Session.open(session).update(more | {"finished": name != "stopped", "accepted": 7 if name == "stopped" else 24})
        if name in ("raw", "stopped"):
            (session / "parameters.toml").unlink()
    (root / "20260304T101500Z-broken" / "session.toml").write_text("format = ")
    parameters = root / "20260305T101500Z-cut" / "parameters.toml"
    parameters.write_text(parameters.read_text().partition("[covariance]")[0])
    # Anything else that lies there.
    (root / "notes").mkdir()
    (root / "notes.txt").write_text("mine")
    return root


def listed(capsys: pytest.CaptureFixture[str], *arguments: object) -> list[dict[str, Any]]:
    assert run(["sessions", "--json", *map(str, arguments)]) == 0
    found: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["sessions"]
    return found


def test_the_newest_first_and_the_damaged_last(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = listed(capsys)
    assert [Path(row["folder"]).name.partition("-")[2] for row in rows] == ["cut", "stopped", "raw", "solved", "broken"]
    cut, stopped, raw, solved, broken = rows
    assert (solved["state"], solved["verdict"], solved["positions"], solved["planned"]) == ("finished", "good", 24, 24)
    assert (solved["serial_number"], solved["kind"], solved["created"]) == ("N1", "capture", "2026-03-01T10:15:00Z")
    assert [(row["state"], row["verdict"], row["fault"]) for row in (raw, stopped)] == [
        ("finished", None, None),
        ("unfinished", None, None),
    ]
    assert [row["positions"] for row in (raw, stopped)] == [24, 7]
    assert broken["state"] == "damaged"
    assert "20260304T101500Z-broken/session.toml" in broken["fault"]
    # What is not whole has no verdict.
    assert cut["verdict"] is None
    assert "parameters.toml" in cut["fault"]


def test_a_session_that_has_grown_since_it_was_solved_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = Session.open(folder / "20260301T101500Z-solved")
    session.update(accepted=20)
    (row,) = [row for row in listed(capsys) if row["folder"].endswith("solved")]
    assert (row["positions"], row["used"]) == (20, 24)
    with session.lock():
        assert run(["sessions", "--find", "solved GOOD"]) == 0
    assert not missing(capsys.readouterr().out, "recording, GOOD (24 used)", "20 of 24 positions")


@pytest.mark.skipif(os.name == "nt", reason="needs links")
def test_where_a_link_leads_is_said(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    solved = folder / "20260301T101500Z-solved"
    outside = solved.rename(tmp_path / "outside")
    (folder / "led-out").symlink_to(outside)
    (folder / "led-in").symlink_to("20260302T101500Z-raw")
    rows = {Path(row["folder"]).name: row["leads_to"] for row in listed(capsys)}
    assert {name: where for name, where in rows.items() if where is not None} == {"led-out": str(outside)}
    assert "led-in" in rows


def test_a_person_sees_the_same(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sessions"]) == 0
    shown = capsys.readouterr().out
    first = next(line for line in shown.splitlines() if line.startswith("2026-03-01"))
    assert not missing(first, "2026-03-01 10:15", "GOOD", "24 of 24 positions", "N1")
    assert len(first) <= 80
    assert f"\n  {DEFAULT_ROOT}/20260301T101500Z-solved\n" in shown
    assert not missing(shown, "unfinished, not solved", "finished, not solved", "damaged", "broken/session.toml")


def test_a_long_name_does_not_leave_80_columns(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    long = "84167-4400003-321 K N25581846020020"
    Session.open(folder / "20260301T101500Z-solved").update({"instrument": {"driver": "stim300", "serial_number": long}})
    assert run(["sessions", "--find", "solved GOOD"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].endswith("24 of 24 positions")
    assert lines[1].endswith(long)


@pytest.mark.skipif(os.name == "nt", reason="no such names there")
def test_names_from_outside_keep_to_their_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hostile = "x\nforged\x1b[2J"
    (folder / "20260302T101500Z-raw").rename(folder / hostile)
    Session.open(folder / hostile).update({"model": hostile, "instrument": {"driver": hostile, "serial_number": hostile}})
    assert run(["sessions"]) == 0
    shown = capsys.readouterr().out
    assert shown.count(printable(hostile)) >= 2
    assert not [line for line in shown.splitlines() if line.startswith("forged")]
    assert "\x1b" not in shown


def test_wide_characters_take_two_columns(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = "慣性計測装置慣性計測"  # 10 characters in 20 columns; 18 are left.
    Session.open(folder / "20260301T101500Z-solved").update({"model": "", "instrument": {"serial_number": name}})
    assert run(["sessions", "--find", "solved GOOD"]) == 0
    first, second, _ = capsys.readouterr().out.splitlines()
    assert (first.split()[-1], second) == ("positions", f"  {name}")


@pytest.mark.parametrize(
    ("words", "names"), [("unfinished", "stopped"), ("n1 GOOD", "solved"), ("2026-03-02", "raw"), ("broken", "broken")]
)
def test_sessions_are_found_by_what_they_show(folder: Path, words: str, names: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert [Path(row["folder"]).name.partition("-")[2] for row in listed(capsys, "--find", words)] == names.split()
    assert run(["sessions", "--find", f"{words} elsewhere"]) == 0
    told = capsys.readouterr()
    assert told.out == ""
    assert says(told.err, "commands", "sessions.none_such", sessions=5, folder=DEFAULT_ROOT, find=f"{words} elsewhere")


def test_a_session_that_is_named_is_listed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    every = listed(capsys)
    assert [listed(capsys, row["folder"]) for row in every] == [[row] for row in every]


def test_a_session_under_way_is_being_recorded(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Session.open(folder / "20260303T101500Z-stopped").lock():
        assert [row["state"] for row in listed(capsys, "--find", "stopped")] == ["recording"]


def test_folders_of_the_user(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "20260301T101500Z-solved").rename(tmp_path / "my session")
    assert [Path(row["folder"]).name for row in listed(capsys, tmp_path)] == ["my session"]
    fails(["sessions", "nowhere"], 2, Reason.USAGE, "nowhere", key="sessions.no_folder")


def test_where_nothing_was_captured_yet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert listed(capsys) == []
    assert run(["sessions"]) == 0
    assert says(capsys.readouterr().err, "commands", "sessions.none", folder=DEFAULT_ROOT)


def test_recordings_are_not_opened(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = folder / "20260301T101500Z-solved" / "part-001.mcap"
    os.mkfifo(part)
    # A reader of this pipe would wait for ever.
    assert len(listed(capsys)) == 5
