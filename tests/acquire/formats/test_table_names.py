"""Headers as programs and instruments of others write them: which columns are taken, and in which unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.formats.table_file import meaning_of, open_source
from imufield.acquire.formats.table_names import named_column
from imufield.acquire.formats.tables import read_tables, stream_table
from imufield.errors import Reason, UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS
from tests.acquire.table_files import write
from tests.refused import refused
from tests.told import keys

A, G = ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS
T = ("time",)


def found(tmp_path: Path, header: str, name: str = "table.csv", row: str = "") -> tuple[list[tuple[int, str]], dict[str, str]]:
    """Return the columns that are used, by their place, and the units, of a table of two rows."""
    mark = next(mark for mark in ("\t", ";", ",") if mark in header)
    rows = [row or mark.join(str(number + 100 * line) for number in range(header.count(mark) + 1)) for line in (1, 2)]
    source = open_source(write(tmp_path, "\n".join([header, *rows, ""]), name), None)
    meaning = meaning_of(source, None, 0, 1)
    return [(column.index, column.field) for column in meaning.columns], meaning.units


@pytest.mark.parametrize(
    ("name", "field", "unit"),
    [
        ("ax", "ax", None),
        ("Acc X (m/s^2)", "ax", "m/s^2"),
        ("acc_y [g]", "ay", "g"),
        ("accel_z_m_s2", "az", "m/s^2"),
        ("accelX", "ax", None),
        ("AccelerometerY", "ay", None),
        ("xacc", "ax", None),
        ("field.linear_acceleration.x", "ax", None),
        ("imu_acceleration_z_mg", "az", "mg"),
        ("AcX", "ax", None),
        ("GyZ", "gz", None),
        ("Beschl. Y [g]", "ay", "g"),
        ("Drehrate X [°/s]", "gx", "deg/s"),
        ("gx", "gx", None),
        ("gy", "gy", None),
        ("wx", "gx", None),
        ("Gyr_Z", "gz", None),
        ("gyro_y_dps", "gy", "deg/s"),
        ("Gyro X (°/s)", "gx", "deg/s"),
        ("gyro_z_rad_s", "gz", "rad/s"),
        ("angular_velocity.x", "gx", None),
        ("xgyro", "gx", None),
        ("Rate Z (deg/s)", "gz", "deg/s"),
        ("t", "time", None),
        ("time_s", "time", "s"),
        ("Time (ms)", "time", "ms"),
        ("timestamp_us", "time", "us"),
        ("timeus", "time", "us"),
        ("TimeNS", "time", "ns"),
        ("timestamp [ns]", "time", "ns"),
        ("t_s", "time", "s"),
        ("temperature_degc", "temperature", "degC"),
        ("Temp (°C)", "temperature", "degC"),
        ("az_counts", "az", "count"),
        ("gz (LSB)", "gz", "count"),
        ("counter", None, None),
        ("status", None, None),
        ("mag_x", None, None),
        ("FreeAcc_X", None, None),
        ("quaternion_x", None, None),
        ("", None, None),
    ],
)
def test_column_names_are_understood(name: str, field: str | None, unit: str | None) -> None:
    column = named_column(name, 3)
    assert (column and (column.field, column.unit, column.index)) == (field and (field, unit, 3))


def test_a_long_heading_takes_no_longer_than_its_length() -> None:
    assert named_column("[" * 1_000_000, 3) is None
    assert named_column("acc_x [m/s^2" + "[" * 1_000_000 + "]", 3) == named_column("acc_x [m/s^2]", 3)


@pytest.mark.parametrize(
    ("header", "first", "fields", "units"),
    [
        pytest.param(
            "SensorId, TimeStamp (s), FrameNumber, AccX (g), AccY (g), AccZ (g), GyroX (deg/s), GyroY (deg/s), GyroZ (deg/s)",
            [1, 3, 4, 5, 6, 7, 8],
            T + A + G,
            {"time": "s", "accelerometer": "g", "gyroscope": "deg/s"},
            id="LP-Research",
        ),
        pytest.param(
            "timestamp,TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH",
            [0, 3, 4, 5, 6, 7, 8, 11],
            T + G + A + ("temperature",),
            {},
            id="mavlogdump",
        ),
        pytest.param(
            "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tFreeAcc_X\tFreeAcc_Y\tFreeAcc_Z\tGyr_X\tGyr_Y\tGyr_Z",
            [1, 2, 3, 4, 8, 9, 10],
            T + A + G,
            {"time": "SampleTimeFine"},
            id="MT Manager",
        ),
        pytest.param(
            "time,gFx,gFy,gFz,ax,ay,az,wx,wy,wz", [0, 1, 2, 3, 7, 8, 9], T + A + G, {}, id="Physics Toolbox, gravity in gF"
        ),
        pytest.param(
            "Time since start in ms ;ACCELEROMETER X (m/s²);ACCELEROMETER Y (m/s²);ACCELEROMETER Z (m/s²);"
            "LINEAR ACCELERATION X (m/s²);LINEAR ACCELERATION Y (m/s²);LINEAR ACCELERATION Z (m/s²);"
            "GYROSCOPE X (rad/s);GYROSCOPE Y (rad/s);GYROSCOPE Z (rad/s)",
            [0, 1, 2, 3, 7, 8, 9],
            T + A + G,
            {"time": "ms", "accelerometer": "m/s^2", "gyroscope": "rad/s"},
            id="AndroSensor",
        ),
        pytest.param("time,acc_x,acc_y,acc_z,rot_x,rot_y,rot_z,rot_w", [0, 1, 2, 3], T + A, {}, id="a quaternion"),
        pytest.param(
            "timestamp,raw_acc_x,raw_acc_y,raw_acc_z,user_acc_x,user_acc_y,user_acc_z,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z",
            [0, 7, 8, 9, 10, 11, 12],
            T + A + G,
            {},
            id="plain before qualified",
        ),
        pytest.param(
            "TimeStartup,AccX,AccY,AccZ,UnCompAccX,UnCompAccY,UnCompAccZ,GyroX,GyroY,GyroZ,UnCompGyroX,UnCompGyroY,UnCompGyroZ",
            [0, 1, 2, 3, 7, 8, 9],
            T + A + G,
            {},
            id="VectorNav",
        ),
        pytest.param(
            "epoc (ms),timestamp,elapsed (s),x-axis (g),y-axis (g),z-axis (g)",
            [1, 3, 4, 5],
            T + A,
            {"accelerometer": "g"},
            id="MetaBase",
        ),
        pytest.param(
            "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,accelerometer_m_s2[0],accelerometer_m_s2[1],"
            "accelerometer_m_s2[2],accelerometer_integral_dt",
            [0, 1, 2, 3, 5, 6, 7],
            T + G + A,
            {},
            id="ulog2csv",
        ),
        pytest.param(
            "time (us),gyroADC[0],gyroADC[1],gyroADC[2],accSmooth[0],accSmooth[1],accSmooth[2]",
            [*range(7)],
            T + G + A,
            {"time": "us"},
            id="Betaflight",
        ),
        pytest.param(
            '"cts","date","Accelerometer (z) [m/s2]","Accelerometer (x) [m/s2]","Accelerometer (y) [m/s2]","temperature [°C]"',
            [0, 2, 3, 4, 5],
            ("time", "az", "ax", "ay", "temperature"),
            {"accelerometer": "m/s^2", "temperature": "degC"},
            id="GoPro",
        ),
        pytest.param(
            "time,IMU_ATTI(0):accelX,IMU_ATTI(0):accelY,IMU_ATTI(0):accelZ,IMU_ATTI(0):gyroX,IMU_ATTI(0):gyroY,"
            "IMU_ATTI(0):gyroZ,IMU_ATTI(1):accelX,IMU_ATTI(1):accelY,IMU_ATTI(1):accelZ",
            [*range(7)],
            T + A + G,
            {},
            id="DJI, the one that has both",
        ),
        pytest.param(
            "Phone timestamp;sensor timestamp [ns];X [mg];Y [mg];Z [mg]",
            [1, 2, 3, 4],
            T + A,
            {"time": "ns", "accelerometer": "mg"},
            id="Polar",
        ),
        pytest.param(
            "Shimmer_8665_Timestamp_Unix_CAL,Shimmer_8665_Accel_LN_X_CAL,Shimmer_8665_Accel_LN_Y_CAL,Shimmer_8665_Accel_LN_Z_CAL,"
            "Shimmer_8665_Gyro_X_CAL,Shimmer_8665_Gyro_Y_CAL,Shimmer_8665_Gyro_Z_CAL",
            [*range(7)],
            T + A + G,
            {},
            id="Shimmer",
        ),
        pytest.param(
            "__time,/camera/imu/angular_velocity/x,/camera/imu/angular_velocity/y,/camera/imu/angular_velocity/z,"
            "/camera/imu/linear_acceleration/x,/camera/imu/linear_acceleration/y,/camera/imu/linear_acceleration/z",
            [*range(7)],
            T + G + A,
            {},
            id="PlotJuggler",
        ),
        pytest.param(
            "time,Acc1_X,Acc1_Y,Acc1_Z,Gyr1_X,Gyr1_Y,Gyr1_Z,Acc2_X,Acc2_Y,Acc2_Z",
            [*range(7)],
            T + A + G,
            {},
            id="two, by number",
        ),
        pytest.param(
            "millis,AccX(g),AccY(g),AccZ(g),AsX(°/s),AsY(°/s),AsZ(°/s),T(°C)",
            [*range(8)],
            T + A + G + ("temperature",),
            {"time": "ms", "accelerometer": "g", "gyroscope": "deg/s", "temperature": "degC"},
            id="WitMotion",
        ),
    ],
)
def test_headers_of_other_programs(
    tmp_path: Path, header: str, first: list[int], fields: tuple[str, ...], units: dict[str, str]
) -> None:
    assert found(tmp_path, header) == (list(zip(first, fields, strict=True)), units)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("TotalAcceleration.csv", (*T, "az", "ay", "ax")),
        ("Gyroscope.csv", (*T, "gz", "gy", "gx")),
        ("log_1_sensor_gyro_0.csv", (*T, "gz", "gy", "gx")),
    ],
)
def test_axes_without_a_name_are_of_what_the_file_is_named(tmp_path: Path, name: str, fields: tuple[str, ...]) -> None:
    assert found(tmp_path, "time,z,y,x", name)[0] == list(enumerate(fields))
    with refused(UsageError, Reason.USAGE, "among time, z, y, x", "ax_g", key="table_columns.no_triad"):
        found(tmp_path, "time,z,y,x", "accel_and_gyro.csv")


@pytest.mark.parametrize("named", ["SensorId", "I", "sensor", "device_id"])
@pytest.mark.parametrize("values", [("1", "2"), ("left", "right")])
def test_rows_of_several_instruments_are_no_table_of_one(tmp_path: Path, named: str, values: tuple[str, str]) -> None:
    lines = [f"time_s,{named},ax,ay,az", *(f"{row * 0.005},{values[row % 2]},0.1,0.2,{9.8 - row % 2}" for row in range(40))]
    path = write(tmp_path, "\n".join(lines) + "\n", "two.csv")
    with refused(UsageError, Reason.USAGE, *values, key="table_names.several_instruments") as caught:
        read_tables([path])
    assert caught.value.values["name"] == named
    # Whoever names the columns knows better.
    assert len(read_tables([path], columns="time_s,-,ax,ay,az").rows) == 40
    one = write(tmp_path, "\n".join([lines[0], *lines[1::2]]) + "\n", "one.csv")
    assert len(read_tables([one]).rows) == 20


@pytest.mark.parametrize(
    "numbers",
    [
        [*range(40)],
        [row // 20 for row in range(40)],
        [f"{0.1 * (row % 3):.1f}" for row in range(40)],
        ["A", *[""] * 39],
        [int(row == 7) for row in range(40)],
    ],
    ids=["of each row", "of positions", "measured", "a label", "a flag"],
)
def test_what_is_no_instrument(tmp_path: Path, numbers: list[object]) -> None:
    lines = ["i,time_s,ax,ay,az", *(f"{number},{row * 0.01},0.1,0.2,9.8" for row, number in enumerate(numbers))]
    assert len(read_tables([write(tmp_path, "\n".join(lines) + "\n")]).rows) == 40


def rows_of(tmp_path: Path, header: str, *times: str) -> tuple[int, list[str]]:
    """Return where the time stands, and which sentences are told, of rows with these cells before an accelerometer's."""
    path = write(tmp_path, "\n".join([f"{header},ax,ay,az", *(f"{cells},0.1,0.2,9.8" for cells in times)]) + "\n")
    meaning = meaning_of(open_source(path, None), None, 0, 1)
    return next(column.index for column in meaning.columns if column.field == "time"), keys(meaning.assumptions)


