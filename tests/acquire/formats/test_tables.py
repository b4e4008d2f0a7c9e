import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.formats import table_text
from imufield.acquire.formats.tables import ImportedTable, read_tables, row_chunks
from imufield.acquire.protocol.protocol import load_protocol
from imufield.errors import ImufieldError, Reason, RecordingError, UsageError
from tests.acquire.table_files import ACCELEROMETER, GYROSCOPE, RNG, TIME, N, text_of, write
from tests.refused import refused
from tests.told import keys, told


def median_rate_hz(table: ImportedTable) -> float:
    return float(1.0 / np.median(np.diff(table.rows[:, 0])))


def test_a_folder_is_called_one(tmp_path: Path) -> None:
    with refused(RecordingError, Reason.BAD_DATA, str(tmp_path), key="table_text.folder"):
        read_tables([tmp_path])


def test_a_csv_with_header_says_everything_itself(tmp_path: Path) -> None:
    header = "time_ms,acc_x (m/s^2),acc_y (m/s^2),acc_z (m/s^2),gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s)\r\n"
    path = write(tmp_path, text_of(TIME * 1e3, ACCELEROMETER, GYROSCOPE, delimiter=",", header=header, end="\r\n"))
    table = read_tables([path])
    assert table.rows.shape == (N, 8)
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-12)
    assert np.array_equal(table.rows[:, 1:4], ACCELEROMETER)
    assert np.array_equal(table.rows[:, 4:7], GYROSCOPE)
    assert np.isnan(table.rows[:, 7]).all()
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s"}
    assert table.raw_zero == (0.0, 0.0, 0.0)
    assert table.assumptions == ()
    assert median_rate_hz(table) == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("header", "delimiter"),
    [
        ("time_s,acc;x,acc_y,acc_z\n", ","),
        ("time_s acc;x acc_y acc_z\n", " "),
        ("time_s, acc_x, acc_y, acc_z\n", " "),
        ("time_s;acc,x;acc,y;acc,z\n", ";"),
        ("time_s|acc;x|acc,y|acc,z\n", "|"),
        ("# time_s,acc;x,acc_y,acc_z\n", ","),
    ],
)
def test_what_parts_the_rows_parts_their_heading(tmp_path: Path, header: str, delimiter: str) -> None:
    table = read_tables([write(tmp_path, text_of(TIME, ACCELEROMETER, delimiter=delimiter, header=header))])
    assert table.rows[:, 1:4] == pytest.approx(ACCELEROMETER)
    assert not told(table.assumptions, "table_columns.taken_as")


def test_columns_in_any_order_among_others(tmp_path: Path) -> None:
    header = '"Counter";"Gyr_X";"Gyr_Y";"Gyr_Z";"Mag_X";"Acc_X";"Acc_Y";"Acc_Z";"time_s";"Temp"\n'
    columns = (np.arange(N), GYROSCOPE, TIME, ACCELEROMETER, TIME, TIME + 20.0)
    table = read_tables([write(tmp_path, text_of(*columns, delimiter=";", header=header))])
    assert np.array_equal(table.rows, np.column_stack([TIME, ACCELEROMETER, GYROSCOPE, TIME + 20.0]))
    assert "Counter, Mag_X" in table.assumptions[0]


def test_decimal_commas_beside_semicolons(tmp_path: Path) -> None:
    text = text_of(TIME, ACCELEROMETER, delimiter=";").replace(".", ",")
    table = read_tables([write(tmp_path, text)])
    assert np.array_equal(table.rows[:, :4], np.column_stack([TIME, ACCELEROMETER]))


def test_a_line_of_units_below_the_names(tmp_path: Path) -> None:
    header = "Time,AccX,AccY,AccZ\n(ms),(mg),(mg),(mg)\n"
    table = read_tables([write(tmp_path, text_of(TIME * 1e3, ACCELEROMETER / 9.8 * 1e3, delimiter=",", header=header))])
    assert table.settings["accelerometer_unit"] == "g"
    np.testing.assert_allclose(table.rows[:, 1:4], ACCELEROMETER / 9.8, rtol=1e-12)
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-12)
    assert any("mg" in sentence for sentence in table.assumptions)


