"""Files of arrays as the libraries write them that programs write them with."""

from __future__ import annotations

import importlib.util
import io
import resource
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from imufield.acquire.table_arrays import _handed_over
from imufield.acquire.tables import read_tables
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import FloatArray

h5py = pytest.importorskip("h5py", reason="extra hdf5")
pyarrow = pytest.importorskip("pyarrow", reason="extra parquet")
parquet = pytest.importorskip("pyarrow.parquet", reason="extra parquet")

RNG = np.random.default_rng(6)
N = 300
TIME = np.arange(N) * 0.005
FORCE = RNG.normal(scale=0.1, size=(N, 3)) + np.array([0, 0, 9.8])
RATE = RNG.normal(scale=0.1, size=(N, 3))


def check(rows: FloatArray) -> None:
    np.testing.assert_array_equal(rows[:, 0], TIME)
    np.testing.assert_array_equal(rows[:, 1:4], FORCE)
    np.testing.assert_array_equal(rows[:, 4:7], RATE)


def mat_vectors(path: Path) -> None:
    savemat(path, {"t": TIME, "ax": FORCE[:, 0], "ay": FORCE[:, 1], "az": FORCE[:, 2], "marks": np.arange(5), "note": "bench",
                   "gx": RATE[:, 0], "gy": RATE[:, 1], "gz": RATE[:, 2]}, format="4")  # fmt: skip


def mat_triads(path: Path) -> None:
    savemat(path, {"time_s": TIME, "acc": FORCE, "gyro": RATE.T})


def mat_structure(path: Path) -> None:
    savemat(path, {"imu": {"time": TIME, "accel_mps2": FORCE, "gyro_rads": RATE}}, do_compression=True)


def mat_matrix(path: Path) -> None:
    savemat(path, {"data": np.column_stack([TIME, FORCE, RATE])})


def mat_7_3(path: Path) -> None:
    # As MATLAB does: a user block before HDF5, matrices on their side.
    with h5py.File(path, "w", userblock_size=512) as file:
        file["acc"], file["gyr"], file["t"] = FORCE.T, RATE.T, TIME[None]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def hdf5_groups(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("imu0")
        group["time"], group["accelerometer"], group["gyroscope"] = TIME, FORCE, RATE
        group.attrs["serial"] = "17"


def hdf5_records(path: Path) -> None:
    kind = np.dtype([("time", "f8"), *((name, "f8") for name in ("ax", "ay", "az", "gx", "gy", "gz"))])
    rows = np.array([tuple(row) for row in np.column_stack([TIME, FORCE, RATE])], dtype=kind)
    with h5py.File(path, "w") as file:
        file["imu"] = rows


def parquet_columns(path: Path) -> None:
    names = ["timestamp", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"]
    columns = [TIME, *FORCE.T, *RATE.T]
    parquet.write_table(pyarrow.table([pyarrow.array(np.ascontiguousarray(one)) for one in columns], names=names), path)


def numpy_table(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.column_stack([TIME, FORCE, RATE]))


def numpy_names(path: Path) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, time=TIME, acc=FORCE, gyro=RATE, label=np.array(["a"]))


WRITERS: list[Callable[[Path], None]] = [
    *(mat_vectors, mat_triads, mat_structure, mat_matrix, mat_7_3, hdf5_groups, hdf5_records),
    *(parquet_columns, numpy_table, numpy_names),
]
SUFFIXES = {"mat": "mat", "hdf5": "h5", "parquet": "parquet", "numpy": "npy"}


def written(folder: Path, write: Callable[[Path], None]) -> Path:
    path = folder / f"bench.{SUFFIXES[write.__name__.split('_')[0]]}"
    write(path)
    return path


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_values(tmp_path: Path, write: Callable[[Path], None]) -> None:
    table = read_tables([written(tmp_path, write)])
    check(table.rows)
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s"}


def test_what_is_left_out_is_said(tmp_path: Path) -> None:
    said = " ".join(read_tables([written(tmp_path, mat_vectors)]).assumptions)
    assert "marks" in said
    said = " ".join(read_tables([written(tmp_path, numpy_names)]).assumptions)
    assert "label" in said
    with pytest.raises(UsageError, match="--columns names 2 columns"):
        read_tables([written(tmp_path, mat_matrix)], columns="time,ax")


def test_dates_count_from_the_first_row(tmp_path: Path) -> None:
    stamps = np.datetime64("2026-03-01T10:00:00", "ns") + (np.arange(N) * 5_000_000).astype("timedelta64[ns]")
    columns = {"timestamp": stamps, **{name: FORCE[:, axis] for axis, name in enumerate(("ax", "ay", "az"))}}
    parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    table = read_tables([tmp_path / "log.parquet"])
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-12)
    assert any("dates count in seconds from the first row" in sentence for sentence in table.assumptions)


