"""Times of a table that go back: one that is wrong, or a clock that was set or began anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats import table_text, tables
from imufield.acquire.formats.tables import read_tables, stream_table
from imufield.errors import Reason, RecordingError
from tests.acquire.table_files import ACCELEROMETER, TIME, text_of, write
from tests.refused import refused


def test_of_several_wrong_times_the_first_is_named(tmp_path: Path) -> None:
    time = TIME.copy()
    time[[8, 29]] = 7.01, 0.01
    path = write(tmp_path, text_of(time, ACCELEROMETER))
    with refused(RecordingError, Reason.BAD_DATA, "in line 9", key="table_file.wrong_time") as caught:
        read_tables([path])
    assert caught.value.values["value"] == 7.01


@pytest.mark.parametrize(("header", "key"), [("", "table_file.guessed_time_back"), ("time ax ay az\n", "table_file.time_back")])
def test_a_clock_that_began_anew_is_told_with_both_times(tmp_path: Path, header: str, key: str) -> None:
    path = write(tmp_path, text_of(np.where(TIME < 0.2, TIME, TIME - 0.1), ACCELEROMETER, header=header))
    with refused(RecordingError, Reason.BAD_DATA, "--columns", key=key) as caught:
        read_tables([path])
    assert {"before": 0.19, "after": 0.1, "line": 21 + len(header.splitlines())}.items() <= caught.value.values.items()


@pytest.mark.parametrize("back_s", [0.011, 0.015, 0.0199])
def test_a_clock_that_was_set_back_by_a_step_or_two_makes_no_time_wrong(tmp_path: Path, back_s: float) -> None:
    path = write(tmp_path, text_of(np.where(TIME < 0.2, TIME, TIME - back_s), ACCELEROMETER, header="time ax ay az\n"))
    with refused(RecordingError, Reason.BAD_DATA, "in line 22", key="table_file.time_back"):
        read_tables([path])


@pytest.mark.parametrize("row", [1, 8, 9, 10, 11, 30])
def test_a_counter_of_32_bits_that_began_anew_goes_on(tmp_path: Path, row: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 400)
    monkeypatch.setattr(tables, "_ROWS_TO_GUESS_BY", 10)
    time_us = (np.round(1e6 * (TIME - TIME[row])) + 2**32) % 2**32
    path = write(tmp_path, text_of(time_us, ACCELEROMETER, header="micros ax ay az\n"))
    pieces = [piece.rows for piece in stream_table(path)]
    assert len(pieces) > 2
    for rows in (read_tables([path]).rows, np.concatenate(pieces)):
        np.testing.assert_allclose(rows[:, 0] - rows[0, 0], TIME, atol=1e-9)


def test_a_late_row_at_the_end_of_the_range_is_no_second_turn(tmp_path: Path) -> None:
    time_us = (np.round(1e6 * (TIME - TIME[10])) + 2**32) % 2**32
    time_us[[9, 10]] = time_us[[10, 9]]
    with refused(RecordingError, Reason.BAD_DATA, key="table_file.time_back") as caught:
        read_tables([write(tmp_path, text_of(time_us, ACCELEROMETER, header="micros ax ay az\n"))])
    assert caught.value.values["before"] - caught.value.values["after"] == 10_000