@pytest.mark.parametrize("header", ["%time,field.header.stamp", "timestamp,timestamp_sample", "__time,/imu/header/stamp"])
def test_the_time_of_measurement_goes_before_that_of_receipt(tmp_path: Path, header: str) -> None:
    place, told = rows_of(tmp_path, header, "1.03,1.01", "1.04,1.02", "1.05,1.03")
    assert (place, "table_columns.stamp" in told) == (1, True)


@pytest.mark.parametrize(
    ("header", "times"),
    [
        pytest.param("Time,header.stamp", ["1.03,0", "1.04,0", "1.05,0"], id="never set"),
        pytest.param("Time,header.stamp", ["1.03,1.02", "1.04,", "1.05,1.04"], id="with gaps"),
        pytest.param(
            "Time,header.stamp.secs,header.stamp.nsecs", ["1.03,0,0", "2.03,0,0", "3.03,0,0"], id="in parts, never set"
        ),
        pytest.param("Time,stamp_s,stamp_ns", ["1.03,1,", "1.04,2,x", "1.05,,7"], id="in parts, with gaps"),
        pytest.param("Time_us,stamp_s,stamp_ns", ["1,1,1000000000", "9,2,2000000000"], id="the same in another unit"),
    ],
)
def test_a_stamp_that_is_no_clock_is_left(tmp_path: Path, header: str, times: list[str]) -> None:
    place, told = rows_of(tmp_path, header, *times)
    assert (place, "table_columns.stamp" in told) == (0, False)


