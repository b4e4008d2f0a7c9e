"""Columns of numbers from files of arrays: MATLAB, HDF5, Parquet, NumPy.

What a file starts with decides what it is, not its name. Vectors become columns by their names; a matrix of three columns
is a triad (``acc`` gives ``acc_x``, ``acc_y``, ``acc_z``), a single matrix is a table without a header.
"""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.table_columns import named_column
from imufield.errors import Reason, RecordingError, UsageError, shortened
from imufield.samples import AXES, FloatArray

MATLAB_7_3, MATLAB_5 = b"MATLAB 7.3", b"MATLAB 5.0"
_MATLAB_4_TYPES = 5000
_MAGIC_BYTES = 16
_MOST_COLUMNS = 64
"""A matrix with no more rows than this and more columns is written on its side, as MATLAB does in HDF5."""
_DAMAGE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    RuntimeError,
    OSError,
    EOFError,
    MemoryError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zlib.error,
    zipfile.BadZipFile,
)
"""What the readers of these libraries raise in damaged files: their own errors derive from ValueError, OSError and
RuntimeError, the others come out of the parsing of sizes, names and (NumPy) a head written in Python."""


@dataclass(frozen=True, slots=True)
class ArrayTable:
    """Columns that are in memory, in the form of a ``TextTable``.

    Attributes
    ----------
    path : Path
    header, units : tuple of str or None
        Names of the columns and their units, where the file has them.
    values : ndarray, shape (n, width)
    settings : dict
        Settings of protocol ``rows_f64`` that the file states itself.
    raw_zero : tuple of 3 floats or None
    assumptions : tuple of str
        Sentences.
    """

    path: Path
    header: tuple[str, ...] | None
    values: FloatArray
    units: tuple[str, ...] | None = None
    settings: dict[str, str | float] = field(default_factory=dict)
    raw_zero: tuple[float, float, float] | None = None
    assumptions: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    def read(self, columns: list[int]) -> FloatArray:
        """Return some columns, shape (n, len(columns))."""
        return self.values[:, columns]

    def where(self, row: int) -> tuple[int, str]:
        """Return the number of a row, and words for it, for messages."""
        return row + 1, f"row {row + 1}"


def array_reader(path: Path) -> Callable[[Path], ArrayTable] | None:
    """Return what reads a file of arrays, None for files of another kind or none."""
    try:
        with path.open("rb") as file:
            head = file.read(_MAGIC_BYTES)
    except OSError:
        return None
    for magic, reader in _READERS.items():
        if head.startswith(magic):
            return reader
    # Version 4 of MATLAB's format begins with a number below 5000 that tells the type of its first variable.
    is_version_4 = path.suffix.lower() == ".mat" and len(head) > 4 and int.from_bytes(head[:4], "little") < _MATLAB_4_TYPES
    return read_mat if is_version_4 else None


def read_mat(path: Path) -> ArrayTable:
    """Read a MATLAB file of version 4 to 7, in a process of its own (``matlab_reader``); raises as ``read_hdf5``."""
    # -P: what stands in the present folder is nothing to import.
    command = [sys.executable, "-P", str(Path(__file__).with_name("matlab_reader.py")), str(path)]
    quiet = subprocess.DEVNULL
    try:
        with subprocess.Popen(command, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet) as process:  # noqa: S603  (our own)
            return _table(path, _handed_over(process))
    except _DAMAGE as error:
        raise _damaged(path, "MATLAB file", error) from error


def _handed_over(reader: subprocess.Popen[bytes]) -> dict[str, NDArray[Any]]:
    """Return the arrays that ``matlab_reader`` sends; a ValueError says why there are none."""
    output = cast("IO[bytes]", reader.stdout)
    head = json.loads(output.readline() or "{}")
    if "names" not in head:
        raise ValueError(head.get("error", f"its reader broke down with {reader.wait()}"))
    # NumPy would seek in what it takes for a file.
    pipe: Any = SimpleNamespace(read=output.read)
    return {name: np.lib.format.read_array(pipe, allow_pickle=False) for name in head["names"]}