def test_a_gap_is_named_by_its_row(tmp_path: Path) -> None:
    force = FORCE.copy()
    force[41, 1] = np.nan
    np.savez(tmp_path / "gap.npz", time=TIME, acc=force)
    with pytest.raises(RecordingError, match="nan for ay in row 42") as caught:
        read_tables([tmp_path / "gap.npz"])
    assert caught.value.values["line"] == 42


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_files_cut_short(tmp_path: Path, write: Callable[[Path], None]) -> None:
    path = written(tmp_path, write)
    content = path.read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(6):
        path.write_bytes(content[: rng.integers(8, len(content) - 8)])
        with pytest.raises((RecordingError, UsageError)) as caught:
            read_tables([path])
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("write", [parquet_columns, numpy_table, numpy_names, mat_structure, hdf5_records])
def test_files_with_bytes_changed(tmp_path: Path, write: Callable[[Path], None]) -> None:
    path = written(tmp_path, write)
    content = path.read_bytes()
    rng = np.random.default_rng(4)
    for _ in range(8):
        damaged = bytearray(content)
        for place in rng.integers(8 if write is not mat_structure else 200, len(damaged), 20):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        with suppress(RecordingError, UsageError):
            read_tables([path])


def test_a_matlab_file_that_kills_its_reader(tmp_path: Path) -> None:
    path = written(tmp_path, mat_matrix)
    content = bytearray(path.read_bytes())
    # The type of the numbers, 9 for double, leads into a table whose end SciPy does not look at: what lies behind it mostly
    # kills the process, by one signal or another.
    place = content.index(struct.pack("<I", 9), 170)
    content[place : place + 4] = struct.pack("<I", 0x7F09)
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="is a damaged MATLAB file") as caught:
        read_tables([path])
    assert caught.value.reason is Reason.DAMAGED


def hdf5_trap(path: Path) -> None:
    # Chunks that were never written take no room and read as zeros.
    with h5py.File(path, "w") as file:
        for name in ("t", "ax", "ay", "az"):
            file.create_dataset(name, (250_000_000,), "f8", chunks=(1 << 16,))


def parquet_trap(path: Path) -> None:
    zeros = pyarrow.array(np.zeros(4_000_000))
    with parquet.ParquetWriter(path, pyarrow.schema([("t", "f8"), ("ax", "f8")]), compression="zstd") as writer:
        for _ in range(40):
            writer.write_table(pyarrow.table({"t": zeros, "ax": zeros}), row_group_size=len(zeros))


def numpy_trap(path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (50_000_000, 4)})
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("data.npy", "w", force_zip64=True) as member,
    ):
        member.write(head.getvalue())
        for _ in range(200):
            member.write(bytes(8_000_000))


@pytest.mark.parametrize("write", [hdf5_trap, parquet_trap, numpy_trap])
def test_a_small_file_that_unpacks_to_gigabytes(tmp_path: Path, write: Callable[[Path], None]) -> None:
    path = written(tmp_path, write)
    assert path.stat().st_size < 10_000_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordingError, match=r"is a damaged .*more memory"):
        read_tables([path])
    grown_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown_kib < 100_000, "this process read it itself"


def test_a_reader_that_dies_is_said_to() -> None:
    command = [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE) as process,
        pytest.raises(ValueError, match="its reader broke down with -9"),
    ):
        _handed_over(process)


def test_what_lies_in_the_folder_is_not_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("numpy", "scipy", "json"):
        (tmp_path / f"{name}.py").write_text("from pathlib import Path\nPath('ran').touch()\n")
    monkeypatch.chdir(tmp_path)
    check(read_tables([written(tmp_path, mat_triads)]).rows)
    assert not (tmp_path / "ran").exists()


def test_files_without_columns(tmp_path: Path) -> None:
    savemat(tmp_path / "empty.mat", {"note": "nothing"})
    np.save(tmp_path / "one.npy", np.float64(3))
    for name in ("empty.mat", "one.npy"):
        with pytest.raises(RecordingError, match="no columns of numbers"):
            read_tables([tmp_path / name])
    (tmp_path / "head.mat").write_bytes(b"MATLAB 5.0 MAT-file\x00\x01\x02")
    with pytest.raises(RecordingError, match="is a damaged MATLAB file") as caught:
        read_tables([tmp_path / "head.mat"])
    assert caught.value.reason is Reason.DAMAGED


@pytest.mark.parametrize(
    ("write", "package", "extra"), [(hdf5_groups, "h5py", "hdf5"), (parquet_columns, "pyarrow", "parquet")]
)
def test_a_missing_package_is_named(
    tmp_path: Path, write: Callable[[Path], None], package: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, write)
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else real(name))
    with pytest.raises(UsageError, match=rf"pip install 'imufield\[{extra}\]") as caught:
        read_tables([path])
    assert caught.value.reason is Reason.MISSING_PACKAGE