@pytest.mark.parametrize(
    ("header", "per_s"), [("header.stamp.sec,header.stamp.nanosec", 10**9), ("stamp_secs,stamp_usecs", 10**6)]
)
@pytest.mark.parametrize("first", ["", "Time,"])
def test_a_stamp_in_whole_seconds_and_their_fraction_is_one_time(tmp_path: Path, header: str, per_s: int, first: str) -> None:
    stamps = [f"{1690000000 + row // 100},{row % 100 * per_s // 100}" for row in range(250)]
    receipt = [f"{0.01 * row:.2f}," if first else "" for row in range(250)]
    lines = [f"{first}{header},ax,ay,az", *(f"{a}{b},0.1,0.2,9.8" for a, b in zip(receipt, stamps, strict=True))]
    path = write(tmp_path, "\n".join(lines) + "\n")
    for table in (read_tables([path]), *stream_table(path)):
        np.testing.assert_allclose(table.rows[:, 0] - table.rows[0, 0], 0.01 * np.arange(250), atol=1e-6)
        np.testing.assert_array_equal(table.rows[:, 1:4], np.tile([0.1, 0.2, 9.8], (250, 1)))


def test_a_time_that_reaches_a_second_is_no_fraction(tmp_path: Path) -> None:
    lines = ["time_s,time_us,ax,ay,az", *(f"{row // 500},{2000 * row},0.1,0.2,9.8" for row in range(2000))]
    rows = read_tables([write(tmp_path, "\n".join(lines) + "\n")]).rows
    np.testing.assert_allclose(np.diff(rows[:, 0]), 0.002, atol=1e-9)


