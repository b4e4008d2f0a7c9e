"""Files of arrays as the libraries write them that programs write them with."""

from __future__ import annotations

import io
import signal
import struct
import subprocess
import sys
import zipfile
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from imufield.acquire.formats.table_arrays import handed_over
from imufield.acquire.formats.tables import read_tables
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import FloatArray
from tests.acquire.array_files import (
    FORCE,
    RATE,
    TIME,
    WRITERS,
    N,
    Writer,
    hdf5_groups,
    hdf5_records,
    mat_matrix,
    mat_structure,
    mat_triads,
    mat_vectors,
    numpy_names,
    numpy_table,
    parquet_columns,
    written,
)
from tests.refused import refused

h5py = pytest.importorskip("h5py", reason="extra hdf5")
pyarrow = pytest.importorskip("pyarrow", reason="extra parquet")
parquet = pytest.importorskip("pyarrow.parquet", reason="extra parquet")


def check(rows: FloatArray) -> None:
    np.testing.assert_array_equal(rows[:, 0], TIME)
    np.testing.assert_array_equal(rows[:, 1:4], FORCE)
    np.testing.assert_array_equal(rows[:, 4:7], RATE)


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_values(tmp_path: Path, write: Writer) -> None:
    table = read_tables([written(tmp_path, write)])
    check(table.rows)
    assert table.settings == {"accelerometer_unit": "m/s^2", "gyroscope_unit": "rad/s"}


def test_what_is_left_out_is_said(tmp_path: Path) -> None:
    said = " ".join(read_tables([written(tmp_path, mat_vectors)]).assumptions)
    assert "marks" in said
    said = " ".join(read_tables([written(tmp_path, numpy_names)]).assumptions)
    assert "label" in said
    with refused(UsageError, Reason.USAGE, "--columns", "2", "7") as caught:
        read_tables([written(tmp_path, mat_matrix)], columns="time,ax")
    assert caught.value.values["width"] == 7


def test_dates_count_from_the_first_row(tmp_path: Path) -> None:
    stamps = np.datetime64("2026-03-01T10:00:00", "ns") + (np.arange(N) * 5_000_000).astype("timedelta64[ns]")
    columns = {"timestamp": stamps, **{name: FORCE[:, axis] for axis, name in enumerate(("ax", "ay", "az"))}}
    parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    table = read_tables([tmp_path / "log.parquet"])
    np.testing.assert_allclose(table.rows[:, 0], TIME, atol=1e-12)
    assert any("dates" in sentence for sentence in table.assumptions)
    assert table.begin_s == datetime(2026, 3, 1, 10, tzinfo=UTC).timestamp()


def dates(begin: str) -> np.ndarray:
    return np.datetime64(begin, "ns") + (np.arange(N) * 5_000_000).astype("timedelta64[ns]")


def test_files_of_dates_are_joined_by_their_dates(tmp_path: Path) -> None:
    np.savez(tmp_path / "force.npz", timestamp=dates("2026-03-01T10:00:00"), acc=FORCE)
    np.savez(tmp_path / "rate.npz", timestamp=dates("2026-03-01T10:00:01"), gyro=RATE)
    for names, skipped in ((("force", "rate"), (200, 0)), (("rate", "force"), (0, 200))):
        table = read_tables([tmp_path / f"{name}.npz" for name in names])
        np.testing.assert_allclose(table.rows[:, 1:4], FORCE[200:], atol=1e-9)
        np.testing.assert_allclose(table.rows[:, 4:7], RATE[:-200], atol=1e-9)
        assert table.begin_s == datetime(2026, 3, 1, 10, 0, 1, tzinfo=UTC).timestamp()
        assert table.rows[0, 0] == TIME[skipped[0]]
    # Days apart there is nothing to be joined.
    np.savez(tmp_path / "rate.npz", timestamp=dates("2026-03-04T10:00:00"), gyro=RATE)
    with refused(UsageError, Reason.USAGE, key="table_join.no_common_time"):
        read_tables([tmp_path / "force.npz", tmp_path / "rate.npz"])


def test_a_date_that_is_no_time_of_the_samples_dates_nothing(tmp_path: Path) -> None:
    columns = {name: FORCE[:, axis] for axis, name in enumerate(("ax", "ay", "az"))}
    other = {"calibrated_on": dates("2019-01-01")}
    times = {"date": (dates("2026-03-01"), datetime(2026, 3, 1, tzinfo=UTC).timestamp()), "number": (TIME, 0.0)}
    for name, (time, begin_s) in times.items():
        parquet.write_table(pyarrow.table({"time": time, **columns, **other}), tmp_path / f"{name}.parquet")
        assert read_tables([tmp_path / f"{name}.parquet"], settings={"time_unit": "s"}).begin_s == begin_s


