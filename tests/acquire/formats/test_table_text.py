"""What stands above, beside and behind the numbers of a text: titles, dates, other encodings, a cut line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats.table_text import open_table
from imufield.acquire.formats.tables import read_tables
from imufield.errors import Reason, RecordingError
from tests.acquire.table_files import ACCELEROMETER, TIME, text_of
from tests.refused import refused
from tests.told import keys

UNREAD = [
    ("1.009,81", ";", "table_text.thousands"),
    ("-1.009.810", ";", "table_text.thousands"),
    ("1 009,81", ";", "table_text.thousands"),
    ("1'009", ";", "table_text.thousands"),
    ('"1,009.81"', ",", "table_text.thousands"),
    ('"1,009,810"', ",", "table_text.thousands"),
    # May be a decimal comma.
    ('"1,009"', ",", "table_text.no_number"),
    ('"a, b"', ",", "table_text.no_number"),
    ("Prüf,ung", ";", "table_text.no_number"),
    ('"a b"', " ", "table_text.no_number"),
]
"""Cells, what parts them from others, and the sentence that quotes them."""
ROWS = np.array([[float(f"{value:.4f}") for value in row] for row in np.column_stack([TIME, ACCELEROMETER])])
UNITS = "time_s,ax_m_s2,ay_m_s2,az_m_s2"


def written(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(text.encode(encoding))
    return path


def lines_of(delimiter: str = ",", end: str = "") -> list[str]:
    return [delimiter.join(f"{value:.4f}" for value in row) + end for row in ROWS]


@pytest.mark.parametrize(
    ("above", "delimiter", "end"),
    [
        pytest.param(["sep=,", UNITS], ",", "", id="sep=, of Excel"),
        pytest.param(['"sep=\t"', "t\tax\tay\taz\t", "s\tm/s^2\tm/s^2\tm/s^2\t"], "\t", "\t", id="sep, names and units"),
        pytest.param(["GYROFLOW IMU LOG", "version,1.3", "tscale,0.001", UNITS], ",", "", id="titles with numbers"),
        pytest.param(
            ["Board X1 (chip)", "", "t [s] \t A_X [m/s^2] \t A_Y [m/s^2] \t A_Z [m/s^2] "], "\t", "", id="blanks and tabs"
        ),
        pytest.param(["Log of 2024-03-01", *["note"] * 9, UNITS], ",", "", id="many titles"),
        pytest.param(["My log,,,", UNITS], ",", "", id="a title in a row of cells"),
        pytest.param(["Log of one small board", UNITS], ",", "", id="a title of as many words"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_titles_stand_above_the_names(tmp_path: Path, above: list[str], delimiter: str, end: str, encoding: str) -> None:
    path = written(tmp_path / "table.csv", "\n".join([*above, *lines_of(delimiter, end), ""]), encoding)
    table = read_tables([path])
    assert np.array_equal(table.rows[:, :4], ROWS)
    assert table.settings["accelerometer_unit"] == "m/s^2"
    # The line of a fault is that of the file.
    line = len(above) + 3
    rows = path.read_bytes().decode(encoding).split("\n")
    rows[line - 1] = delimiter.join(["0.02", "x", "0", "9.8"]) + end
    with refused(RecordingError, Reason.BAD_DATA, key="table_text.no_number") as caught:
        read_tables([written(path, "\n".join(rows), encoding)])
    assert caught.value.values["line"] == line


def test_a_mark_of_utf_8_in_front_of_rows_alone_is_no_part_of_them(tmp_path: Path) -> None:
    path = written(tmp_path / "table.csv", "\n".join([*lines_of(), ""]), "utf-8-sig")
    assert np.array_equal(read_tables([path]).rows[:, :4], ROWS)


@pytest.mark.parametrize("comment", ["", " # one value lost", " # lost, one"])
def test_a_row_that_lost_a_cell_is_no_shifted_one(tmp_path: Path, comment: str) -> None:
    lines = [f"{line},7" for line in lines_of()]
    lines[3] = lines[3].replace(lines[3].split(",")[1] + ",", "", 1) + comment
    path = written(tmp_path / "table.csv", "\n".join(["time_s,ax,ay,az,mag_x", *lines, ""]))
    with refused(RecordingError, Reason.BAD_DATA, key="table_text.other_width") as caught:
        read_tables([path])
    assert (caught.value.values["line"], caught.value.values["found"]) == (5, 4)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_comments_stand_beside_columns_of_text(tmp_path: Path, delimiter: str) -> None:
    lines = [f"a{delimiter}{line}{delimiter}walking" for line in lines_of(delimiter)]
    lines[20] += f" # moved{delimiter}then still"
    lines.insert(9, "# moved")
    path = written(tmp_path / "table.csv", "\n".join([delimiter.join(["label", *UNITS.split(","), "note"]), *lines, ""]))
    assert np.array_equal(read_tables([path]).rows[:, :4], ROWS)


def test_a_mark_of_comments_within_a_cell_is_part_of_it(tmp_path: Path) -> None:
    lines = [f"{line},{'#1' if row == 9 else 'walk'},7" for row, line in enumerate(lines_of())]
    path = written(tmp_path / "table.csv", "\n".join(["time_s,ax,ay,az,label,foo", *lines, ""]))
    assert np.array_equal(read_tables([path]).rows[:, :4], ROWS)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_a_damaged_text_of_two_bytes_is_refused(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "table.csv"
    mark = "\ufeff".encode(encoding)
    path.write_bytes(mark + "t,ax\n".encode(encoding) + (b"\xd8\x00" if encoding.endswith("be") else b"\x00\xd8") * 3)
    with refused(RecordingError, Reason.BAD_DATA):
        read_tables([path])


def test_times_as_dates(tmp_path: Path) -> None:
    rows = [f"2023-03-04T11:12:{13 + row[0]:09.6f}Z,{row[1]:.4f},{row[2]:.4f},{row[3]:.4f},walking" for row in ROWS]
    path = written(tmp_path / "dated.csv", "\n".join(["timestamp,ax,ay,az,label", *rows, ""]))
    table = read_tables([path])
    np.testing.assert_allclose(table.rows[:, 0] + table.begin_s - table.rows[0, 0], 1677928333.0 + TIME, atol=1e-6)
    assert np.array_equal(table.rows[:, 1:4], ROWS[:, 1:])
    # A clock that is a number is taken before a date.
    counted = [f"{row},{1000 + 10 * number}" for number, row in enumerate(rows)]
    path = written(tmp_path / "both.csv", "\n".join(["timestamp,ax,ay,az,label,time_ms", *counted, ""]))
    np.testing.assert_allclose(read_tables([path]).rows[:, 0], 1.0 + TIME, atol=1e-9)
    rows[7] = rows[7].replace("2023-03", "2023-13")
    path = written(tmp_path / "wrong.csv", "\n".join(["timestamp,ax,ay,az,label", *rows, ""]))
    with refused(RecordingError, Reason.BAD_DATA, key="table_text.no_number") as caught:
        read_tables([path])
    assert caught.value.values["line"] == 9


def test_dates_are_in_seconds_whatever_the_heading_says(tmp_path: Path) -> None:
    rows = [f"2023-03-04T11:12:{row:02d}Z,0.1,0.2,9.8" for row in range(40)]
    for heading in ("time", "time (ms)", "timestamp_us"):
        path = written(tmp_path / "dated.csv", "\n".join([f"{heading},ax,ay,az", *rows, ""]))
        np.testing.assert_allclose(np.diff(read_tables([path]).rows[:, 0]), 1.0)


def test_a_line_of_units_may_be_sparse(tmp_path: Path) -> None:
    names = "time,ax,ay,az,status,n,lat,lon,alt,sat"
    rows = [f"{0.01 * row:.2f},0.1,0.2,1.0,0,{row},48,11,500,7" for row in range(40)]
    path = written(tmp_path / "units.csv", "\n".join([names, "s,mg,mg,mg,,,,,,", *rows, ""]))
    assert np.array_equal(read_tables([path]).rows[0, 1:4], np.array([0.1, 0.2, 1.0]) * 1e-3)


def test_rows_that_begin_short_are_no_titles(tmp_path: Path) -> None:
    rows = [*["0.00,1,2,3"] * 5, *(f"{0.01 * row:.2f},1,2,3,4,5,6,7,8,9" for row in range(5, 60))]
    path = written(tmp_path / "short.csv", "\n".join(["time,ax,ay,az,gx,gy,gz,mx,my,mz", *rows, ""]))
    with refused(RecordingError, Reason.BAD_DATA):
        read_tables([path])
    path = written(tmp_path / "cut.csv", "\n".join([UNITS, "3.01,4.01", *lines_of(), ""]))
    with refused(RecordingError, Reason.BAD_DATA):
        read_tables([path])


@pytest.mark.parametrize("cut", ["0.50", "0.50,0.1,0.2", "0.50,0.1,0.2,-", "0.50,0.1,0.2,1e"])
@pytest.mark.parametrize("rows", [3, 50])
def test_a_last_line_that_is_cut_is_left_out_and_told(tmp_path: Path, cut: str, rows: int) -> None:
    path = written(tmp_path / "cut.csv", "\n".join(["time_s,ax,ay,az", *lines_of()[:rows], cut]))
    table = read_tables([path], settings={"accelerometer_unit": "m/s^2"})
    assert np.array_equal(table.rows[:, :4], ROWS[:rows])
    assert "table_text.cut" in keys(table.assumptions)
    # With an end it is a row, and a wrong one.
    with refused(RecordingError, Reason.BAD_DATA):
        read_tables([written(path, path.read_text() + "\n")])


def test_a_whole_last_line_needs_no_end(tmp_path: Path) -> None:
    table = open_table(written(tmp_path / "whole.csv", text_of(TIME, ACCELEROMETER, delimiter=",").rstrip("\n")))
    assert len(table.read([0, 1, 2, 3])) == len(TIME)
    assert not table.assumptions


@pytest.mark.parametrize(("cell", "delimiter", "key"), UNREAD)
@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_a_cell_is_quoted_as_it_stands_in_the_file(tmp_path: Path, cell: str, delimiter: str, key: str, encoding: str) -> None:
    decimal = "," if delimiter == ";" else "."
    lines = [delimiter.join(f"{value:.4f}".replace(".", decimal) for value in row) for row in ROWS]
    lines[7] = delimiter.join([lines[7].split(delimiter)[0], f"0{decimal}5", cell, f"9{decimal}8"])
    path = written(tmp_path / "cells.csv", "\n".join([delimiter.join(("time_s", "ax", "ay", "az")), *lines, ""]), encoding)
    with refused(RecordingError, Reason.BAD_DATA, key=key) as caught:
        read_tables([path])
    assert (caught.value.values["text"], caught.value.values["line"]) == (cell.strip('"'), 9)


def test_a_row_of_another_width_is_quoted_as_it_stands_in_the_file(tmp_path: Path) -> None:
    lines = [row.replace(".", ",") for row in lines_of(";")]
    lines[7] = "0,0700;;1,5"
    path = written(tmp_path / "cells.csv", "\n".join(["time_s;ax;ay;az", *lines, ""]))
    with refused(RecordingError, Reason.BAD_DATA, key="table_text.other_width") as caught:
        read_tables([path])
    assert caught.value.values["text"] == lines[7]


@pytest.mark.parametrize(
    ("text", "delimiter"), [("a|b", ","), ("on|off", None), ("A|3", ","), ("3|x", None), ("2023|01|02", ",")]
)
def test_a_bar_in_a_text_parts_nothing(tmp_path: Path, text: str, delimiter: str | None) -> None:
    lines = [f"{line}{delimiter or ' '}{text}" for line in lines_of(delimiter or " ")]
    table = open_table(written(tmp_path / "table.txt", "\n".join(lines) + "\n"))
    assert (table.delimiter, table.width) == (delimiter, 5)
    np.testing.assert_array_equal(table.read(range(4)), ROWS)


def test_bars_part_cells_in_quotes(tmp_path: Path) -> None:
    lines = ["|".join(f'"{cell}"' for cell in line.split(",")) for line in lines_of(",")]
    table = open_table(written(tmp_path / "table.txt", "\n".join(lines) + "\n"))
    np.testing.assert_array_equal(table.read(range(4)), ROWS)


def test_rows_whose_first_has_no_comment(tmp_path: Path) -> None:
    lines = [line + (" # ok" if number else "") for number, line in enumerate(lines_of(" "))]
    np.testing.assert_array_equal(open_table(written(tmp_path / "table.txt", "\n".join(lines) + "\n")).read(range(4)), ROWS)