def test_a_repeated_stamp_in_parts_is_read_where_there_is_no_other(tmp_path: Path) -> None:
    numbers = [*range(100), 99, *range(100, 250)]
    lines = [f"{1690000000 + row // 100},{row % 100 * 10**7},0.1,0.2,9.8" for row in numbers]
    heading = "header.stamp.sec,header.stamp.nanosec,ax,ay,az"
    rows = read_tables([write(tmp_path, "\n".join([heading, *lines]) + "\n")]).rows
    assert rows[-1, 0] - rows[0, 0] == pytest.approx(2.49, abs=1e-6)
    # Beside a time that goes on it is left.
    with_time = [f"{0.01 * row:.2f},{line}" for row, line in enumerate(lines)]
    path = write(tmp_path, "\n".join([f"Time,{heading}", *with_time]) + "\n")
    assert meaning_of(open_source(path, None), None, 0, 1).columns[0].index == 0


def test_a_stamp_in_an_array_that_was_never_set_is_left(tmp_path: Path) -> None:
    path = tmp_path / "imu.npz"
    time, still = np.arange(50) * 0.01, np.zeros(50)
    for stamp, place in ((still, 0), (time, 1)):
        np.savez(path, time=time + 0.002, header_stamp=stamp, acc=np.ones((50, 3)))
        assert meaning_of(open_source(path, None), None, 0, 1).columns[0].index == place