@pytest.mark.parametrize("mark", ["# ", "% ", "//"])
def test_a_commented_header_counts(tmp_path: Path, mark: str) -> None:
    header = f"{mark}made by a logger\n{mark}t gx gy gz ax ay az\n"
    table = read_tables([write(tmp_path, text_of(TIME, GYROSCOPE, ACCELEROMETER, header=header))])
    assert np.array_equal(table.rows[:, 1:7], np.column_stack([ACCELEROMETER, GYROSCOPE]))


@pytest.mark.parametrize(
    ("columns", "places"),
    [
        ((TIME, ACCELEROMETER), slice(0, 4)),
        ((TIME, ACCELEROMETER, GYROSCOPE), slice(0, 7)),
        ((TIME, ACCELEROMETER, GYROSCOPE, TIME), slice(0, 8)),
    ],
)
def test_without_header_the_count_decides_and_is_said(tmp_path: Path, columns: tuple[np.ndarray, ...], places: slice) -> None:
    table = read_tables([write(tmp_path, text_of(*columns, delimiter="\t"))])
    assert np.array_equal(table.rows[:, places], np.column_stack(columns))
    assert "header" in table.assumptions[0]


def test_without_time_a_rate_is_needed(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(ACCELEROMETER, GYROSCOPE))
    with refused(UsageError, Reason.USAGE, "--rate-hz"):
        read_tables([path])
    table = read_tables([path], rate_hz=200.0)
    assert np.array_equal(table.rows[:, 0], np.arange(N) / 200.0)
    assert table.settings["rate_hz"] == 200.0
    assert any("200 Hz" in sentence for sentence in table.assumptions)


def test_the_user_s_word_counts_most(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(GYROSCOPE, TIME * 1e6, TIME, ACCELEROMETER))
    table = read_tables([path], columns="gx,gy,gz,time_us,-,ax,ay,az", settings={"gyroscope_unit": "deg/s"})
    np.testing.assert_allclose(table.rows[:, :7], np.column_stack([TIME, ACCELEROMETER, GYROSCOPE]), atol=1e-12)
    assert table.settings["gyroscope_unit"] == "deg/s"


@pytest.mark.parametrize(
    ("columns", "key", "facts"),
    [
        ("time,ax,ay", "table_columns.other_number", ("--columns", "3", "7")),
        ("time,ax,ay,az,gx,gy,colour", "table_columns.unknown_name", ("--columns", "'colour'")),
        ("time,ax,ay,az,gx,gy,gy", "table_columns.doubled", ("gy", "--columns")),
        ("time,ax,ay,az,gx,gy,-", "table_columns.missing", ("gz", "--columns")),
        ("time,-,-,-,-,-,-", "table_columns.no_triad", ("time", "ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps")),
        ("a;b", "tables.other_number", ("--columns", "2 ", "1 ")),
    ],
)
def test_a_word_that_makes_no_sense_is_refused(tmp_path: Path, columns: str, key: str, facts: tuple[str, ...]) -> None:
    with refused(UsageError, Reason.USAGE, *facts, key=key):
        read_tables([write(tmp_path, text_of(TIME, ACCELEROMETER, GYROSCOPE))], columns=columns)


def test_unknown_columns_are_a_question_to_the_user(tmp_path: Path) -> None:
    with refused(UsageError, Reason.USAGE, "--columns") as caught:
        read_tables([write(tmp_path, text_of(TIME, ACCELEROMETER, TIME))])
    assert caught.value.values["width"] == 5
    with refused(UsageError, Reason.USAGE, "--columns"):
        read_tables([write(tmp_path, text_of(TIME, TIME, header="p q\n"))])
    with refused(UsageError, Reason.USAGE, "--columns") as caught:
        read_tables([write(tmp_path, text_of(TIME, ACCELEROMETER, TIME, header="t ax ay az ax\n"))])
    assert caught.value.values["field"] == "ax"


def test_a_table_without_a_time_says_what_it_knows(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(ACCELEROMETER, header="ax ay az\n"))
    with refused(UsageError, Reason.USAGE, "ax, ay, az", "--rate-hz", "time_ms", key="table_join.no_rate"):
        read_tables([path])


