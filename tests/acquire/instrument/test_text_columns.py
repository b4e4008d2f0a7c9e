"""What the numbers of a line are: by gravity, by a turn, by a heading; and what is only assumed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from imufield.acquire.instrument.text_columns import Columns, are_labelled, find_columns, read_lines, usual_columns
from imufield.samples import FloatArray
from imufield.simulate.truth.grades import draw_truth, find_grade
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import NO_POSITION, Operator, OperatorSettings, Visit
from imufield.simulate.truth.virtual_imu import VirtualImu
from tests.told import key_of

G = 9.80665
RATE_HZ = 100.0
DEG = np.degrees(1.0)


@cache
def held(*, turned: bool) -> FloatArray:
    """Return time, accelerometer in m/s^2 and gyroscope in rad/s of 2.5 s: lying still, or picked up and turned over."""
    person = Operator((), 5, OperatorSettings())
    if turned:
        person.show(Visit(NO_POSITION, np.array([1.0, 0.0, 0.0])))
    drawn = draw_truth(find_grade("mems"), np.random.default_rng(5))
    samples = VirtualImu(Imu(drawn, 5, ImuSettings(rate_hz=RATE_HZ)), person).next_block(250)
    return np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope])


def found(table: FloatArray, *, delimiter: str = ",", heading: str = "", fmt: str = "%.6f", prefix: str = "") -> Columns | None:
    lines = [prefix + delimiter.join(fmt % value for value in row) for row in table]
    read = read_lines(("\n".join([heading, *lines]) + "\n").encode())
    assert read is not None
    return find_columns(read, 98.0)


def settings(columns: Columns | None) -> dict[str, str]:
    assert columns is not None
    return columns.settings


@pytest.mark.parametrize("delimiter", [",", ";", " ", "\t", ", "])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("unit", "size"), [("m/s^2", 1.0), ("g", 1 / G), ("mg", 1000 / G)])
def test_gravity_tells_which_columns_and_their_unit(delimiter: str, turned: bool, unit: str, size: float) -> None:
    table = held(turned=turned)[:, 1:] * np.repeat([size, 1.0], 3)
    got = settings(found(table, delimiter=delimiter))
    assert (got["columns"], got["accelerometer_unit"]) == ("ax,ay,az,gx,gy,gz", unit)
    got = settings(found(np.roll(table, 3, axis=1), delimiter=delimiter))
    assert (got["columns"], got["accelerometer_unit"]) == ("gx,gy,gz,ax,ay,az", unit)


def test_numbers_beyond_every_output_leave_their_line_out() -> None:
    table = held(turned=True)[:, 1:].copy()
    clean = found(np.delete(table, [7, 90, 91], axis=0))
    # One that is still a number, and two that are written with more digits than a number holds: their sum is none.
    table[[7, 90, 91], [0, 1, 1]] = 1e300, np.inf, -np.inf
    assert settings(found(table)) == settings(clean)


@pytest.mark.parametrize("accelerometer", [1.0, 1 / G])
@pytest.mark.parametrize(("unit", "size"), [("rad/s", 1.0), ("deg/s", DEG), ("count", 1000.0)])
def test_a_turn_shows_the_unit_of_the_gyroscope(accelerometer: float, unit: str, size: float) -> None:
    got = found(held(turned=True)[:, 1:] * np.repeat([accelerometer, size], 3))
    assert got is not None
    assert got.settings["gyroscope_unit"] == unit
    assert got.is_shown
    assert key_of(got.reasons["gyroscope_unit"]) == "text_columns.turn"


def test_a_unit_that_lies_still_shows_no_unit_of_the_gyroscope() -> None:
    table = held(turned=False)[:, 1:]
    in_g = found(table * np.repeat([1 / G, DEG], 3))
    in_si = found(table)
    assert in_g is not None
    assert in_si is not None
    assert not in_g.is_shown
    assert not in_si.is_shown
    assert (in_g.settings["gyroscope_unit"], in_si.settings["gyroscope_unit"]) == ("deg/s", "rad/s")
    assert key_of(in_g.reasons["gyroscope_unit"]) == "text_columns.like_accelerometer"
    assert key_of(in_si.reasons["gyroscope_unit"]) == "text_columns.like_accelerometer"


@pytest.mark.parametrize(
    ("clock", "expected"),
    [
        (np.arange(250) + 7.0, {"columns": "counter", "rate_hz": "100"}),
        (np.arange(250) % 256.0 + 0.0, {"columns": "counter", "rate_hz": "100"}),
        ((np.arange(250) + 100) % 256.0, {"columns": "counter", "counter_modulus": "256"}),
        (np.arange(250) * 0.01, {"columns": "time", "time_unit": "s"}),
        (np.arange(250) * 10.0 + 5e6, {"columns": "time", "time_unit": "ms"}),
        (np.arange(250) * 10_000.0, {"columns": "time", "time_unit": "us"}),
    ],
)
def test_a_column_that_counts_in_front(clock: FloatArray, expected: dict[str, str]) -> None:
    got = settings(found(np.column_stack([clock, held(turned=False)[:, 1:]])))
    name = expected.pop("columns")
    assert got["columns"] == f"{name},ax,ay,az,gx,gy,gz"
    assert got.items() >= expected.items()


@pytest.mark.parametrize("place", [0, 3, 6])
@pytest.mark.parametrize("turned", [False, True])
def test_a_temperature_beside(place: int, turned: bool) -> None:
    table = held(turned=turned)[:, 1:] * np.repeat([1.0, DEG], 3)
    names = ["ax", "ay", "az", "gx", "gy", "gz"]
    names.insert(place, "temperature")
    warm = 24.0 + 0.1 * np.random.default_rng(1).standard_normal(250)
    assert settings(found(np.insert(table, place, warm, axis=1)))["columns"] == ",".join(names)


def test_a_magnetometer_and_an_empty_column_are_passed_over() -> None:
    table = held(turned=False)[:, 1:]
    field = np.array([20.0, -5.0, 43.0]) + 0.1 * np.random.default_rng(2).standard_normal((250, 3))
    assert settings(found(np.hstack([table, field])))["columns"] == "ax,ay,az,gx,gy,gz,-,-,-"
    lines = "".join(",".join(f"{value:.5f}" for value in row) + ",\r\n" for row in table)
    read = read_lines(lines.encode())
    assert read is not None
    assert settings(find_columns(read, RATE_HZ))["columns"] == "ax,ay,az,gx,gy,gz,-"


def test_a_heading_says_names_and_units() -> None:
    table = held(turned=False) * np.repeat([1.0, DEG, 1 / G], [1, 3, 3])
    swapped = table[:, [0, 4, 5, 6, 1, 2, 3]]
    got = found(swapped, heading="time_s,gyro_x (dps),gyro_y (dps),gyro_z (dps),acc_x (g),acc_y (g),acc_z (g)")
    assert got is not None
    units = {"accelerometer_unit": "g", "gyroscope_unit": "deg/s"}
    assert got.settings.items() >= {"columns": "time,gx,gy,gz,ax,ay,az", **units}.items()
    assert got.is_shown
    assert key_of(got.reasons["columns"]) == "text_columns.heading"


def test_a_word_in_front_is_the_prefix() -> None:
    got = settings(found(held(turned=False)[:, 1:], prefix="$IMU,"))
    assert (got["prefix"], got["columns"]) == ("$IMU", "ax,ay,az,gx,gy,gz")


def test_counts_are_proposed_and_nothing_is_made_of_what_holds_no_gravity() -> None:
    table = np.rint(held(turned=False)[:, 1:] * np.repeat([16384 / G, 131 * DEG], 3))
    got = settings(found(table, fmt="%d"))
    assert (got["accelerometer_unit"], got["gyroscope_unit"]) == ("count", "count")
    assert found(table * 1.37) is None
    assert found(np.random.default_rng(3).standard_normal((250, 6))) is None
    assert found(np.random.default_rng(3).standard_normal((250, 5))) is None


def test_lines_of_words_and_bytes_are_no_lines_of_numbers() -> None:
    noise = bytes(np.random.default_rng(4).integers(0, 256, 20_000, dtype=np.uint8))
    for data in (b"", noise, b"$GPGGA,123519,4807.038,N*47\r\n" * 30, b"boot\n" * 30, b"1,2\n"):
        assert read_lines(data) is None


@pytest.mark.parametrize(
    ("line", "is_labelled"),
    [
        ("ax=0.053 ay=-0.443 az=9.81", True),
        ("A: 0.05 -0.44 9.81 G: 0.1 0.2 0.3", True),
        ('{"acc": [0.05, -0.44, 9.81], "gyr": [.1, .2, .3]}', True),
        ("X:+1,Y:-2,Z:3", True),
        ("Raw: 1 2 3", False),
        ("$IMU,0.1,0.2,9.8*5A", False),
        ("$GPGGA,123519,4807.038,N*47", False),
        ("12:30:01.123 0.1 0.2 9.8", False),
        ("", False),
    ],
)
def test_labels_are_told_from_a_word_in_front(line: str, is_labelled: bool) -> None:
    assert are_labelled([line] * 3) is is_labelled
    assert not are_labelled([])


@pytest.mark.parametrize("width", range(1, 13))
def test_an_example_has_as_many_names_as_there_are_numbers(width: int) -> None:
    assert len(usual_columns(width).split(",")) == max(width, 3)
