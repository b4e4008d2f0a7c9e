"""Several files of one recording, joined by their times or by their rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imufield.acquire.formats.tables import ImportedTable, read_tables
from imufield.errors import Reason, UsageError
from imufield.sentences import Sentence
from tests.acquire.table_files import ACCELEROMETER, GYROSCOPE, TIME, N, text_of, write
from tests.refused import refused


def keys_of(table: ImportedTable) -> set[str]:
    return {sentence.key for sentence in table.assumptions if isinstance(sentence, Sentence)}


def test_two_files_with_the_same_times_are_joined_as_they_are(tmp_path: Path) -> None:
    paths = [write(tmp_path, text_of(TIME, ACCELEROMETER), "a.txt"), write(tmp_path, text_of(TIME, GYROSCOPE), "g.txt")]
    table = read_tables(paths)
    assert np.array_equal(table.rows[:, :7], np.column_stack([TIME, ACCELEROMETER, GYROSCOPE]))
    assert "table_join.interpolated" not in keys_of(table)


def test_files_with_other_times_are_interpolated_and_their_ends_left_out(tmp_path: Path) -> None:
    other = np.arange(60) * 0.007 + 0.0334
    line = np.column_stack([2.0 * other, -other, 5.0 + other])
    paths = [write(tmp_path, text_of(TIME, ACCELEROMETER), "a.txt"), write(tmp_path, text_of(other, line), "g.txt")]
    table = read_tables(paths)
    time = table.rows[:, 0]
    assert np.array_equal(time, TIME[(TIME >= 0.0334 - 0.0035) & (other[-1] + 0.0035 >= TIME)])
    inside = (time >= other[0]) & (time <= other[-1])
    expected = np.column_stack([2.0 * time, -time, 5.0 + time])
    np.testing.assert_allclose(table.rows[inside, 4:7], expected[inside], atol=1e-12)
    assert {"table_join.interpolated", "table_join.left_out"} <= keys_of(table)


def test_nothing_is_interpolated_across_a_gap(tmp_path: Path) -> None:
    other = np.delete(TIME + 0.004, slice(20, 30))
    paths = [write(tmp_path, text_of(TIME, ACCELEROMETER), "a.txt")]
    paths.append(write(tmp_path, text_of(other, GYROSCOPE[:40]), "g.txt"))
    kept = np.rint(read_tables(paths).rows[:, 0] * 100.0).astype(int).tolist()
    # Row 20 is 6 ms behind the last sample before the gap, row 30 is 4 ms before the first one after it.
    assert kept == [*range(20), *range(30, 50)]


def test_a_second_temperature_is_ignored_aloud(tmp_path: Path) -> None:
    header = "timestamp,timestamp_sample,device_id,x,y,z,temperature,error_count\n"
    paths = []
    for name, values, degc in (("sensor_accel", ACCELEROMETER, 41.2), ("sensor_gyro", GYROSCOPE, 40.9)):
        columns = [TIME * 1e6 + 400, TIME * 1e6, np.full(N, 7), values, np.full(N, degc), np.zeros(N)]
        paths.append(write(tmp_path, text_of(*columns, delimiter=",", header=header), f"log_12_{name}_0.csv"))
    table = read_tables(paths)
    np.testing.assert_allclose(table.rows, np.column_stack([TIME, ACCELEROMETER, GYROSCOPE, np.full(N, 41.2)]))
    assert "table_join.second_temperature" in keys_of(table)
    with refused(UsageError, Reason.USAGE, "ax", key="table_join.doubled"):
        read_tables([paths[0], paths[0]])


def test_files_that_share_no_time_are_refused(tmp_path: Path) -> None:
    paths = [write(tmp_path, text_of(TIME, ACCELEROMETER), "a.txt"), write(tmp_path, text_of(TIME + 5.0, GYROSCOPE), "g.txt")]
    with refused(UsageError, Reason.USAGE, "a.txt", "g.txt", "0.49 s"):
        read_tables(paths)


def test_files_without_time_must_have_the_same_rows(tmp_path: Path) -> None:
    paths = [write(tmp_path, text_of(ACCELEROMETER), "a.txt"), write(tmp_path, text_of(GYROSCOPE), "g.txt")]
    table = read_tables(paths, rate_hz=100.0)
    assert np.array_equal(table.rows[:, 1:7], np.column_stack([ACCELEROMETER, GYROSCOPE]))
    paths.append(write(tmp_path, text_of(GYROSCOPE[:7], header="temp -x- gx\n"), "t.txt"))
    with refused(UsageError, Reason.USAGE, "t.txt") as caught:
        read_tables(paths, rate_hz=100.0)
    assert caught.value.values["missing"] == ["gy", "gz"]
    paths[1] = write(tmp_path, text_of(GYROSCOPE[:7]), "g.txt")
    with refused(UsageError, Reason.USAGE, "a.txt", "g.txt") as caught:
        read_tables(paths[:2], rate_hz=100.0)
    assert caught.value.values["rows"] == [N, 7]


def test_the_same_quantity_twice_is_refused(tmp_path: Path) -> None:
    header = "t ax ay az\n"
    paths = [write(tmp_path, text_of(TIME, ACCELEROMETER, header=header), name) for name in ("a.txt", "b.txt")]
    with refused(UsageError, Reason.USAGE, "b.txt", "ax, ay, az"):
        read_tables(paths)