@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_the_unit_of_time_follows_from_the_median_step(tmp_path: Path, unit: str, scale: float) -> None:
    path = write(tmp_path, text_of(np.round(TIME * scale, 6) + 1e5, ACCELEROMETER))
    table = read_tables([path])
    np.testing.assert_allclose(table.rows[:, 0], TIME + 1e5 / scale, atol=1e-6)
    assert any(unit in re.split(r"[ ,;:]+", sentence) for sentence in table.assumptions)


def test_an_implausible_step_is_a_question(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(TIME * 23.0, ACCELEROMETER))
    with refused(UsageError, Reason.USAGE, "0.23", "time_unit", "--rate-hz") as caught:
        read_tables([path])
    assert caught.value.values["rate_hz"] is None
    assert median_rate_hz(read_tables([path], columns="time_s,ax,ay,az")) == pytest.approx(1.0 / 0.23)
    assert median_rate_hz(read_tables([path], rate_hz=4.3)) == pytest.approx(1.0 / 0.23)
    with refused(UsageError, Reason.USAGE, "0.23", "--rate-hz") as caught:
        read_tables([path], rate_hz=100.0)
    assert caught.value.values["rate_hz"] == 100
    with refused(UsageError, Reason.USAGE, "--rate-hz 100", "4.34783 Hz", key="table_columns.other_rate"):
        read_tables([path], columns="time_s,ax,ay,az", rate_hz=100.0)


@pytest.mark.parametrize(
    ("values", "zero", "unit"),
    [
        (np.round(ACCELEROMETER * 400.0) + 32768.0, None, "count"),
        (ACCELEROMETER * 400.5 + 32768.0, [32768.0] * 3, "count"),
        (ACCELEROMETER, None, "m/s^2"),
        (ACCELEROMETER / 9.81, None, "g"),
        (ACCELEROMETER * 50.0 + 0.1, None, "count"),
    ],
)
def test_the_unit_of_the_accelerometer_is_assumed_aloud(
    tmp_path: Path, values: np.ndarray, zero: list[float] | None, unit: str
) -> None:
    table = read_tables([write(tmp_path, text_of(TIME, values))], zero=zero)
    assert table.settings["accelerometer_unit"] == unit
    assert any("accelerometer" in sentence and unit in re.split(r"[ ,;:]+", sentence) for sentence in table.assumptions)
    assert np.array_equal(table.rows[:, 1:4], values)


@pytest.mark.parametrize(
    ("values", "unit"), [(GYROSCOPE, "rad/s"), (GYROSCOPE * 5000.0, "deg/s"), (np.round(GYROSCOPE * 5000.0), "count")]
)
def test_the_unit_of_the_gyroscope_is_assumed_aloud(tmp_path: Path, values: np.ndarray, unit: str) -> None:
    table = read_tables([write(tmp_path, text_of(TIME, ACCELEROMETER, values))])
    assert table.settings["gyroscope_unit"] == unit
    assert any("gyroscope" in sentence and unit in re.split(r"[ ,;:]+", sentence) for sentence in table.assumptions)


def test_a_raw_zero_is_kept_beside_the_values(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(TIME, ACCELEROMETER))
    assert read_tables([path]).raw_zero == (0.0, 0.0, 0.0)
    assert read_tables([path], zero=[1.0, 2.0, 3.0]).raw_zero == (1.0, 2.0, 3.0)


def test_gzip_is_known_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "table.mat"
    path.write_bytes(gzip.compress(text_of(TIME, ACCELEROMETER).encode()))
    assert np.array_equal(read_tables([path]).rows[:, 1:4], ACCELEROMETER)
    path.write_bytes(path.read_bytes()[:-20])
    with refused(RecordingError, Reason.DAMAGED, key="table_text.bad_gzip"):
        read_tables([path])


def test_a_damaged_packing_is_told_before_the_lines_that_it_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 300)
    packed = bytearray(gzip.compress(text_of(TIME, ACCELEROMETER).replace("\n", "\nx ", 9).encode()))
    packed[-8] ^= 1  # Of its checksum.
    path = tmp_path / "table.txt.gz"
    path.write_bytes(packed)
    with refused(RecordingError, Reason.DAMAGED, key="table_text.bad_gzip"):
        read_tables([path])


