"""CSV by blocks against lines made one by one with ``repr``; what an export writes over, and what not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.recording.recorder import Recorder
from imufield.deliver.samples.export_csv import ROWS, refuse_foreign_file, write_csv
from imufield.errors import Reason, UsageError
from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, Samples, SampleUnits
from tests.refused import refused


def made(n: int) -> Samples:
    """Return samples of every kind of number that an instrument can give."""
    rng = np.random.default_rng(n)
    return Samples(
        time_s=np.arange(n) / 2000.0,
        accelerometer=np.column_stack([rng.normal(size=n), rng.integers(-(2**23), 2**23, n), np.full(n, np.nan)]),
        gyroscope=rng.normal(size=(n, 3)) * [1e-3, 1e-5, 1e-9],
        temperature_degc=np.where(np.arange(n) % 2, np.nan, np.round(rng.uniform(-40, 85, n), 2)),
        counter=np.where(np.arange(n) % 3, rng.integers(0, 2**32, n), NO_COUNTER),
        status=rng.integers(0, 2**32, n).astype(np.uint32),
        units=SampleUnits(),
    )


def lines_of(samples: Samples) -> str:
    floats = np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope, samples.temperature_degc])
    lines = []
    for numbers, counter, status in zip(floats.tolist(), samples.counter.tolist(), samples.status.tolist(), strict=True):
        texts = ["" if number != number else repr(number) for number in numbers]
        lines.append(",".join([*texts, "" if counter == NO_COUNTER else str(counter), str(status)]) + "\n")
    return "".join(lines)


def test_the_text_is_that_of_python(tmp_path: Path) -> None:
    samples = made(5 * ROWS + 7)
    blocks = [samples[start : start + ROWS] for start in range(0, len(samples), ROWS)]
    assert write_csv(blocks, tmp_path / "out.csv", {}) == len(samples)
    assert (tmp_path / "out.csv").read_bytes().decode() == ",".join(SAMPLE_COLUMNS) + "\n" + lines_of(samples)


def others(path: Path, kind: str) -> None:
    """Write a file of the same format as an export, which none wrote."""
    values = np.arange(5.0)
    if kind == "hdf5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            file["log"] = values
    elif kind == "parquet":
        pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        parquet.write_table(pyarrow.table({"ax": values}), path)
    elif kind == "mcap":
        writer = pytest.importorskip("mcap.writer").Writer(str(path))
        writer.start(profile="ros2", library="other")
        writer.finish()
    else:
        path.write_text("time,ax,ay,az\n0,1,2,3\n")


@pytest.mark.parametrize("kind", ["hdf5", "parquet", "mcap", "csv"])
def test_a_file_that_no_export_wrote_is_kept(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "log"
    others(path, kind)
    with refused(UsageError, Reason.USAGE, "log", key="export_csv.foreign"):
        refuse_foreign_file(path)


def test_a_recording_is_kept(tmp_path: Path) -> None:
    with Recorder(tmp_path / "part-001.mcap", {}) as recorder:
        recorder.write_event({"event": "mark"})
    with refused(UsageError, Reason.USAGE, key="export_csv.foreign"):
        refuse_foreign_file(tmp_path / "part-001.mcap")
