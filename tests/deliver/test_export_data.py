import csv
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.tables import read_tables
from imufield.deliver.export_data import export_csv
from imufield.errors import RecordingError
from imufield.samples import SAMPLE_COLUMNS, Samples, SampleUnits, Status, make_samples


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
    with pytest.raises(RecordingError, match="cannot be written"):
        export_csv([block(10)], tmp_path / "missing" / "out.csv")


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX")
def test_others_may_read_it_as_far_as_the_umask_says(tmp_path: Path) -> None:
    export_csv([block(10)], tmp_path / "out.csv")
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((tmp_path / "out.csv").stat().st_mode) == 0o666 & ~mask
