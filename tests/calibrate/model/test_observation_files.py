"""Position means from CSV: every mistake names file, line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.observation_files import parse_observations, read_content
from imufield.calibrate.model.observations import Observations
from imufield.errors import Reason, RecordingError
from tests.refused import refused


def read_observations(path: Path) -> Observations:
    return parse_observations(read_content(path), path)


def write(folder: Path, text: str) -> Path:
    path = folder / "means.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_all_columns_in_any_order(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "# averaged elsewhere\n"
        "name,gz,gy,gx,az,ay,ax,sigma_ax,sigma_ay,sigma_az,temperature_degc\n"
        "z up,3,2,1,9.8,0.2,0.1,0.01,0.02,0.03,25\n"
        "\n"
        '"x, up",6,5,4,0.3,0.2,9.7,0.01,0.02,0.03,\n',
    )
    observations = read_observations(path)
    assert observations.name == ("z up", "x, up")
    assert observations.mean_raw.tolist() == [[0.1, 0.2, 9.8], [9.7, 0.2, 0.3]]
    assert observations.gyroscope_mean_raw.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert observations.covariance_raw[0] == pytest.approx(np.diag([1e-4, 4e-4, 9e-4]))
    assert np.isnan(observations.gyroscope_covariance_raw).all()
    assert observations.temperature_degc[0] == 25
    assert np.isnan(observations.temperature_degc[1])
    assert np.isnan(observations.direction).all()


def test_only_the_accelerometer(tmp_path: Path) -> None:
    observations = read_observations(write(tmp_path, "\ufeffax, ay ,az\r\n1,2,3\r\n-1e3,5,6\r\n"))
    assert observations.mean_raw.tolist() == [[1, 2, 3], [-1000, 5, 6]]
    assert observations.name == ("p01", "p02")
    assert np.isnan(observations.covariance_raw).all()


@pytest.mark.parametrize("separator", [";", "\t"])
def test_spreadsheets_with_decimal_commas(tmp_path: Path, separator: str) -> None:
    rows = [["ax", "name", "ay", "az"], ["1,5", "edge 0,5", "-2,25", "9.81"], ["1e-3", "", "0", "-9,8"]]
    path = write(tmp_path, "".join(separator.join(row) + "\n" for row in rows))
    observations = read_observations(path)
    assert observations.mean_raw.tolist() == [[1.5, -2.25, 9.81], [1e-3, 0, -9.8]]
    assert observations.name == ("edge 0,5", "p02")


@pytest.mark.parametrize(("one_g", "unit"), [(9.81, "m/s^2"), (1.0, "g"), (4096.0, "count")])
def test_unit_is_seen_in_the_size(tmp_path: Path, one_g: float, unit: str) -> None:
    rows = "".join(f"{x * one_g},{y * one_g},{z * one_g}\n" for x, y, z in [*np.eye(3), *-np.eye(3)])
    path = write(tmp_path, "ax,ay,az\n" + rows)
    assert read_observations(path).units.accelerometer == unit


@pytest.mark.parametrize(
    ("text", "line", "column", "key", "facts"),
    [
        ("", None, None, "empty", ("ax,ay,az",)),
        ("ax,ay\n1,2\n", 1, None, "missing_column", ("az",)),
        ("ax,ay,az,gx\n1,2,3,4\n", 1, None, "missing_columns", ("gy, gz",)),
        ("ax,ay,az,foo\n1,2,3,4\n", 1, None, "unknown_column", ("'foo'",)),
        ("ax,ay,az,ax\n1,2,3,4\n", 1, None, "twice", ("'ax'",)),
        ("ax,ay,az\n1,2\n", 2, None, "row_length", ("2 values", "3 columns")),
        ("ax,ay,az\n\n1,2,x\n", 3, "az", "not_a_number", ("'x'",)),
        ("ax,ay,az\n1,,3\n", 2, "ay", "not_a_number", ("''",)),
        ("ax,ay,az\n1,nan,3\n", 2, "ay", "impossible", ("nan",)),
        ("ax,ay,az,sigma_ax,sigma_ay,sigma_az\n1,2,3,1,-1,1\n", 2, "sigma_ay", "impossible", ("-1",)),
        (
            "ax,ay,az\n1,5,2,5,9,81\n",
            2,
            None,
            "decimal_commas",
            ("6 values", "3 columns", "semicolons"),
        ),
        ("ax ay az\n1 2 3\n", 1, None, "blanks", ("'ax ay az'", "commas", "semicolons", "tabs")),
        ("ax;ay;az\n1,5;2;1,234,5\n", 2, "az", "not_a_number", ("'1.234.5'",)),
        ('ax,ay,az\n1,2,"3\n4"\n', 2, None, "not_csv", ("CSV",)),
    ],
)
def test_mistakes_are_named(
    tmp_path: Path, text: str, line: int | None, column: str | None, key: str, facts: tuple[str, ...]
) -> None:
    with refused(RecordingError, Reason.BAD_DATA, "means.csv", *facts, key=f"observation_files.{key}") as caught:
        read_observations(write(tmp_path, text))
    assert caught.value.values["line"] == line
    assert caught.value.values["column"] == column
    assert "means.csv" in caught.value.message


def test_unreadable_files(tmp_path: Path) -> None:
    with refused(RecordingError, Reason.NOT_A_RECORDING, "nowhere.csv", key="observation_files.unreadable"):
        read_observations(tmp_path / "nowhere.csv")
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"ax,ay,az\n\xff\xfe\n")
    with refused(RecordingError, Reason.BAD_DATA, key="observation_files.not_utf8"):
        read_observations(binary)


def test_samples_are_no_positions(tmp_path: Path) -> None:
    rows = "0.1,0.2,9.8\n" * 2000
    assert len(read_observations(write(tmp_path, "ax,ay,az\n" + rows))) == 2000
    with refused(RecordingError, Reason.BAD_DATA, key="observation_files.too_many") as caught:
        read_observations(write(tmp_path, "ax,ay,az\n" + rows + "0.1,0.2,9.8\n"))
    assert (caught.value.values["positions"], caught.value.values["limit"]) == (2001, 2000)


@pytest.mark.parametrize("degc", ["-300", "99999"])
def test_a_temperature_of_no_instrument_is_named(tmp_path: Path, degc: str) -> None:
    path = write(tmp_path, f"ax,ay,az,temperature_degc\n0.1,0.2,9.8,25\n0.1,0.2,-9.8,{degc}\n")
    with refused(RecordingError, Reason.BAD_DATA, degc, key="observation_files.impossible") as caught:
        read_observations(path)
    assert (caught.value.values["line"], caught.value.values["column"]) == (3, "temperature_degc")