def test_an_infinity_is_named_by_its_row(tmp_path: Path) -> None:
    force = FORCE.copy()
    force[41, 1] = np.inf
    np.savez(tmp_path / "gap.npz", time=TIME, acc=force)
    with refused(RecordingError, Reason.BAD_DATA, "inf", "ay", "42") as caught:
        read_tables([tmp_path / "gap.npz"])
    assert caught.value.values["line"] == 42


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_files_cut_short(tmp_path: Path, write: Writer) -> None:
    path = written(tmp_path, write)
    content = path.read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(3):
        path.write_bytes(content[: rng.integers(8, len(content) - 8)])
        with pytest.raises((RecordingError, UsageError)) as caught:
            read_tables([path])
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("write", [parquet_columns, numpy_table, numpy_names, mat_structure, hdf5_records])
def test_files_with_bytes_changed(tmp_path: Path, write: Writer) -> None:
    path = written(tmp_path, write)
    content = path.read_bytes()
    rng = np.random.default_rng(4)
    for _ in range(4):
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
    with refused(RecordingError, Reason.DAMAGED, "MATLAB") as caught:
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
        for _ in range(16):
            writer.write_table(pyarrow.table({"t": zeros, "ax": zeros}), row_group_size=len(zeros))


def numpy_trap(path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (32_000_000, 4)})
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("data.npy", "w", force_zip64=True) as member,
    ):
        member.write(head.getvalue())
        for _ in range(128):
            member.write(bytes(8_000_000))


def mat_trap(path: Path) -> None:
    savemat(path, {"acc": np.zeros((5_000_000, 3), dtype=np.uint8)}, do_compression=True)


def numpy_trap_of_truth(path: Path) -> None:
    # A byte each, and eight as the numbers that are made of them.
    with path.open("wb") as file:
        np.savez_compressed(file, acc=np.zeros((5_000_000, 3), dtype=np.bool_))


def numpy_trap_in_pieces(path: Path) -> None:
    """No piece is large: the memory is used up when it ends."""
    with path.open("wb") as file:
        np.savez_compressed(file, *[np.zeros(12_500)] * 3000)


def numpy_trap_of_many(path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, *[np.zeros(2)] * 5000)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux enforces RLIMIT_AS, by which a reader is limited")
@pytest.mark.parametrize("write", [hdf5_trap, numpy_trap, numpy_trap_in_pieces])
def test_a_small_file_that_unpacks_to_gigabytes(tmp_path: Path, write: Writer) -> None:
    path = written(tmp_path, write)
    assert path.stat().st_size < 10_000_000
    with refused(RecordingError, Reason.DAMAGED, "memory"):
        read_tables([path])


@pytest.mark.parametrize(
    ("write", "fact"),
    [(mat_trap, "MiB"), (parquet_trap, "976 MiB"), (numpy_trap_of_truth, "MiB"), (numpy_trap_of_many, "4096")],
)
def test_more_than_the_reader_would_hand_over(tmp_path: Path, write: Writer, fact: str) -> None:
    path = written(tmp_path, write)
    with refused(RecordingError, Reason.DAMAGED, str(path), fact, key="table_arrays.damaged"):
        read_tables([path])


def varint(value: int, size: int) -> bytes:
    """Return a whole number as Thrift's compact protocol writes it, in so many bytes."""
    zigzag = 2 * value if value >= 0 else -2 * value - 1
    digits = [zigzag >> 7 * place & 0x7F for place in range(size)]
    return bytes([*(digit | 0x80 for digit in digits[:-1]), digits[-1]])


def test_rows_that_a_parquet_file_denies(tmp_path: Path) -> None:
    path = written(tmp_path, parquet_trap)
    content, stated = path.read_bytes(), varint(64_000_000, 4)
    assert content.count(stated) == 1
    for rows in (10, 0, -19):
        path.write_bytes(content.replace(stated, varint(rows, 4)))
        with refused(RecordingError, Reason.DAMAGED, str(path), key="table_arrays.damaged"):
            read_tables([path])