def read_hdf5(path: Path) -> ArrayTable:
    """Read HDF5, MATLAB 7.3 included.

    Raises
    ------
    RecordingError
        The file is damaged, or holds no numbers.
    UsageError
        The package for it is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise missing_package(f"{path} is HDF5, which", "h5py", "hdf5") from error
    try:
        with h5py.File(path, "r") as file:
            arrays: dict[str, NDArray[Any]] = {}
            file.visititems(lambda name, item: _add_dataset(arrays, name, item))
            return _table(path, arrays, dict(file.attrs))
    except _DAMAGE as error:
        raise _damaged(path, "HDF5 file", error) from error


def _add_dataset(arrays: dict[str, NDArray[Any]], name: str, item: Any) -> None:
    # "#refs#" is where MATLAB keeps what has no name; links to outside are not followed by visititems.
    if not hasattr(item, "shape") or name.startswith("#") or item.size == 0:
        return
    if item.dtype.names:
        arrays.update({f"{name}.{part}": item[part] for part in item.dtype.names})
    elif item.dtype.kind in "iufb":
        arrays[name.replace("/", ".")] = item[()]


def read_parquet(path: Path) -> ArrayTable:
    """Read Parquet; raises as ``read_hdf5``."""
    try:
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise missing_package(f"{path} is Parquet, which", "pyarrow", "parquet") from error
    try:
        table = parquet.read_table(path)
        arrays = {name: table.column(name).to_numpy() for name in table.column_names}
        stated = {
            key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items() if key != b"ARROW:schema"
        }
        return _table(path, arrays, stated)
    except _DAMAGE as error:
        raise _damaged(path, "Parquet file", error) from error


def read_numpy(path: Path) -> ArrayTable:
    """Read .npy or .npz; raises as ``read_hdf5``."""
    try:
        # Opened here: NumPy leaves a damaged archive open.
        with path.open("rb") as file:
            content = np.load(file, allow_pickle=False)
            names = content.dtype.names if isinstance(content, np.ndarray) else content.files
            return _table(path, {name: content[name] for name in names} if names else {"": content})
    except _DAMAGE as error:
        raise _damaged(path, "NumPy file", error) from error


_READERS: dict[bytes, Callable[[Path], ArrayTable]] = {
    MATLAB_5: read_mat,
    MATLAB_7_3: read_hdf5,
    b"\x89HDF\r\n\x1a\n": read_hdf5,
    b"PAR1": read_parquet,
    b"\x93NUMPY": read_numpy,
    b"PK\x03\x04": read_numpy,
}


def missing_package(what: str, package: str, extra: str) -> UsageError:
    """Return the error that a package of an extra is not installed."""
    return UsageError(
        f"{what} needs the package {package}; install it with `pip install 'imufield[{extra}]'`", Reason.MISSING_PACKAGE
    )


def _table(path: Path, arrays: Mapping[str, NDArray[Any]], stated: Mapping[str, Any] | None = None) -> ArrayTable:
    """Put arrays beside each other: those with as many rows as the longest."""
    upright = {name: _upright(array) for name, array in arrays.items() if array.dtype.kind in "iufbM"}
    upright = {name: array for name, array in upright.items() if array.ndim == 2 and 0 < array.shape[1] <= _MOST_COLUMNS}
    rows = max((len(array) for array in upright.values()), default=0)
    used = {name: array for name, array in upright.items() if len(array) == rows}
    if rows < 2:
        raise RecordingError(f"{path} holds no columns of numbers: check that it is the right file", Reason.BAD_DATA)
    left_out = sorted(name for name in arrays if name not in used)
    said: tuple[str, ...] = ()
    if left_out:
        said = (f"{path.name}: ignored {', '.join(map(shortened, left_out))}, which have not {rows} rows of numbers.",)
    columns, times = zip(*(_as_numbers(array) for array in used.values()), strict=True)
    values = np.hstack(columns)
    if any(times):
        said += (f"{path.name}: dates count in seconds from the first row.",)
    if len(used) == 1 and values.shape[1] > 1:
        return ArrayTable(path, None, values, assumptions=said)
    short = _without_group(list(used))
    names = tuple(one for name, array in zip(short, used.values(), strict=True) for one in _names(name, array.shape[1]))
    units = tuple("s" if is_date else "" for array, is_date in zip(columns, times, strict=True) for _ in range(array.shape[1]))
    return ArrayTable(path, names, values, units, *_stated(stated or {}), said)


def _without_group(names: list[str]) -> list[str]:
    """Leave out the groups or structures that all names are in: ``imu0.acc`` and ``imu0.gyr`` are ``acc`` and ``gyr``."""
    parts = [name.split(".") for name in names]
    depth = min(len(each) for each in parts) - 1
    shared = next((level for level in range(depth) if len({each[level] for each in parts}) > 1), depth)
    return [".".join(each[shared:]) for each in parts]


def _upright(array: NDArray[Any]) -> NDArray[Any]:
    array = np.squeeze(array)
    if array.ndim == 1:
        return array[:, None]
    on_its_side = array.ndim == 2 and array.shape[0] <= _MOST_COLUMNS < array.shape[1]
    return array.T if on_its_side else array


def _as_numbers(array: NDArray[Any]) -> tuple[FloatArray, bool]:
    """Return numbers, and whether they were dates."""
    if array.dtype.kind == "M":
        return (array - array[0]) / np.timedelta64(1, "s"), True
    return array.astype(np.float64), False


def _names(name: str, width: int) -> list[str]:
    if width == 1:
        return [name]
    if width != len(AXES):
        return [f"{name}_{number + 1}" for number in range(width)]
    return [_axis_name(name, axis) for axis in AXES]


def _axis_name(name: str, axis: str) -> str:
    """Put an axis into the name of a triad, before its unit where it has one: ``acc_mps2`` gives ``acc_x_mps2``."""
    parts = re.split(r"[_ ./]+", name)
    tried = ["_".join([*parts[:place], axis, *parts[place:]]) for place in range(len(parts), 0, -1)]
    return next((one for one in tried if named_column(one, 0) is not None), tried[0])


def _stated(stated: Mapping[str, Any]) -> tuple[dict[str, str | float], tuple[float, float, float] | None]:
    """Return what our own exports say of their numbers: settings and mid-scale."""
    if "imufield_accelerometer_unit" not in stated:
        return {}, None
    settings: dict[str, str | float] = {
        f"{part}_unit": str(stated[f"imufield_{part}_unit"]) for part in ("accelerometer", "gyroscope")
    }
    if str(stated.get("imufield_increments", "")) == "true":
        settings["increments"] = "true"
        settings["rate_hz"] = float(stated["imufield_rate_hz"])
    zero = [float(part) for part in str(stated.get("imufield_raw_zero", "0,0,0")).split(",")]
    return settings, (zero[0], zero[1], zero[2])


def _damaged(path: Path, kind: str, error: BaseException) -> RecordingError | UsageError:
    if isinstance(error, RecordingError | UsageError):
        return error
    if isinstance(error, OSError) and error.strerror:
        return RecordingError(f"{path} cannot be read ({error.strerror}): check the name and its permissions", Reason.BAD_DATA)
    cause = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    return RecordingError(
        f"{path} is a damaged {kind} ({cause}): fetch or save it again", Reason.DAMAGED, path=str(path), cause=cause
    )
