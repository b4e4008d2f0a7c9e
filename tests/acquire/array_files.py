"""Files of arrays, written by the libraries that programs write them with; a test skips where the extra is missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

Writer = Callable[[Path], None]
RNG = np.random.default_rng(6)
N = 300
TIME = np.arange(N) * 0.005
FORCE = RNG.normal(scale=0.1, size=(N, 3)) + np.array([0, 0, 9.8])
RATE = RNG.normal(scale=0.1, size=(N, 3))


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
    h5py = pytest.importorskip("h5py", reason="extra hdf5")
    # As MATLAB does: a user block before HDF5, matrices on their side.
    with h5py.File(path, "w", userblock_size=512) as file:
        file["acc"], file["gyr"], file["t"] = FORCE.T, RATE.T, TIME[None]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def hdf5_groups(path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="extra hdf5")
    with h5py.File(path, "w") as file:
        group = file.create_group("imu0")
        group["time"], group["accelerometer"], group["gyroscope"] = TIME, FORCE, RATE
        group.attrs["serial"] = "17"


def hdf5_records(path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="extra hdf5")
    kind = np.dtype([("time", "f8"), *((name, "f8") for name in ("ax", "ay", "az", "gx", "gy", "gz"))])
    rows = np.array([tuple(row) for row in np.column_stack([TIME, FORCE, RATE])], dtype=kind)
    with h5py.File(path, "w") as file:
        file["imu"] = rows


def parquet_columns(path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="extra parquet")
    parquet = pytest.importorskip("pyarrow.parquet", reason="extra parquet")
    names = ["timestamp", "acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"]
    columns = [TIME, *FORCE.T, *RATE.T]
    parquet.write_table(pyarrow.table([pyarrow.array(np.ascontiguousarray(one)) for one in columns], names=names), path)


def numpy_table(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.column_stack([TIME, FORCE, RATE]))


def numpy_names(path: Path) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, time=TIME, acc=FORCE, gyro=RATE, label=np.array(["a"]))


WRITERS: list[Writer] = [
    *(mat_vectors, mat_triads, mat_structure, mat_matrix, mat_7_3, hdf5_groups, hdf5_records),
    *(parquet_columns, numpy_table, numpy_names),
]
SUFFIXES = {"mat": "mat", "hdf5": "h5", "parquet": "parquet", "numpy": "npy"}


def written(folder: Path, write: Writer) -> Path:
    path = folder / f"bench.{SUFFIXES[write.__name__.split('_')[0]]}"
    write(path)
    return path
