"""A table read piece by piece is the table read whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats import table_text, tables
from imufield.acquire.formats.tables import read_tables, stream_table
from imufield.errors import Reason, RecordingError, UsageError
from tests.acquire.table_files import ACCELEROMETER, GYROSCOPE, TIME, text_of, write
from tests.refused import refused


@pytest.mark.parametrize(
    ("header", "columns", "rate_hz"),
    [
        ("t ax ay az gx gy gz\n", (TIME, ACCELEROMETER, GYROSCOPE), None),
        ("time_ms ax_g ay_g az_g gx_deg_s gy_deg_s gz_deg_s\n", (1000 * TIME, ACCELEROMETER / 9.80665, GYROSCOPE), None),
        ("ax ay az\n", (ACCELEROMETER,), 100.0),
        ("", (TIME, np.round(1000 * ACCELEROMETER)), None),
    ],
)
def test_piece_by_piece_is_the_whole(
    tmp_path: Path, header: str, columns: tuple[np.ndarray, ...], rate_hz: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 400)
    monkeypatch.setattr(tables, "_ROWS_TO_GUESS_BY", 20)
    path = write(tmp_path, text_of(*columns, header=header))
    whole, pieces = read_tables([path], rate_hz=rate_hz), list(stream_table(path, rate_hz=rate_hz))
    assert len(pieces) > 2
    assert pieces[0].settings == whole.settings
    np.testing.assert_allclose(np.concatenate([piece.rows for piece in pieces]), whole.rows, rtol=1e-15)


@pytest.mark.parametrize("line", range(38, 50))
def test_piece_by_piece_names_the_line_too(tmp_path: Path, line: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 400)
    monkeypatch.setattr(tables, "_ROWS_TO_GUESS_BY", 20)
    lines = text_of(TIME, np.round(ACCELEROMETER, 3)).split("\n")
    lines[line - 1] = "0.01 1.0 2.0 9.8"
    path = write(tmp_path, "\n".join(lines))
    with refused(RecordingError, Reason.BAD_DATA) as caught:
        list(stream_table(path))
    assert caught.value.values["line"] == line


HEADER = "time_s,ax,ay,az,gx,gy,gz,temperature_degc,counter,status\n"


def lines_with_a_gap(start: int, end: int, n: int = 120) -> list[str]:
    """Return rows of our own export in counts and deg/s, those from ``start`` to ``end`` without values and saying so."""
    full = [f"{row / 100},{row % 7},{row % 5},16384,{row % 3},2.5,90.5,25.0,{row},0" for row in range(n)]
    gap = [f"{row / 100},,,,,,,25.0,{row},3" for row in range(start, end)]
    return [*full[:start], *gap, *full[end:]]


@pytest.mark.parametrize(("start", "end"), [(0, 1), (0, 70), (0, 110), (40, 100), (30, 120)])
def test_pieces_without_values_are_held_to_the_others(
    tmp_path: Path, start: int, end: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 400)
    monkeypatch.setattr(tables, "_ROWS_TO_GUESS_BY", 20)
    path = write(tmp_path, HEADER + "\n".join(lines_with_a_gap(start, end)) + "\n")
    whole, pieces = read_tables([path]), list(stream_table(path))
    assert len(pieces) > 2
    assert whole.settings["accelerometer_unit"] == "count"
    assert whole.settings["gyroscope_unit"] == "deg/s"
    assert pieces[0].settings == whole.settings
    np.testing.assert_array_equal(np.concatenate([piece.rows for piece in pieces]), whole.rows)


@pytest.mark.parametrize("start", [0, 40])
def test_a_piece_without_values_that_does_not_say_so(tmp_path: Path, start: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 400)
    monkeypatch.setattr(tables, "_ROWS_TO_GUESS_BY", 20)
    lines = [line.removesuffix(",3") + ",0" if line.endswith(",3") else line for line in lines_with_a_gap(start, 110)]
    path = write(tmp_path, HEADER + "\n".join(lines) + "\n")
    with refused(RecordingError, Reason.BAD_DATA, "nan", "ax") as caught:
        read_tables([path])
    assert caught.value.values["line"] == start + 2
    with refused(RecordingError, Reason.BAD_DATA, "nan", "ax") as caught:
        list(stream_table(path))
    assert caught.value.values["line"] == start + 2


def test_pieces_without_any_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 400)
    monkeypatch.setattr(tables, "_ROWS_TO_GUESS_BY", 20)
    path = write(tmp_path, HEADER + "\n".join(lines_with_a_gap(0, 120)) + "\n")
    with refused(UsageError, Reason.USAGE, "--columns"):
        list(stream_table(path))
