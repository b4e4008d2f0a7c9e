"""Tables whose rows do not all hold every triad: merged logs, lost samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats.tables import ImportedTable, read_tables, stream_table
from imufield.errors import Reason, RecordingError
from imufield.sentences import Sentence
from tests.acquire.table_files import write
from tests.refused import refused

TIME = np.arange(50) / 100.0
HEADING = "time_s,ax_m_s2,ay_m_s2,az_m_s2,gx_rad_s,gy_rad_s,gz_rad_s,temperature_degc\n"


def accelerometer(time: np.ndarray) -> np.ndarray:
    return np.column_stack([time, 2.0 * time, 9.8 - time])


def gyroscope(time: np.ndarray) -> np.ndarray:
    return np.column_stack([3.0 * time, -time, 0.1 + time])


def text_of(*tables: np.ndarray, missing: str = "") -> str:
    """Write rows of eight cells, sorted by time."""
    rows = np.concatenate(tables)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return HEADING + "".join(",".join(missing if np.isnan(x) else repr(float(x)) for x in row) + "\n" for row in rows)


def rows_of(time: np.ndarray, *, accelerometers: bool, gyroscopes: bool, degc: float = np.nan) -> np.ndarray:
    rows = np.full((len(time), 8), np.nan)
    rows[:, 0], rows[:, 7] = time, degc
    if accelerometers:
        rows[:, 1:4] = accelerometer(time)
    if gyroscopes:
        rows[:, 4:7] = gyroscope(time)
    return rows


def said(table: ImportedTable) -> dict[str, list[dict[str, object]]]:
    found: dict[str, list[dict[str, object]]] = {}
    for each in table.assumptions:
        assert isinstance(each, Sentence)
        found.setdefault(each.key, []).append(dict(each.values))
    return found


@pytest.mark.parametrize("missing", ["", "nan", "NaN"])
def test_a_log_of_two_instruments_in_turns_is_read_as_two(tmp_path: Path, missing: str) -> None:
    other = TIME + 0.003
    alone = [
        rows_of(TIME, accelerometers=True, gyroscopes=False),
        rows_of(other, accelerometers=False, gyroscopes=True),
        # A thermometer has rows of its own, too.
        rows_of(np.array([0.1]), accelerometers=False, gyroscopes=False, degc=20.0),
        rows_of(np.array([0.3]), accelerometers=False, gyroscopes=False, degc=22.0),
    ]
    table = read_tables([write(tmp_path, text_of(*alone, missing=missing), "merged.csv")])
    time = table.rows[:, 0]
    # The first accelerometer sample is 3 ms before the first one of the gyroscope, less than half a step.
    assert np.array_equal(time, TIME)
    np.testing.assert_allclose(table.rows[:, 1:4], accelerometer(TIME), atol=0.0)
    np.testing.assert_allclose(table.rows[1:, 4:7], gyroscope(TIME[1:]), atol=1e-12)
    np.testing.assert_allclose(table.rows[:, 7], 20.0 + np.clip((TIME - 0.1) * 10.0, 0.0, 2.0), atol=1e-12)
    parts = said(table)["table_file.part"]
    assert [(part["quantity"], part["found"], part["of"]) for part in parts] == [
        ("accelerometer", 50, 102),
        ("gyroscope", 50, 102),
    ]
    assert "table_join.interpolated" in said(table)


def test_instruments_that_are_each_in_order_may_be_out_of_turn(tmp_path: Path) -> None:
    first = text_of(rows_of(TIME, accelerometers=True, gyroscopes=False)).splitlines()
    second = text_of(rows_of(TIME - 0.004, accelerometers=False, gyroscopes=True)).splitlines()
    lines = [first[0], *(line for pair in zip(first[1:], second[1:], strict=True) for line in pair)]
    table = read_tables([write(tmp_path, "\n".join(lines) + "\n", "turns.csv")])
    np.testing.assert_allclose(table.rows[:-1, 4:7], gyroscope(table.rows[:-1, 0]), atol=1e-12)


@pytest.mark.parametrize(
    ("lost", "of"), [(slice(1, 4), "accelerometer"), (slice(4, 7), "gyroscope"), (slice(5, 6), "gyroscope")]
)
def test_a_lost_sample_is_a_gap(tmp_path: Path, lost: slice, of: str) -> None:
    whole = rows_of(TIME, accelerometers=True, gyroscopes=True, degc=25.0)
    rows = whole.copy()
    rows[20:22, lost] = np.nan
    table = read_tables([write(tmp_path, text_of(rows), "lost.csv")])
    assert np.array_equal(table.rows, np.delete(whole, [20, 21], axis=0))
    assert [part["quantity"] for part in said(table)["table_file.part"]] == [of]
    assert "table_join.interpolated" not in said(table)


def test_a_table_is_still_refused_where_nobody_knows_what_its_empty_cells_mean(tmp_path: Path) -> None:
    rows = rows_of(TIME, accelerometers=True, gyroscopes=True, degc=25.0)
    rows[20, 2] = np.nan
    path = write(tmp_path, text_of(rows), "lost.csv")
    # Without times, or where each row becomes one row of the output.
    with refused(RecordingError, Reason.BAD_DATA, key="table_file.not_finite") as caught:
        read_tables([path], columns="-,ax,ay,az,gx,gy,gz,-", rate_hz=100.0)
    assert (caught.value.values["line"], caught.value.values["name"]) == (22, "ay")
    with refused(RecordingError, Reason.BAD_DATA, key="table_file.not_finite"):
        list(stream_table(path))


def test_a_fault_in_a_part_is_named_with_its_line(tmp_path: Path) -> None:
    rows = rows_of(TIME, accelerometers=True, gyroscopes=False)
    rows[30, 2] = np.inf
    path = write(tmp_path, text_of(rows, rows_of(TIME + 0.003, accelerometers=False, gyroscopes=True)), "merged.csv")
    with refused(RecordingError, Reason.BAD_DATA, key="table_file.not_finite") as caught:
        read_tables([path])
    # A heading, then 30 rows of each before it.
    assert caught.value.values["line"] == 1 + 2 * 30 + 1


def test_a_part_needs_two_samples(tmp_path: Path) -> None:
    rows = rows_of(TIME, accelerometers=True, gyroscopes=False)
    assert np.isnan(read_tables([write(tmp_path, text_of(rows), "alone.csv")]).rows[:, 4:7]).all()
    rows[0, 4:7] = 0.1
    with refused(RecordingError, Reason.BAD_DATA, key="table_file.one_row_of_triad") as caught:
        read_tables([write(tmp_path, text_of(rows), "merged.csv")])
    assert caught.value.values["quantity"] == "gyroscope"


def test_an_empty_time_joins_no_rows(tmp_path: Path) -> None:
    both = [rows_of(TIME, accelerometers=True, gyroscopes=False), rows_of(TIME, accelerometers=False, gyroscopes=True)]
    text = text_of(*both).replace("\n0", "\n").splitlines()
    lines = [text[0], *("," + line.split(",", 1)[1] for line in text[1:])]
    with refused(RecordingError, Reason.BAD_DATA, key="table_file.not_finite"):
        read_tables([write(tmp_path, "\n".join(lines) + "\n", "untimed.csv")], rate_hz=100.0)


def test_one_column_of_times_has_one_unit(tmp_path: Path) -> None:
    """By its own steps of 0.25 s the gyroscope's would be milliseconds."""
    slow = np.arange(0.0, 0.5, 0.25)
    rows = [rows_of(TIME, accelerometers=True, gyroscopes=False), rows_of(slow, accelerometers=False, gyroscopes=True)]
    text = text_of(*rows).replace("time_s", "time")
    table = read_tables([write(tmp_path, text, "merged.csv")], settings={"accelerometer_unit": "m/s^2"})
    between = table.rows[table.rows[:, 0] <= 0.25]
    assert len(between) == 26
    np.testing.assert_allclose(between[:, 4:7], gyroscope(between[:, 0]), atol=1e-12)