@pytest.mark.parametrize(
    ("line", "bad", "key", "named"),
    [
        (3, "0.02 1.0 x 9.8", "table_text.no_number", {"text": "x"}),
        (1, "0.00 1_0 2.0 9.8", "table_text.no_number", {"text": "1_0"}),
        (7, "0.06 1.0 2.0", "table_text.other_width", {"found": 3, "width": 4}),
        (7, "0.06 1.0 2.0 3.0 4.0", "table_text.other_width", {"found": 5, "width": 4}),
        (9, "0.08 1.0 -inf 9.8", "table_file.not_finite", {"name": "ay", "value": -np.inf}),
        (9, "0.08 1.0 1e999 9.8", "table_file.not_finite", {"name": "ay", "value": np.inf}),
        (9, "nan 1.0 2.0 9.8", "table_file.not_finite", {"name": "time"}),
        (9, "0.01 1.0 2.0 9.8", "table_file.wrong_time", {"value": 0.01}),
        (9, "7.01 1.0 2.0 9.8", "table_file.wrong_time", {"value": 7.01}),
        (1, "7.01 1.0 2.0 9.8", "table_file.wrong_time", {"value": 7.01}),
        (50, "0.01 1.0 2.0 9.8", "table_file.wrong_time", {"value": 0.01}),
        (49, "7.01 1.0 2.0 9.8", "table_file.wrong_time", {"value": 7.01}),
        (1, "0.00 1.0 9.8", "table_text.other_width", {"found": 3, "width": 4}),
        (50, "0.49 1.0 --- 9.8", "table_text.no_number", {"text": "---"}),
    ],
)
@pytest.mark.parametrize("block_bytes", [table_text.BLOCK_BYTES, 300])
def test_a_bad_line_is_named(
    tmp_path: Path,
    line: int,
    bad: str,
    key: str,
    named: dict[str, object],
    block_bytes: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", block_bytes)
    lines = text_of(TIME, np.round(ACCELEROMETER, 3)).split("\n")
    lines[line - 1] = bad
    path = write(tmp_path, "\n".join(lines))
    with refused(RecordingError, Reason.BAD_DATA, str(path), f"in line {line}", key=key) as caught:
        read_tables([path])
    assert named.items() <= caught.value.values.items()
    assert caught.value.values["line"] == line


def test_a_file_that_is_given_twice_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(TIME, ACCELEROMETER))
    with refused(UsageError, Reason.USAGE, str(path), key="tables.same_file"):
        read_tables([path, path.parent / "." / path.name])


def test_a_heading_that_names_more_than_the_rows_hold(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(TIME, ACCELEROMETER, header="t ax ay az gx gy gz\n"))
    with refused(RecordingError, Reason.BAD_DATA, "4 columns", key="table_text.narrow_rows") as caught:
        read_tables([path])
    assert {"line": 2, "named": 7}.items() <= caught.value.values.items()


def test_a_short_first_row_is_named_where_rows_end_with_a_delimiter(tmp_path: Path) -> None:
    rows = [f"{0.01 * number:g},0,0,9.8," for number in range(9)]
    path = write(tmp_path, "\n".join(["time,ax,ay,az", "0,0,9.8", *rows[1:]]))
    with refused(RecordingError, Reason.BAD_DATA, "line 2", key="table_text.other_width"):
        read_tables([path])


@pytest.mark.parametrize("bad", ["0.02,0,0,9.8", "0.02,0,0,9.8,5,6", "0.02,0,0,9.8,5,6,7,8"])
@pytest.mark.parametrize("delimiter", [",", "\t"])
def test_a_row_of_another_width_is_named_beside_columns_that_are_skipped(tmp_path: Path, bad: str, delimiter: str) -> None:
    rows = ["time,ax,ay,az,note", "0.00,0,0,9.8,1", "0.01,0,0,9.8,2", bad, "0.03,0,0,9.8,4"]
    path = write(tmp_path, "\n".join(rows).replace(",", delimiter))
    with refused(RecordingError, Reason.BAD_DATA, "line 4", key="table_text.other_width") as caught:
        read_tables([path])
    assert (caught.value.values["found"], caught.value.values["width"]) == (bad.count(",") + 1, 5)


