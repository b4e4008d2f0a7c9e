from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats.tables import read_tables, stream_table
from imufield.acquire.protocol.units import SECONDS
from imufield.errors import Reason, RecordingError, UsageError
from tests.acquire.table_files import ACCELEROMETER, GYROSCOPE, TIME, text_of, write
from tests.refused import refused
from tests.told import keys, told


@pytest.mark.parametrize(
    ("header", "row"),
    [
        # As R writes the numbers of its rows.
        ("time,ax,ay,az", "17,0.01,0.0,0.0,9.8"),
        # Decimal commas between commas.
        ("ax,ay,az", "0,123,-0,045,9,810"),
    ],
)
def test_a_header_that_names_fewer_than_the_rows_hold(tmp_path: Path, header: str, row: str) -> None:
    width = row.count(",") + 1
    path = write(tmp_path, f"{header}\n{row}\n{row}\n")
    with refused(UsageError, Reason.USAGE, "--columns", key="table_columns.narrow_header") as caught:
        read_tables([path], rate_hz=100)
    assert (caught.value.values["found"], caught.value.values["width"]) == (header.count(",") + 1, width)


@pytest.mark.parametrize(("round_to", "unit"), [(1.0, None), (0.1, None), (0.1, "s")])
def test_a_clock_too_coarse_for_its_samples_is_refused(tmp_path: Path, round_to: float, unit: str | None) -> None:
    coarse = np.floor(np.arange(500) / 100 / round_to) * round_to + 1.7643e9
    path = write(tmp_path, text_of(np.round(coarse, 2), np.full((500, 3), 5.7)))
    with refused(UsageError, Reason.USAGE, "--columns", "--rate-hz", key="table_columns.same_times"):
        read_tables([path], settings={"time_unit": unit} if unit else None)
    with refused(UsageError, Reason.USAGE, key="table_columns.same_times"):
        next(stream_table(path))
    read_tables([path], columns="-,ax,ay,az", rate_hz=100)
    # Two rows of each time may be two sensors, or a logger that is in time for every second one only.
    values = np.random.default_rng(1).normal(size=(500, 3))
    write(tmp_path, text_of(np.repeat(np.arange(250) / 50, 2), values))
    assert len(read_tables([path]).rows) == 500


@pytest.mark.parametrize("ticks_per_sample", [1.07, 1.6, 2.0, 2.45, 4.0, 4.3])
def test_rows_of_one_tick_are_spread_and_losses_stay_where_they_are(tmp_path: Path, ticks_per_sample: float) -> None:
    true_s = np.delete(1e-2 * np.arange(4000), [*range(1000, 1040), *range(3000, 3009)])
    tick_s = 1e-2 * ticks_per_sample
    stamps_s = np.floor(true_s / tick_s + 1e-9) * tick_s
    path = write(tmp_path, text_of(stamps_s, np.random.default_rng(1).normal(size=(len(true_s), 3))))
    table = read_tables([path])
    time_s = table.rows[:, 0]
    (found,) = told(table.assumptions, "tables.spread")
    assert (found.values["rows"], found.values["of"]) == (np.count_nonzero(np.diff(stamps_s) == 0), len(true_s))
    assert np.all((time_s > stamps_s) & (time_s < stamps_s + tick_s))
    # Half a step from a step is where a loss would begin. How much of a tick is lost nobody knows, nor of the first and last.
    lost, within = np.rint(np.diff(time_s) / 1e-2) - 1, int(np.ceil(ticks_per_sample))
    around = [slice(row - within, row + within) for row in (999, 2959)]
    assert all(abs(lost[rows].sum() - size) <= 1 for rows, size in zip(around, (40, 9), strict=True))
    for rows in (*around, slice(within), slice(-within, None)):
        lost[rows] = 0
    assert not lost.any()


def test_a_row_that_is_there_twice_counts_once(tmp_path: Path) -> None:
    rows = np.column_stack([1e-2 * np.arange(500), np.random.default_rng(1).normal(size=(500, 3))])
    for twice in (np.sort([*range(500), *range(0, 500, 100), 7, 7]), np.repeat(np.arange(500), 2)):
        table = read_tables([write(tmp_path, text_of(rows[twice, 0], rows[twice, 1:]))])
        np.testing.assert_array_equal(table.rows[:, :4], rows)
        assert "tables.copies" in keys(table.assumptions)


