"""The page of reliability is made of the rows that tests left."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.torture import conftest
from tests.torture.conftest import CODE, PAGE, PROJECT, ROWS, Row, holds_still, page, present_commit, rows_file


def entry(times: int, part: str = "killed", place: int = 1, commit: str = "abc", what: str = "kills") -> dict[str, object]:
    row = {"what": what, "times": times, "unit": "kills", "came": "{positions} there", "numbers": {"positions": 2 * times}}
    return {"part": part, "place": [place], "commit": commit, "day": "2026-01-02", "seconds": 60.0, "rows": [row]}


def table(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("| ")]


def test_the_page_is_that_of_the_rows() -> None:
    kept = json.loads(ROWS.read_text(encoding="utf-8")) if ROWS.exists() else {}
    assert table(PAGE.read_text(encoding="utf-8")) == table(page(kept))


def test_numbers_of_one_commit_are_added_and_parts_stand_in_their_order() -> None:
    kept = {
        "a": entry(20),
        "b": entry(22, place=2),
        "c": entry(1, "claims", what="other"),
        "d": entry(3, commit="def", place=3),
    }
    assert table(page(kept))[1:] == [
        "| kills | 42 kills | 84 there | abc | 2026-01-02 |",
        "| kills | 3 kills | 6 there | def | 2026-01-02 |",
        "| other | 1 kills | 2 there | abc | 2026-01-02 |",
    ]
    assert "took\n4 min" in page(kept)


def test_large_numbers_are_readable() -> None:
    assert Row("w", 7_200_000, "frames", "all {good}", {"good": 3}).cells() == ("w", "7,200,000 frames", "all 3")


def test_tests_have_files_of_their_own() -> None:
    names = {rows_file(f"tests/torture/test_files.py::test_damaged_files[{name}]").name for name in ("session.toml", "table")}
    assert names == {"test-files-py-test-damaged-files-session-toml.json", "test-files-py-test-damaged-files-table.json"}


def test_rows_of_the_present_code_hold_and_others_do_not(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    commit = present_commit()
    assert holds_still(commit) == (bool(commit) and not commit.endswith("+"))
    assert not holds_still("")
    assert not holds_still("0" * 40)
    monkeypatch.setattr(conftest, "PROJECT", tmp_path)
    assert present_commit() == ""
    assert all((PROJECT / path).exists() for path in CODE)