# What a column that is new here must not take from one that was understood before.
@pytest.mark.parametrize(
    ("header", "name", "first"),
    [
        ("time,bias/acc_x,bias/acc_y,bias/acc_z,acc_x,acc_y,acc_z", "table.csv", [0, 4, 5, 6]),
        ("time,ref:gx,ref:gy,ref:gz,gx,gy,gz", "table.csv", [0, 4, 5, 6]),
        ("time,other/gx,other/gy,other/gz,gx,gy,gz", "table.csv", [0, 4, 5, 6]),
        ("gps/time,time,ax,ay,az,baro/temperature,temp", "table.csv", [1, 2, 3, 4, 6]),
        ("time,rotation_x,rotation_y,rotation_z,gx,gy,gz", "table.csv", [0, 4, 5, 6]),
        ("time,rot[0],rot[1],rot[2],rot[3],ax,ay,az", "table.csv", [0, 5, 6, 7]),
        ("time,rot[0],rot[1],rot[2],gx,gy,gz", "table.csv", [0, 4, 5, 6]),
        ("time,acc (0),acc (1),acc (2),ax,ay,az", "table.csv", [0, 4, 5, 6]),
        ("time,est/ax,est/ay,est/az,gx,gy,gz", "table.csv", [0, 4, 5, 6]),
        ("time,w,x,y,z,ax,ay,az", "accelerometer.csv", [0, 5, 6, 7]),
        ("time,imu_w,imu_x,imu_y,imu_z,imu_ax,imu_ay,imu_az", "table.csv", [0, 5, 6, 7]),
        ("time,x,y,z,gx,gy,gz", "gyro_rate_100hz.csv", [0, 4, 5, 6]),
        ("time,x,y,z,ax,ay,az", "acc_pos.csv", [0, 4, 5, 6]),
        ("time,mag/x,mag/y,mag/z,ax,ay,az", "mag_acc.csv", [0, 4, 5, 6]),
        ("time,x (m/s),y (m/s),z (m/s),ax,ay,az", "table.csv", [0, 4, 5, 6]),
        ("time,a_sx,a_sy,a_sz,gx,gy,gz", "table.csv", [0, 4, 5, 6]),
        ("time,ax,ay,az,ax_cal,ay_cal,az_cal", "table.csv", [0, 1, 2, 3]),
        ("millis,timestamp,ax,ay,az", "table.csv", [1, 2, 3, 4]),
        ("millis,ax,ay,az,T", "table.csv", [0, 1, 2, 3, 4]),
        ("seconds,timestamp,ax,ay,az", "table.csv", [1, 2, 3, 4]),
        ("m/s,time,ax,ay,az", "table.csv", [1, 2, 3, 4]),
        ("time,linear_acceleration_x,linear_acceleration_y,linear_acceleration_z,acc_x,acc_y,acc_z", "table.csv", [0, 4, 5, 6]),
        ("time,imu1_acc_x,imu1_acc_y,imu1_acc_z,imu2_acc_x,imu2_acc_y,imu2_acc_z,imu2_gyr_x,imu2_gyr_y,imu2_gyr_z",
         "table.csv", [0, 4, 5, 6, 7, 8, 9]),
    ],
)  # fmt: skip
def test_other_columns_of_like_names_are_left(tmp_path: Path, header: str, name: str, first: list[int]) -> None:
    assert [place for place, _ in found(tmp_path, header, name)[0]] == first