def test_blank_and_commented_lines_do_not_shift_the_count(tmp_path: Path) -> None:
    text = "# logger\n\nt ax ay az\n0.00 1 2 3\n\n# pause\n0.01 1 2 3\n0.02 1 inf 3\n"
    with refused(RecordingError, Reason.BAD_DATA, "inf", "ay") as caught:
        read_tables([write(tmp_path, text)])
    assert caught.value.values["line"] == 8


def test_empty_cells_are_gaps_in_an_axis_and_allowed_in_the_temperature(tmp_path: Path) -> None:
    text = "t,ax,ay,az,gx,gy,gz,temp\n0.00,1,2,3,,,,20\n0.01,1,2,3,,,,\n0.02,1,2,3,,,,21"
    rows = read_tables([write(tmp_path, text)], settings={"accelerometer_unit": "count"}).rows
    assert np.isnan(rows[:, 4:7]).all()
    assert np.array_equal(rows[:, 7], [20.0, np.nan, 21.0], equal_nan=True)
    rows = read_tables(
        [write(tmp_path, text.replace("0.01,1,2,3", "0.01,1,,3"))], settings={"accelerometer_unit": "count"}
    ).rows
    assert rows[:, 0].tolist() == [0.0, 0.02]


@pytest.mark.parametrize("block_bytes", [1 << 20, 97])
def test_blocks_of_any_size_give_the_same(tmp_path: Path, block_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_text, "BLOCK_BYTES", block_bytes)
    path = write(tmp_path, text_of(TIME, ACCELEROMETER, delimiter=",", header="t,ax,ay,az\n", end=",\n").rstrip("\n"))
    assert np.array_equal(read_tables([path]).rows[:, :4], np.column_stack([TIME, ACCELEROMETER]))


@pytest.mark.parametrize(
    ("content", "key", "facts"),
    [
        (b"", "table_text.no_rows", ()),
        (b"\n\n", "table_text.no_rows", ()),
        (b"t ax ay az\n", "table_text.no_rows", ()),
        (b"0.0 1 2 3\n", "table_file.one_row", ("1 row",)),
        (b"binary\x00\x01\x02", "table_text.no_text", ("--protocol",)),
        (b"a\nb\nc\nd\n1 2 3\n", "table_text.long_heading", ("4 lines",)),
        (b"t ax ay az\n0 1 2 3\n" + b"1 2 3 4 " * 300_000, "table_text.long_line", ("1048576",)),
    ],
)
def test_what_is_no_table_says_so(tmp_path: Path, content: bytes, key: str, facts: tuple[str, ...]) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(content)
    with refused(RecordingError, Reason.BAD_DATA, str(path), *facts, key=key) as caught:
        read_tables([path])
    assert caught.value.reason is Reason.BAD_DATA


def test_missing_files_are_an_error_of_ours(tmp_path: Path) -> None:
    for paths in ([tmp_path / "missing.csv"], [tmp_path], []):
        with pytest.raises(ImufieldError):
            read_tables(paths)


def test_rows_are_written_whole_and_decode_to_the_same_samples() -> None:
    n = 10_000
    time_s = np.arange(n) * 0.01
    rows = np.column_stack([time_s, RNG.normal(size=(n, 6)), np.full(n, 25.0)])
    chunks = [*row_chunks(rows)]
    assert all(len(chunk.data) % 64 == 0 for chunk in chunks)
    assert [chunk.monotonic_s for chunk in chunks] == [time_s[4095], time_s[8191], time_s[-1]]
    decoder = Decoder(load_protocol("rows_f64", {"accelerometer_unit": "count", "gyroscope_unit": "count"}))
    blocks = [decoder.feed(chunk.data, chunk.monotonic_s) for chunk in chunks]
    for name, columns in (("time_s", 0), ("accelerometer", slice(1, 4)), ("gyroscope", slice(4, 7)), ("temperature_degc", 7)):
        assert np.array_equal(np.concatenate([getattr(block, name) for block in blocks]), rows[:, columns])
    again = [chunk for block in blocks for chunk in row_chunks(block)]
    assert b"".join(chunk.data for chunk in again) == b"".join(chunk.data for chunk in chunks)