def test_a_clock_that_stands_for_a_second_is_one_that_goes_on(tmp_path: Path) -> None:
    time_s = 1e-2 * np.arange(2000)
    stamps_s = np.where((time_s >= 5) & (time_s < 6), 5.0, np.floor(time_s / 0.02 + 1e-9) * 0.02)
    path = write(tmp_path, text_of(stamps_s, np.random.default_rng(1).normal(size=(2000, 3))))
    found_s = read_tables([path]).rows[:, 0]
    np.testing.assert_allclose(found_s, time_s, atol=0.02)
    assert 0.005 < np.diff(found_s).min() < np.diff(found_s).max() < 0.015


@pytest.mark.parametrize("stood", [3, 50])
@pytest.mark.parametrize("tick_s", [0.01, 0.016])
def test_a_clock_that_stands_and_does_not_catch_up_hides_no_time(tmp_path: Path, tick_s: float, stood: int) -> None:
    time_s = np.floor(1e-2 * np.arange(1000) / tick_s + 1e-9) * tick_s
    stamps_s = np.concatenate([time_s[:500], np.full(stood, time_s[500]), time_s[500:]])
    values = np.random.default_rng(1).normal(size=(len(stamps_s), 3))
    found_s = read_tables([write(tmp_path, text_of(stamps_s, values))]).rows[:, 0]
    # Equal times are what a move stops at.
    assert np.count_nonzero(np.diff(found_s) == 0) >= stood
    frozen = values.copy()
    frozen[500 : 500 + stood] = values[500]
    assert len(read_tables([write(tmp_path, text_of(stamps_s, frozen))]).rows) == len(stamps_s)


@pytest.mark.parametrize("sd_s", [0.002, 0.016])
def test_bursts_that_are_stamped_by_their_arrival_are_left_to_the_decoder(tmp_path: Path, sd_s: float) -> None:
    rng = np.random.default_rng(1)
    arrival_s = np.cumsum(np.clip(0.04 + sd_s * rng.normal(size=500), 0.015, 0.07))
    stamps_s = np.round(arrival_s[np.searchsorted(arrival_s, 1e-2 * np.arange(1900))], 4)
    table = read_tables([write(tmp_path, text_of(stamps_s, rng.normal(size=(1900, 3))))])
    np.testing.assert_array_equal(table.rows[:, 0], stamps_s)


@pytest.mark.parametrize("name", ["rows.npz", "rows.csv"])
def test_the_times_of_a_stream_stay_as_they_are(tmp_path: Path, name: str) -> None:
    stamps_s = np.repeat(np.arange(250) / 50, 2)
    values = np.random.default_rng(1).normal(size=(500, 3))
    path = tmp_path / name
    if path.suffix == ".npz":
        np.savez(path, time=stamps_s, ax=values[:, 0], ay=values[:, 1], az=values[:, 2])
    else:
        path.write_text(text_of(stamps_s, values))
    np.testing.assert_array_equal(np.concatenate([table.rows[:, 0] for table in stream_table(path)]), stamps_s)