def test_texts_of_a_parquet_file_are_named_and_not_read(tmp_path: Path) -> None:
    # As objects of Python they would take more than the reader may.
    numbers = {"timestamp": np.arange(500_000) * 0.001, "ax": np.full(500_000, 9.8), "ay": np.zeros(500_000)}
    texts = {f"frame {number}": ["imu_link"] * 500_000 for number in range(12)}
    path = tmp_path / "texts.parquet"
    parquet.write_table(pyarrow.table({**numbers, "az": np.arange(500_000) / 3, **texts}), path, compression="zstd")
    table = read_tables([path])
    assert len(table.rows) == 500_000
    assert any("frame 11" in sentence for sentence in table.assumptions)


@pytest.mark.skipif(not hasattr(signal, "SIGPROF"), reason="Windows has no SIGPROF, by which a reader is timed")
def test_a_reader_that_computes_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scipy.py").write_text("import signal\nsignal.setitimer(signal.ITIMER_PROF, 0.1)\nwhile True: pass\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with refused(RecordingError, Reason.DAMAGED, "too long", key="table_arrays.damaged"):
        read_tables([written(tmp_path, mat_matrix)])


def test_a_reader_that_dies_is_said_to() -> None:
    command = [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE) as process,
        pytest.raises(ValueError, match="-9"),
    ):
        handed_over(process)


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
        with refused(RecordingError, Reason.BAD_DATA, name):
            read_tables([tmp_path / name])
    (tmp_path / "head.mat").write_bytes(b"MATLAB 5.0 MAT-file\x00\x01\x02")
    with refused(RecordingError, Reason.DAMAGED, "MATLAB") as caught:
        read_tables([tmp_path / "head.mat"])
    assert caught.value.reason is Reason.DAMAGED


@pytest.mark.parametrize(
    ("write", "package", "extra"), [(hdf5_groups, "h5py", "hdf5"), (parquet_columns, "pyarrow", "parquet")]
)
@pytest.mark.parametrize("cause", ["No module named '{}'", "{} was built for another NumPy"])
def test_a_package_that_cannot_be_imported_is_named(
    tmp_path: Path, write: Writer, package: str, extra: str, cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, said = written(tmp_path, write), cause.format(package)
    (tmp_path / "packages").mkdir()
    (tmp_path / "packages" / f"{package}.py").write_text(f"raise ImportError({said!r})\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "packages"))
    with refused(UsageError, Reason.MISSING_PACKAGE, str(path), package, said, f"pip install '.[{extra}]'") as caught:
        read_tables([path])
    assert caught.value.reason is Reason.MISSING_PACKAGE


def test_a_broken_scipy_comes_with_imufield_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scipy.py").write_text("raise ImportError('no libopenblas')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with refused(UsageError, Reason.MISSING_PACKAGE, "scipy", "no libopenblas", "`pip install .`"):
        read_tables([written(tmp_path, mat_matrix)])


@pytest.mark.parametrize("kind", ["external", "records", "virtual", "endless virtual", "MATLAB 7.3"])
def test_numbers_of_another_file_are_not_read(tmp_path: Path, kind: str) -> None:
    h5py = pytest.importorskip("h5py", reason="extra hdf5")
    secret, path = tmp_path / "secret", tmp_path / "table.h5"
    secret.write_bytes(bytes(range(256)) * 9)
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other.create_dataset("data", data=np.ones((30, 7)), maxshape=(None, 7))
    with h5py.File(path, "w", userblock_size=512 if kind == "MATLAB 7.3" else 0) as file:
        if "virtual" in kind:
            rows = None if kind == "endless virtual" else 30
            layout = h5py.VirtualLayout((30, 7), "f8", maxshape=(rows, 7))
            source = h5py.VirtualSource(tmp_path / "other.h5", "data", (30, 7), maxshape=(rows, 7))
            if rows is None:
                layout[: h5py.h5s.UNLIMITED] = source[: h5py.h5s.UNLIMITED]
            else:
                layout[:] = source
            file.create_virtual_dataset("data", layout)
        else:
            record = np.dtype([(name, "f4") for name in ("t", "ax", "ay", "az")])
            dtype = record if kind == "records" else "u1"
            shape = (64,) if kind == "records" else (64, 7)
            file.create_dataset("data", shape, dtype, external=[(str(secret), 0, 2048)])
    if kind == "MATLAB 7.3":
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    with refused(RecordingError, Reason.DAMAGED, "data", "other files", key="table_arrays.damaged"):
        read_tables([path], rate_hz=100)


def test_links_to_other_files_are_not_followed(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="extra hdf5")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["data"] = np.ones((30, 7))
    with h5py.File(tmp_path / "table.h5", "w") as file:
        file["data"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "data")
    with refused(RecordingError, Reason.BAD_DATA, key="table_arrays.no_columns"):
        read_tables([tmp_path / "table.h5"], rate_hz=100)