def test_the_recording_of_an_xsens_is_read_and_joined(shared_folder: Path) -> None:
    folder = shared_folder / "data" / "imu_tk"
    table = read_tables([folder / "xsens_acc.mat.gz", folder / "xsens_gyro.mat.gz"], zero=[32768.0] * 3)
    assert table.rows.shape == (51175, 8)
    assert table.rows[0, :7].tolist() == [0.02984, 33108.0, 33329.0, 36429.0, 32786.0, 32429.0, 32499.0]
    assert table.rows[-1, 0] == pytest.approx(511.718, abs=1e-3)
    assert table.settings == {"accelerometer_unit": "count", "gyroscope_unit": "count"}
    assert table.raw_zero == (32768.0,) * 3
    assert median_rate_hz(table) == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize("empty", [0, 3])
def test_an_axis_without_a_number_is_named(tmp_path: Path, empty: int) -> None:
    table = np.hstack([ACCELEROMETER, GYROSCOPE])
    table[:, empty] = np.nan
    path = write(tmp_path, text_of(TIME, table, delimiter=",", header="time_s,ax,ay,az,gx,gy,gz\n"))
    with refused(RecordingError, Reason.BAD_DATA, "--columns") as caught:
        read_tables([path])
    assert caught.value.values["columns"] == [("ax", "", "", "gx")[empty]]


@pytest.mark.parametrize("absurd", [1e300, 1e308, 5000.0])
def test_one_absurd_sample_does_not_decide_the_unit(tmp_path: Path, absurd: float) -> None:
    gyroscope = GYROSCOPE.copy()
    gyroscope[7, 1] = absurd
    path = write(tmp_path, text_of(TIME, ACCELEROMETER, gyroscope, delimiter=",", header="time_s,ax,ay,az,gx,gy,gz\n"))
    assert read_tables([path]).settings["gyroscope_unit"] == "rad/s"


def test_a_rate_that_contradicts_the_time_is_said(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(TIME, ACCELEROMETER, delimiter=",", header="time,ax,ay,az\n"))
    with refused(UsageError, Reason.USAGE, "--rate-hz 50", "100 Hz"):
        read_tables([path], rate_hz=50)


def test_a_file_without_header_whose_first_column_is_no_time(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(GYROSCOPE[:, 2:], ACCELEROMETER, GYROSCOPE, delimiter=","))
    with refused(RecordingError, Reason.BAD_DATA, "--columns time,ax") as caught:
        read_tables([path])
    assert caught.value.values["line"] == 2
    named = text_of(GYROSCOPE[:, 2:], ACCELEROMETER, header="t,ax,ay,az\n", delimiter=",")
    with refused(RecordingError, Reason.BAD_DATA, key="table_file.time_back") as caught:
        read_tables([write(tmp_path, named)])
    assert caught.value.values["line"] == 3