def arrivals(of: int) -> np.ndarray:
    """Return when rows of 100 Hz arrive that are handed over so many at once, 30 us apart, s."""
    row = np.arange(2000)
    return 0.01 * of * (row // of + 1) + 3e-5 * (row % of)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("rate_hz", [None, 100.0])
def test_dates_have_the_unit_in_which_they_are_of_this_century(tmp_path: Path, unit: str, rate_hz: float | None) -> None:
    time_s = 1.7e9 + np.arange(2000) / 100
    values = np.random.default_rng(1).normal(size=(2000, 3))
    table = read_tables([write(tmp_path, text_of(time_s / SECONDS[unit], values))], rate_hz=rate_hz)
    np.testing.assert_allclose(table.rows[:, 0], time_s, rtol=1e-15)
    (found,) = told(table.assumptions, "table_columns.dates")
    assert (found.values["unit"], str(found.values["day"])) == (unit, "2023-11-14")


@pytest.mark.parametrize(("up_s", "unit"), [(1000.0, "us"), (1000.0, "ns"), (1e6, "ms")])
def test_what_counts_from_the_start_of_an_instrument_is_no_date(tmp_path: Path, up_s: float, unit: str) -> None:
    time_s = up_s + np.arange(2000) / 100
    table = read_tables([write(tmp_path, text_of(time_s / SECONDS[unit], np.random.default_rng(1).normal(size=(2000, 3))))])
    np.testing.assert_allclose(table.rows[:, 0], time_s, rtol=1e-12)
    assert "table_columns.dates" not in keys(table.assumptions)


@pytest.mark.parametrize("start_s", [12.3, 1.7e9])
@pytest.mark.parametrize(("rate_hz", "unit"), [(None, None), (100.0, None), (None, "us")])
def test_times_of_arrival_in_bursts_are_refused(
    tmp_path: Path, start_s: float, rate_hz: float | None, unit: str | None
) -> None:
    path = write(tmp_path, text_of(1e6 * (start_s + arrivals(of=5)), np.random.default_rng(1).normal(size=(2000, 3))))
    with refused(UsageError, Reason.USAGE, "--columns", "--rate-hz", key="table_columns.bursts") as caught:
        read_tables([path], rate_hz=rate_hz, settings={"time_unit": unit} if unit else None)
    assert caught.value.values["rate_hz"] == pytest.approx(100, rel=0.01)
    read_tables([path], columns="-,ax,ay,az", rate_hz=100)
    # Whoever corrects rows needs no times.
    assert sum(len(table.rows) for table in stream_table(path)) == 2000


def test_the_second_of_two_files_may_not_come_in_bursts_either(tmp_path: Path) -> None:
    values = np.random.default_rng(1).normal(size=(2000, 3))
    even, bursts = tmp_path / "even", tmp_path / "bursts"
    for folder in (even, bursts):
        folder.mkdir()
    first = write(even, text_of(0.01 * np.arange(2000), values))
    second = write(bursts, "time (s),gx (rad/s),gy (rad/s),gz (rad/s)\n" + text_of(arrivals(of=5), values))
    with refused(UsageError, Reason.USAGE, str(second), key="table_columns.bursts"):
        read_tables([first, second])


def test_losses_of_a_fast_instrument_are_no_bursts(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    time_s = (np.arange(8000) / 4400)[rng.random(8000) > 0.15]
    table = read_tables([write(tmp_path, text_of(time_s, rng.normal(size=(len(time_s), 3))))], rate_hz=4400)
    assert len(table.rows) == len(time_s)


def test_pauses_are_no_bursts(tmp_path: Path) -> None:
    time_us = 1e4 * np.arange(2000) + 6e8 * (np.arange(2000) // 200)
    table = read_tables([write(tmp_path, text_of(time_us, np.random.default_rng(1).normal(size=(2000, 3))))])
    np.testing.assert_allclose(table.rows[:, 0], 1e-6 * time_us)


def test_a_stated_unit_of_time_that_no_instrument_has_is_told(tmp_path: Path) -> None:
    path = write(tmp_path, text_of(TIME, ACCELEROMETER))
    (found,) = told(read_tables([path], settings={"time_unit": "us"}).assumptions, "table_columns.implausible")
    assert found.values["likely"] == "s"
    assert "table_columns.implausible" not in keys(read_tables([path], settings={"time_unit": "s"}).assumptions)


def test_thousandths_are_understood(tmp_path: Path) -> None:
    header = "time,ax_mg,ay_mg,az_mg,gx_mdps,gy_mdps,gz_mdps\n"
    path = write(tmp_path, text_of(TIME, 1e3 * ACCELEROMETER, 1e3 * GYROSCOPE, header=header, delimiter=","))
    table = read_tables([path])
    np.testing.assert_allclose(table.rows[:, 1:7], np.column_stack([ACCELEROMETER, GYROSCOPE]), rtol=1e-9, atol=1e-12)
    assert (table.settings["accelerometer_unit"], table.settings["gyroscope_unit"]) == ("g", "deg/s")


WIDE = np.column_stack([TIME, ACCELEROMETER, GYROSCOPE])


@pytest.mark.parametrize(
    ("delimiter", "decimal", "quoted"),
    [(",", ".", True), (";", ",", True), (";", ",", False), ("\t", ",", False), ("\t", ",", True), ("\t", ".", False)],
)
def test_cells_as_spreadsheets_write_them(tmp_path: Path, delimiter: str, decimal: str, quoted: bool) -> None:
    names = ["time", "ax", "ay", "az", "gx", "gy", "gz"]
    rows = [names, *([f"{value:.6f}".replace(".", decimal) for value in row] for row in WIDE.tolist())]
    mark = '"' if quoted else ""
    path = write(tmp_path, "\n".join(delimiter.join(f"{mark}{cell}{mark}" for cell in row) for row in rows))
    np.testing.assert_allclose(read_tables([path], settings={"accelerometer_unit": "g"}).rows[:, :7], WIDE, atol=1e-6)


def test_decimal_commas_between_commas_are_refused(tmp_path: Path) -> None:
    rows = "\n".join(",".join(f'"{value:.6f}"'.replace(".", ",") for value in row) for row in WIDE.tolist())
    path = write(tmp_path, f"time,ax,ay,az,gx,gy,gz\n{rows}\n")
    # It may be one of thousands as well.
    with refused(RecordingError, Reason.BAD_DATA):
        read_tables([path])


@pytest.mark.parametrize(
    ("delimiter", "notes"),
    [
        (",", ["", '"pause, long"', "x"]),
        (",", ['"pause, long"', "", ""]),
        ("\t", ["", "long pause", "x"]),
        ("\t", ["long pause", "", "two words"]),
        (",", ["#ff0000", "#00ff00", "blue"]),
        (";", ['"a;b"', "", "c"]),
    ],
)
def test_words_in_a_column_that_is_skipped_shift_nothing(tmp_path: Path, delimiter: str, notes: list[str]) -> None:
    rows = [[f"{value:.6f}" for value in row[:4]] for row in WIDE.tolist()]
    lines = [delimiter.join([*row[:2], notes[number % 3], *row[2:]]) for number, row in enumerate(rows)]
    if "#" in notes[0]:  # Behind a mark of comments no cell is read.
        lines = [delimiter.join([*row, notes[number % 3]]) for number, row in enumerate(rows)]
    names = ["time", "ax", "ay", "az"] if "#" in notes[0] else ["time", "ax", "note", "ay", "az"]
    path = write(tmp_path, "\n".join([delimiter.join([*names, *["note"] * ("#" in notes[0])]), *lines, ""]))
    table = read_tables([path], settings={"accelerometer_unit": "g"})
    np.testing.assert_allclose(table.rows[:, :4], WIDE[:, :4], atol=1e-6)


NAMES = "time,ax,ay,az"


@pytest.mark.parametrize(
    ("lines", "columns"),
    [
        pytest.param([NAMES, "{} # start, of run", "{}", "{}"], None, id="a comment behind the first row"),
        pytest.param([NAMES, "{}", "{},", "{}"], None, id="a delimiter behind some rows"),
        pytest.param([NAMES + ",note", "{},a", "{},b,", "{},c"], None, id="a delimiter behind rows with a column skipped"),
        pytest.param(['"0","1","2","3"', "{}", "{}", "{}"], NAMES, id="numbers as names"),
    ],
)
def test_rows_that_end_in_other_ways(tmp_path: Path, lines: list[str], columns: str | None) -> None:
    rows = iter(",".join(f"{value:.6f}" for value in row[:4]) for row in WIDE.tolist())
    path = write(tmp_path, "\n".join(line.replace("{}", next(rows)) if "{}" in line else line for line in lines))
    if lines[2] == "{},":
        # Where all columns are used, the parser sees it.
        with refused(RecordingError, Reason.BAD_DATA, key="table_text.other_width"):
            read_tables([path], columns=columns)
        return
    table = read_tables([path], columns=columns, settings={"accelerometer_unit": "g"})
    np.testing.assert_allclose(table.rows[:, :4], WIDE[:3, :4], atol=1e-6)


@pytest.mark.parametrize("row", ["0.00\t33,540\t36,552\t34,057", "3,114\t15,264\t1,889\t2,313", '0,00\t"33,540,1"\t1,1\t2,2'])
def test_commas_of_thousands_are_no_decimal_ones(tmp_path: Path, row: str) -> None:
    path = write(tmp_path, f"time\tax\tay\taz\n{row}\n{row}\n")
    with pytest.raises((RecordingError, UsageError)):
        read_tables([path], rate_hz=100)


def test_a_tab_behind_each_row_is_no_column(tmp_path: Path) -> None:
    rows = "".join("\t".join(f"{value:.6f}" for value in row[:4]) + "\t\n" for row in WIDE.tolist())
    for header in ("time\tax\tay\taz\n", "time\tax\tay\taz\t\n"):
        table = read_tables([write(tmp_path, header + rows)], settings={"accelerometer_unit": "g"})
        np.testing.assert_allclose(table.rows[:, :4], WIDE[:, :4], atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_units_with_signs_in_any_usual_encoding(tmp_path: Path, encoding: str) -> None:
    header = "time [µs],ax [m/s²],ay [m/s²],az [m/s²],gx [°/s],gy [°/s],gz [°/s],temp [°C]\n"
    path = tmp_path / "table.csv"
    path.write_bytes(text_of(TIME * 1e6, ACCELEROMETER, GYROSCOPE, TIME, delimiter=",", header=header).encode(encoding))
    table = read_tables([path])
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "deg/s"}
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-9)
    assert table.assumptions == ()


@pytest.mark.parametrize("mark", ["", "# "])
@pytest.mark.parametrize(
    ("unit_a", "unit_temperature", "key"),
    [
        ("fur/long\x1b[2J", "degC", "table_columns.unknown_unit"),
        ("rad/s", "degC", "table_columns.unknown_unit"),
        ("m/s^2", "°R", "table_columns.unknown_temperature_unit"),
    ],
)
def test_a_unit_that_is_none_is_refused(tmp_path: Path, mark: str, unit_a: str, unit_temperature: str, key: str) -> None:
    header = f"{mark}time_s,acc_x ({unit_a}),acc_y ({unit_a}),acc_z ({unit_a}),temp ({unit_temperature})\n"
    path = write(tmp_path, text_of(TIME, ACCELEROMETER, TIME, delimiter=",", header=header))
    with refused(UsageError, Reason.UNITS, key=key) as caught:
        read_tables([path])
    assert "\x1b" not in caught.value.message


def test_words_in_the_place_of_units_are_said_and_ignored(tmp_path: Path) -> None:
    header = "time (UTC),acc_x (forward),acc_y (left),acc_z (up),temp (IMU)\n"
    table = read_tables([write(tmp_path, text_of(TIME, ACCELEROMETER, TIME, delimiter=",", header=header))])
    assert np.array_equal(table.rows[:, 1:4], ACCELEROMETER)
    (said,) = told(table.assumptions, "table_columns.no_units")
    assert said.values["words"] == ["UTC", "forward", "left", "up", "IMU"]


@pytest.mark.parametrize(
    ("unit", "kept", "factor"), [("mg", "g", 1e-3), ("ft/s^2", "m/s^2", 0.3048), ("g", "g", 1.0), ("m/sec^2", "m/s^2", 1.0)]
)
def test_a_unit_that_is_given_is_converted_as_a_stated_one(tmp_path: Path, unit: str, kept: str, factor: float) -> None:
    header = "time_s,acc_x (m/h),acc_y (m/h),acc_z (m/h)\n"
    path = write(tmp_path, text_of(TIME, ACCELEROMETER, delimiter=",", header=header))
    table = read_tables([path], settings={"accelerometer_unit": unit})
    assert table.settings["accelerometer_unit"] == kept
    np.testing.assert_allclose(table.rows[:, 1:4], factor * ACCELEROMETER, rtol=1e-12)


def test_signs_stand_in_names_without_brackets(tmp_path: Path) -> None:
    header = (
        "Time \u03bcs," + ",".join(f"Acc {axis} m/s²" for axis in "XYZ") + "," + ",".join(f"Gyro {axis} °/s" for axis in "XYZ")
    )
    path = write(tmp_path, text_of(TIME * 1e6, ACCELEROMETER, GYROSCOPE, delimiter=",", header=header + "\n"))
    table = read_tables([path])
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "deg/s"}
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-9)


