import csv
import dataclasses
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats import table_text
from imufield.acquire.formats.tables import read_tables
from imufield.acquire.protocol.protocol import load_protocol
from imufield.commands.import_files import import_session
from imufield.commands.options.acquire_commands import ImportOptions
from imufield.deliver.samples.export_csv import refuse_foreign_file
from imufield.deliver.samples.export_data import FORMATS, export_csv, export_samples, facts_of
from imufield.errors import Reason, RecordingError, UsageError
from imufield.pipeline.chain import session_samples
from imufield.samples import SAMPLE_COLUMNS, Samples, SampleUnits, Status, concatenate, make_samples
from tests.acquire.formats.conftest import fork_readers
from tests.refused import refused


@pytest.fixture(autouse=True)
def forked_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    fork_readers(monkeypatch)


def block(n: int, start: int = 0) -> Samples:
    rng = np.random.default_rng(start)
    status = np.zeros(n, dtype=np.uint32)
    status[1] = np.uint32(Status.ACCELEROMETER_SATURATED | Status.AFTER_GAP | 3 << 16)
    return make_samples(
        np.arange(start, start + n) / 3.0,
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3)) * 1e-9,
        units=SampleUnits(),
        temperature_degc=np.where(np.arange(n) % 10 == 0, 25.5, np.nan),
        counter=np.arange(n) % 256,
        status=status,
    )


