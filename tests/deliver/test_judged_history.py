"""Judgements of histories: on one process or several, and kept in the index until a calibration is another."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from imufield import campaign
from imufield.calibrate.sessions.changes import Judged, judge
from imufield.campaign import run_campaign
from imufield.deliver import judged_history
from imufield.deliver.history import History, read_history
from imufield.deliver.history_index import index_file
from imufield.deliver.judged_history import judge_histories


@pytest.fixture
def two_instruments(tmp_path: Path, write: Any) -> Path:
    """Return a folder with three calibrations of each of two instruments."""
    for number in range(6):
        write(f"{number}", f"2026-03-0{number + 1}", session=f"{number}" * 64, serial_number=f"N{number % 2}", moved=number)
    return tmp_path


@pytest.fixture
def judged_anew(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return of how many sessions each judgement was that was made, and not taken from the index."""
    made: list[int] = []

    def judge_and_count(sessions: Any) -> Judged:
        made.append(len(sessions))
        return judge(sessions)

    monkeypatch.setattr(judged_history, "judge", judge_and_count)
    return made


def judgements(history: History, workers: int = 1) -> list[Judged]:
    judged = judge_histories(history, workers)
    assert [one.instrument for one in judged] == list(history.instruments)
    return [one.judged for one in judged]


def test_several_processes_judge_as_one_does(two_instruments: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    history = read_history(two_instruments)
    alone = judgements(history)
    index_file(two_instruments).unlink()
    monkeypatch.setattr(judged_history, "_INSTRUMENTS_A_WORKER", 1)
    asked: list[int | None] = []

    def run_and_note(*arguments: Any, workers: int | None = None, **more: Any) -> list[Any]:
        asked.append(workers)
        return run_campaign(*arguments, workers=workers, **more)

    monkeypatch.setattr(campaign, "run_campaign", run_and_note)
    assert judgements(history, 2) == alone
    assert asked == [2]


def test_the_same_calibrations_are_judged_once(two_instruments: Path, judged_anew: list[int]) -> None:
    first = judgements(read_history(two_instruments))
    assert judged_anew == [3, 3]
    assert judgements(read_history(two_instruments)) == first
    assert judgements(read_history(two_instruments, "N1")) == first[1:]
    assert judged_anew == [3, 3]


def test_an_instrument_with_another_calibration_is_judged_anew(
    two_instruments: Path, write: Any, judged_anew: list[int]
) -> None:
    first = judgements(read_history(two_instruments))
    write("6", "2026-03-07", session="6" * 64, serial_number="N0", moved=9.0)
    second = judgements(read_history(two_instruments))
    assert judged_anew == [3, 3, 4]
    assert second[0] != first[0]
    assert second[1] == first[1]
    # A file that is written anew, with the same name.
    write("6", "2026-03-07", session="6" * 64, serial_number="N0", moved=-9.0)
    assert judgements(read_history(two_instruments))[0] != second[0]
    assert judged_anew == [3, 3, 4, 4]


DAMAGE = (
    "UPDATE judgement SET text = replace(text, '1', '2')",
    "UPDATE judgement SET digest = 'x'",
    "UPDATE judgement SET text = ''",
    "UPDATE judgement SET digest = 7, text = x'00ff'",
    "UPDATE judgement SET text = (SELECT text FROM entry)",
)


@pytest.mark.parametrize("damage", DAMAGE)
def test_what_is_damaged_is_judged_anew(two_instruments: Path, damage: str, judged_anew: list[int]) -> None:
    first = judgements(read_history(two_instruments))
    with closing(sqlite3.connect(index_file(two_instruments))) as connection, connection:
        assert connection.execute(damage).rowcount == len(first)
    assert judgements(read_history(two_instruments)) == first
    assert judged_anew == [3, 3, 3, 3]