def test_the_heading_of_euroc_data_sets_is_known(tmp_path: Path) -> None:
    header = "#timestamp [ns]," + ",".join(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz")
    header += "," + ",".join(f"a_RS_S_{axis} [m s^-2]" for axis in "xyz") + "\n"
    table = read_tables([write(tmp_path, text_of(TIME * 1e9, GYROSCOPE, ACCELEROMETER, delimiter=",", header=header))])
    np.testing.assert_array_equal(table.rows[:, 1:7], np.column_stack([ACCELEROMETER, GYROSCOPE]))
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-9)
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s"}


@pytest.mark.parametrize(
    ("unit", "kept", "factor"),
    [
        ("deg/sec", "deg/s", 1.0),
        ("º/s", "deg/s", 1.0),
        ("rad/sec", "rad/s", 1.0),
        ("mrad/s", "rad/s", 1e-3),
        ("mdps", "deg/s", 1e-3),
        ("deg/h", "rad/s", np.pi / 648_000),
    ],
)
def test_a_stated_unit_is_taken_at_its_word(tmp_path: Path, unit: str, kept: str, factor: float) -> None:
    header = f"time [min],ax [g],ay [g],az [g],gx ({unit}),gy ({unit}),gz ({unit}),Temp (°F)\n"
    columns = (TIME / 60, ACCELEROMETER, GYROSCOPE, 1.8 * (TIME + 20) + 32)
    table = read_tables([write(tmp_path, text_of(*columns, delimiter=",", header=header))])
    assert table.settings["gyroscope_unit"] == kept
    np.testing.assert_allclose(table.rows[:, 4:7], factor * GYROSCOPE, rtol=1e-12)
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-9)
    np.testing.assert_allclose(table.rows[:, 7], TIME + 20, rtol=1e-9)


