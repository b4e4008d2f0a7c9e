import pytest

from imufield.acquire.formats.table_columns import named_column


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
        ("gx", "gx", None),
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
    assert (column.field, column.unit, column.index) if column else (field, unit, 3)[: 3 if column else 2] == (None, None)
    assert (column.field if column else None, column.unit if column else None) == (field, unit)


def test_a_long_heading_takes_no_longer_than_its_length() -> None:
    assert named_column("[" * 1_000_000, 3) is None
    assert named_column("acc_x [m/s^2" + "[" * 1_000_000 + "]", 3) == named_column("acc_x [m/s^2]", 3)