def read_back(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, rows


def test_every_number_reads_back_to_the_last_bit(tmp_path: Path) -> None:
    blocks = [block(20_000), block(5, 20_000)]
    path = tmp_path / "out.csv"
    assert export_csv(iter(blocks), path) == 20_005
    header, rows = read_back(path)
    assert header == list(SAMPLE_COLUMNS)
    assert len(rows) == 20_005
    expected = np.concatenate([np.column_stack([b.time_s, b.accelerometer, b.gyroscope]) for b in blocks])
    assert np.array_equal(np.array([row[:7] for row in rows], dtype=np.float64), expected)
    assert [row[7] for row in rows[:11]] == ["25.5"] + [""] * 9 + ["25.5"]
    assert rows[300][8:] == ["44", "0"]
    assert rows[1][9] == str(4 | 32 | 3 << 16)


def test_what_is_not_available_is_empty(tmp_path: Path) -> None:
    samples = make_samples(np.array([0.5]), np.array([[1.0, 2.0, np.inf]]), units=SampleUnits())
    export_csv([samples], tmp_path / "out.csv")
    assert read_back(tmp_path / "out.csv")[1] == [["0.5", "1.0", "2.0", "inf", "", "", "", "", "", "0"]]


def test_no_samples_give_a_header(tmp_path: Path) -> None:
    assert export_csv([], tmp_path / "out.csv") == 0
    assert (tmp_path / "out.csv").read_text() == ",".join(SAMPLE_COLUMNS) + "\n"


def test_an_export_can_be_imported_again(tmp_path: Path) -> None:
    samples = block(200)
    export_csv([samples], tmp_path / "out.csv")
    table = read_tables([tmp_path / "out.csv"])
    rows = table.rows
    assert np.array_equal(rows[:, 0], samples.time_s)
    assert np.array_equal(rows[:, 1:4], samples.accelerometer)
    assert np.array_equal(rows[:, 7], samples.temperature_degc, equal_nan=True)


def gapped(n: int) -> Samples:
    """Return samples, some of them without a value."""
    samples = block(n)
    gaps = np.arange(n) % 100 == 7
    force = np.where(gaps[:, None], np.nan, samples.accelerometer)
    status = np.where(gaps, np.uint32(Status.ACCELEROMETER_INVALID), samples.status)
    return dataclasses.replace(samples, accelerometer=force, status=status)


@pytest.mark.parametrize("to", ["csv", "parquet", "hdf5", "ros2"])
def test_every_format_can_be_imported_again(tmp_path: Path, to: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip({"csv": "numpy", "parquet": "pyarrow", "hdf5": "h5py", "ros2": "rosbags"}[to])
    # More than is written, read and recorded at once, of which the first two are less than usual.
    monkeypatch.setitem(FORMATS, to, dataclasses.replace(FORMATS[to], rows=4096))
    monkeypatch.setattr(table_text, "BLOCK_BYTES", 1 << 19)
    samples = gapped(20_000)
    path = tmp_path / f"out.{FORMATS[to].suffix}"
    facts = facts_of(load_protocol("rows_f64"), np.array([0.5, 0.0, -0.5]))
    assert export_samples((samples[at : at + 700] for at in range(0, len(samples), 700)), path, to, facts) == len(samples)
    refuse_foreign_file(path)  # It may be written over.
    options = ImportOptions(
        files=[path], output=tmp_path / "session", settings={"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s"}
    )
    session, _ = import_session(options)
    again = concatenate(session_samples(session, []))
    force, rate = samples.accelerometer, samples.gyroscope
    if to == "ros2":
        # What is not usable must not become good where there are no flags.
        of_both = Status.START_UP | Status.INSTRUMENT_FAULT
        no_force = (samples.status & (of_both | Status.ACCELEROMETER_INVALID | Status.ACCELEROMETER_SATURATED)) != 0
        no_rate = (samples.status & (of_both | Status.GYROSCOPE_INVALID | Status.GYROSCOPE_SATURATED)) != 0
        force, rate = np.where(no_force[:, None], np.nan, force), np.where(no_rate[:, None], np.nan, rate)
    np.testing.assert_array_equal(again.accelerometer, force)
    np.testing.assert_array_equal(again.gyroscope, rate)
    if to == "ros2":
        # Stamps of ROS are whole nanoseconds; it has neither temperature nor our flags, only "not available".
        np.testing.assert_allclose(again.time_s, samples.time_s, atol=0.6e-9)
        wanted = no_force * np.uint32(Status.ACCELEROMETER_INVALID) | no_rate * np.uint32(Status.GYROSCOPE_INVALID)
    else:
        np.testing.assert_array_equal(again.time_s, samples.time_s)
        np.testing.assert_array_equal(again.temperature_degc, samples.temperature_degc)
        wanted = samples.status
    np.testing.assert_array_equal(again.status, wanted)
    if to in ("parquet", "hdf5"):
        assert session.metadata["nominal"]["raw_zero"] == [0.5, 0.0, -0.5]


@pytest.mark.parametrize("to", ["parquet", "hdf5"])
def test_increments_stay_increments(tmp_path: Path, to: str) -> None:
    pytest.importorskip({"parquet": "pyarrow", "hdf5": "h5py"}[to])
    protocol = load_protocol(
        "rows_f64", {"accelerometer_unit": "pulse", "gyroscope_unit": "pulse", "increments": True, "rate_hz": 3}
    )
    path = tmp_path / "out"
    export_samples([dataclasses.replace(block(500), units=protocol.units)], path, to, facts_of(protocol, np.zeros(3)))
    session, _ = import_session(ImportOptions(files=[path], output=tmp_path / "session"))
    assert concatenate(session_samples(session, [])).units == protocol.units


def test_others_read_what_is_written(tmp_path: Path) -> None:
    h5py, parquet = pytest.importorskip("h5py"), pytest.importorskip("pyarrow.parquet")
    samples = gapped(1000)
    for to in ("parquet", "hdf5"):
        export_samples([samples], tmp_path / to, to, facts_of(load_protocol("rows_f64"), np.zeros(3)))
    table = parquet.read_table(tmp_path / "parquet")
    assert table.column_names == list(SAMPLE_COLUMNS)
    assert table.column("ax").null_count == 10
    assert table.column("status").to_pylist() == samples.status.tolist()
    assert table.schema.metadata[b"imufield_accelerometer_unit"] == b"m/s^2"
    with h5py.File(tmp_path / "hdf5") as file:
        assert set(file) == set(SAMPLE_COLUMNS)
        np.testing.assert_array_equal(file["gy"][:], samples.gyroscope[:, 1])
        assert file.attrs["imufield_gyroscope_unit"] == "rad/s"


def test_ros_reads_what_is_written(tmp_path: Path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel")
    samples = gapped(1000)
    export_samples([samples], tmp_path / "out.mcap", "ros2")
    with highlevel.AnyReader([tmp_path / "out.mcap"]) as reader:
        (connection,) = reader.connections
        assert (connection.topic, connection.msgtype) == ("/imu/data_raw", "sensor_msgs/msg/Imu")
        found = [(at, reader.deserialize(raw, connection.msgtype)) for _, at, raw in reader.messages()]
    assert len(found) == 1000
    at, message = found[4]
    assert at == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == 1_333_333_333
    assert message.header.frame_id == "imu"
    assert (message.angular_velocity.x, message.angular_velocity.z) == (samples.gyroscope[4, 0], samples.gyroscope[4, 2])
    assert message.linear_acceleration.y == samples.accelerometer[4, 1]
    assert message.orientation_covariance[0] == -1
    assert message.linear_acceleration_covariance[0] == 0
    assert found[7][1].linear_acceleration_covariance[0] == -1


def test_what_is_not_usable_does_not_become_good_by_ros(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    flags = [Status.START_UP, Status.INSTRUMENT_FAULT, Status.ACCELEROMETER_SATURATED, Status.GYROSCOPE_SATURATED]
    samples = block(500)
    status = samples.status.copy()
    status[10 : 10 + len(flags)] = flags
    path = tmp_path / "out.mcap"
    export_samples([dataclasses.replace(samples, status=status)], path, "ros2")
    session, _ = import_session(ImportOptions(files=[path], output=tmp_path / "session"))
    again = concatenate(session_samples(session, []))
    assert not again.usable[10:14].any()
    no_force = (again.status[10:14] & Status.ACCELEROMETER_INVALID) != 0
    no_rate = (again.status[10:14] & Status.GYROSCOPE_INVALID) != 0
    assert (no_force.tolist(), no_rate.tolist()) == ([True, True, True, False], [True, True, False, True])
    assert np.isnan(again.accelerometer[10:13]).all()
    assert np.isfinite(again.accelerometer[13]).all()


def test_what_ros_cannot_hold(tmp_path: Path) -> None:
    counts = dataclasses.replace(block(10), units=SampleUnits(accelerometer="count", gyroscope="count"))
    with refused(UsageError, Reason.UNITS, "m/s^2", "rad/s", "count", key="export_ros2.units"):
        export_samples([counts], tmp_path / "out.mcap", "ros2")
    early = dataclasses.replace(block(10), time_s=np.arange(-5.0, 5.0))
    with refused(RecordingError, Reason.BOUNDS, "-5 s", "2147483647 s", key="export_ros2.stamp"):
        export_samples([early], tmp_path / "out.mcap", "ros2")
    assert list(tmp_path.iterdir()) == []


def test_an_error_in_the_middle_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")

    def blocks() -> Iterator[Samples]:
        yield block(10)
        raise RecordingError("damaged")

    with pytest.raises(RecordingError, match="damaged"):
        export_csv(blocks(), path)
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["out.csv"]


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with refused(RecordingError, Reason.FOREIGN, "out.csv") as caught:
        export_csv([block(10)], tmp_path / "missing" / "out.csv")
    assert caught.value.values["errno"] == errno.ENOENT


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX")
def test_others_may_read_it_as_far_as_the_umask_says(tmp_path: Path) -> None:
    export_csv([block(10)], tmp_path / "out.csv")
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((tmp_path / "out.csv").stat().st_mode) == 0o666 & ~mask