@pytest.mark.parametrize("bits", [12, 16, 20])
@pytest.mark.parametrize("triad", ["accelerometer", "gyroscope"])
def test_twos_complement_without_its_sign_is_named(tmp_path: Path, bits: int, triad: str) -> None:
    rng = np.random.default_rng(bits)
    up = rng.standard_normal((500, 3))
    sizes = {"accelerometer": up / np.linalg.norm(up, axis=1)[:, None] / 4, "gyroscope": rng.normal(0, 0.05, (500, 3))}
    codes, others = np.rint(sizes[triad] * (1 << bits)), np.full((500, 3), 5.7)
    at_rest = np.array([3.0, 5.0, 2.0 ** (bits - 1) - 24]) + rng.integers(0, 3, (500, 3))
    damaged = at_rest.copy()
    damaged[[100, 300]] = 2.0**bits - 1
    faces = np.rint(1650 + 800 * np.eye(3)[rng.integers(0, 3, 500)])
    # With its sign, about mid-scale, in mg at rest, also with damage, and of a sensor that keeps off the middle.
    for values in (codes, codes + (1 << bits - 1), at_rest, damaged, faces):
        shown = [values, others] if triad == "accelerometer" else [others, values]
        read_tables([write(tmp_path, text_of(np.arange(500) / 100, *shown))])
    lost = codes % (1 << bits)
    path = write(tmp_path, text_of(np.arange(500) / 100, *([lost, others] if triad == "accelerometer" else [others, lost])))
    with refused(RecordingError, Reason.BAD_DATA, str(path), triad, str(1 << bits), key="table_columns.unsigned"):
        read_tables([path])
    with refused(RecordingError, Reason.BAD_DATA, key="table_columns.unsigned"):
        next(stream_table(path))
    # In a unit they are no codes.
    read_tables([path], settings={f"{triad}_unit": {"accelerometer": "mg", "gyroscope": "deg/s"}[triad]})
