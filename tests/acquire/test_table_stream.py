"""A table read piece by piece is the table read whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire import table_text, tables
from imufield.acquire.tables import read_tables, stream_table
from imufield.errors import RecordingError
from tests.acquire.table_files import ACCELEROMETER, GYROSCOPE, TIME, text_of, write


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
    with pytest.raises(RecordingError, match=f"steps back in time .* in line {line}"):
        list(stream_table(path))