@pytest.mark.parametrize(
    "header", ["time,bias/acc_x,bias/acc_y,bias/acc_z", "time,X (counts),Y (counts),Z (counts)", "time,p/q"]
)
def test_columns_of_no_instrument(tmp_path: Path, header: str) -> None:
    with refused(UsageError, Reason.USAGE, key="table_columns.no_triad"):
        found(tmp_path, header)


@pytest.mark.parametrize(("step", "tick_s"), [(100, 1e-4), (25, 1e-4), (16667, 1e-6), (8333, 1e-6)])
def test_sample_time_fine_counts_by_the_instrument(tmp_path: Path, step: int, tick_s: float) -> None:
    lines = ["SampleTimeFine,Acc_X,Acc_Y,Acc_Z", *(f"{1000 + step * row},0.1,0.2,9.8" for row in range(40))]
    rows = read_tables([write(tmp_path, "\n".join(lines) + "\n")]).rows
    np.testing.assert_allclose(np.diff(rows[:, 0]), step * tick_s, rtol=1e-9)


@pytest.mark.parametrize("unit", ["m/s^2", "g", "count"])
def test_an_accelerometer_without_gravity_is_told(tmp_path: Path, unit: str) -> None:
    rng = np.random.default_rng(5)
    for gravity, is_told in ((0.0, True), (9.80665 if unit == "m/s^2" else 1.0, False)):
        rows = 0.02 * rng.normal(size=(200, 3)) + [0.0, 0.0, gravity]
        lines = ["time_s,ax,ay,az", *(f"{0.01 * n},{x:.5f},{y:.5f},{z:.5f}" for n, (x, y, z) in enumerate(rows))]
        table = read_tables([write(tmp_path, "\n".join(lines) + "\n")], settings={"accelerometer_unit": unit})
        assert ("tables.no_gravity" in keys(table.assumptions)) is is_told


def test_fractions_too_small_for_gravity_are_no_counts(tmp_path: Path) -> None:
    rows = 0.05 * np.random.default_rng(5).normal(size=(200, 3))
    lines = ["time_s,ax,ay,az", *(f"{0.01 * n},{x:.5f},{y:.5f},{z:.5f}" for n, (x, y, z) in enumerate(rows))]
    assert "tables.no_gravity" in keys(read_tables([write(tmp_path, "\n".join(lines) + "\n")]).assumptions)


def test_a_gyroscope_alone_is_told(tmp_path: Path) -> None:
    lines = ["time_s,gx,gy,gz", *(f"{0.01 * n},0.1,0.2,0.3" for n in range(40))]
    assert "tables.no_accelerometer" in keys(read_tables([write(tmp_path, "\n".join(lines) + "\n")]).assumptions)