@pytest.mark.parametrize(("unit", "per_s"), [("s", 1), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_the_unit_of_time_that_is_given_counts(tmp_path: Path, unit: str, per_s: float) -> None:
    path = write(tmp_path, text_of(TIME, ACCELEROMETER))
    np.testing.assert_allclose(read_tables([path], settings={"time_unit": unit}).rows[:, 0], TIME / per_s)
    by_name = read_tables([path], columns=f"time_{unit},ax,ay,az")
    np.testing.assert_allclose(by_name.rows[:, 0], TIME / per_s)
    with refused(UsageError, Reason.USAGE, "time_unit", "day", "s, ms, us, ns, min, h"):
        read_tables([path], settings={"time_unit": "day"})


OWN = "time_s,ax,ay,az,gx,gy,gz,temperature_degc,counter,status\n"


def own(folder: Path, **changed: tuple[int, str]) -> Path:
    """Write a table like our exports, in counts and deg/s; ``status=(row, text)`` changes a row, ``a`` and ``g`` are triads."""
    lines = []
    for row in range(N):
        cells = {"t": f"{row / 100}", "a": f"{row % 7},{row % 5},16384", "g": f"{row % 3},2.5,90.5", "temperature": "25.0"}
        cells |= {"counter": str(row), "status": "0"}
        lines.append(",".join((cells | {name: text for name, (at, text) in changed.items() if at == row}).values()))
    return write(folder, OWN + "\n".join(lines) + "\n", "own.csv")


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize(("status", "gone"), [("1", ("a",)), ("2", ("g",)), ("3", ("a", "g"))])
def test_a_row_that_lacks_a_triad_decides_no_unit(tmp_path: Path, row: int, status: str, gone: tuple[str, ...]) -> None:
    table = read_tables([own(tmp_path, status=(row, status), **dict.fromkeys(gone, (row, ",,")))])
    assert table.settings["accelerometer_unit"] == "count"
    assert table.settings["gyroscope_unit"] == "deg/s"
    assert np.isnan(table.rows[:, 1]).nonzero()[0].tolist() == ([row] if "a" in gone else [])
    assert table.status is not None
    assert table.status[row] == int(status)


@pytest.mark.parametrize("found", [-999.0, -100.5, 300.5, 5000.0])
def test_a_temperature_that_no_instrument_has_is_named(tmp_path: Path, found: float) -> None:
    path = tmp_path / "warm.csv"
    rows = [f"{0.01 * k:.2f},0.1,0.2,9.8,{found if k == 7 else 20.0}" for k in range(20)]
    path.write_text("\n".join(["time_s,ax,ay,az,temperature_degc", *rows]))
    with refused(RecordingError, Reason.BAD_DATA, f"{found:g} degC", key="table_file.impossible") as caught:
        read_tables([path])
    assert caught.value.values["line"] == 9
    # Without that column the rest is as good as ever.
    assert np.isnan(read_tables([path], columns="time,ax,ay,az,-").rows[:, 7]).all()


@pytest.mark.parametrize("text", ["inf", "-inf", "1e300", "0.5"])
def test_a_counter_that_is_no_whole_number_is_named(tmp_path: Path, text: str) -> None:
    with refused(RecordingError, Reason.BAD_DATA, f"{float(text):g}", "counter") as caught:
        read_tables([own(tmp_path, counter=(2, text))])
    assert caught.value.values["line"] == 4


@pytest.mark.parametrize("text", ["", "nan", "inf", "1e300", "1.5", "-1", "8589934592"])
def test_a_status_that_is_none_is_named(tmp_path: Path, text: str) -> None:
    with refused(RecordingError, Reason.BAD_DATA, "status", "4294967295") as caught:
        read_tables([own(tmp_path, status=(2, text))])
    assert caught.value.values["line"] == 4


def test_a_counter_may_be_missing_and_a_status_full(tmp_path: Path) -> None:
    table = read_tables([own(tmp_path, counter=(3, ""), status=(5, "4294967295"))])
    assert table.counter is not None
    assert table.counter[2:5].tolist() == [2, -1, 4]
    assert table.status is not None
    assert table.status[4:7].tolist() == [0, 2**32 - 1, 0]


@pytest.mark.parametrize(
    ("settings", "rate_hz"),
    [({}, 200.0), ({"rate_hz": "100"}, None), ({"accelerometer_unit": "m/s^2", "gyroscope_unit": "deg"}, 200.0)],
    ids=["by time", "stated", "angles alone, in deg"],
)
def test_increments_have_the_rate_of_their_times(tmp_path: Path, settings: dict[str, str], rate_hz: float | None) -> None:
    path = tmp_path / "increments.csv"
    rows = "".join(f"{5 * k / 1000},0,0,0.049,0,0,{1e-6 * k}\n" for k in range(400))
    path.write_text(f"time (s),ax (m/s),ay (m/s),az (m/s),gx (rad),gy (rad),gz (rad)\n{rows}", encoding="utf-8")
    table = read_tables([path], settings=settings)
    assert table.settings.get("rate_hz") == (rate_hz if rate_hz is None else pytest.approx(rate_hz))
    assert ("tables.rate_of_increments" in keys(table.assumptions)) == (rate_hz is not None)
