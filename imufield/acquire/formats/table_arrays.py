"""Read columns of numbers from files of arrays: MATLAB, HDF5, Parquet, NumPy.

What a file starts with decides what it is, not its name. Vectors become columns by their names; a matrix of three columns
is a triad (``acc`` gives ``acc_x``, ``acc_y``, ``acc_z``), a single matrix is a table without a header.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import IO, TYPE_CHECKING, Any, cast

import numpy as np

from imufield.acquire.formats import foreign_file_reader
from imufield.acquire.formats.foreign_file_reader import Array, Arrays
from imufield.acquire.formats.table_names import named_column
from imufield.acquire.formats.table_text import unreadable
from imufield.dataclass import dataclass, field, replace
from imufield.errors import Reason, RecordingError, UsageError, missing_package
from imufield.files import open_to_read
from imufield.samples import AXES, TRIADS, FloatArray
from imufield.sentences import Sentences, printable, shortened

if TYPE_CHECKING:
    import subprocess

sentence = Sentences(__package__)

MATLAB_7_3 = b"MATLAB 7.3"
MATLAB_5 = b"MATLAB 5.0"
_MATLAB_4_TYPES = 5000
_MAGIC_BYTES = 16
_MOST_COLUMNS = 64  # A matrix with no more rows than this and more columns is written on its side, as MATLAB does in HDF5.
# Environment of the process that reads: what is taken of its address space for nothing is lost to the numbers.
_QUIET = {"OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}


@dataclass(frozen=True, slots=True, kw_only=True)
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
    raw_zero : tuple of 3 or 6 floats, or None
    assumptions : tuple of str
        Sentences.
    zero_s : tuple of float
        For each column seconds from 1970 to its first time, where that was taken off, else 0; empty where there is none.
    """

    path: Path
    header: tuple[str, ...] | None
    values: FloatArray
    units: tuple[str, ...] | None = None
    settings: dict[str, str | float] = field(default_factory=dict)
    raw_zero: tuple[float, ...] | None = None
    assumptions: tuple[str, ...] = ()
    zero_s: tuple[float, ...] = ()

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


@dataclass(frozen=True, slots=True)
class ArrayKind:
    """A kind of file of arrays."""

    name: str  # For ``foreign_file_reader``.
    words: str
    package: str  # That reads it.
    extra: str = ""  # That it comes with; empty where it comes with imufield.


_MATLAB = ArrayKind("mat", "MATLAB file", "scipy")
_HDF5 = ArrayKind("hdf5", "HDF5 file", "h5py", "hdf5")
_NUMPY = ArrayKind("numpy", "NumPy file", "numpy")
_KINDS = {
    MATLAB_5: _MATLAB,
    MATLAB_7_3: _HDF5,
    b"\x89HDF\r\n\x1a\n": _HDF5,
    b"PAR1": ArrayKind("parquet", "Parquet file", "pyarrow", "parquet"),
    b"\x93NUMPY": _NUMPY,
    b"PK\x03\x04": _NUMPY,
}


def array_kind(path: Path) -> ArrayKind | None:
    """Return the kind of a file of arrays, None for files of another kind or none."""
    try:
        with open_to_read(path) as file:
            head = file.read(_MAGIC_BYTES)
    except OSError:
        return None
    kind = next((kind for magic, kind in _KINDS.items() if head.startswith(magic)), None)
    # Version 4 of MATLAB's format begins with a number below 5000 that tells the type of its first variable.
    is_version_4 = path.suffix.lower() == ".mat" and len(head) > 4 and int.from_bytes(head[:4], "little") < _MATLAB_4_TYPES
    return _MATLAB if kind is None and is_version_4 else kind


def read_arrays(kind: ArrayKind, path: Path) -> ArrayTable:
    """Read a file of arrays in a process of its own, ``foreign_file_reader``.

    Raises
    ------
    RecordingError
        The file is damaged, or holds no numbers.
    UsageError
        The package for it is not installed, or cannot be imported.
    """
    try:
        with start_reader(kind.name, path) as process:
            arrays, stated = handed_over(process)
        return _table(path, arrays, stated)
    except ImportError as error:
        raise missing_package(f"{kind.words} {path}", kind.package, kind.extra, str(error)) from error
    except (RecordingError, UsageError):
        raise
    except foreign_file_reader.damage() as error:
        damaged = sentence("table_arrays.damaged", path=str(path), kind=kind.words, cause=foreign_file_reader.first_line(error))
        raise unread(path, error, damaged) from error


def unread(path: Path, error: Exception, damaged: str) -> RecordingError:
    """Return why nothing was read: what the system says, where it was the system, else that the file is damaged."""
    if isinstance(error, OSError) and error.strerror:
        return unreadable(path, error)
    return RecordingError(damaged, Reason.DAMAGED)


def start_reader(kind: str, path: Path, *topic: str, **environment: str) -> subprocess.Popen[bytes]:
    """Start ``foreign_file_reader``, which ends by itself where a file makes it take too much."""
    import subprocess  # late: text is read without it

    # -P: what stands in the present folder is nothing to import.
    command = [sys.executable, "-P", foreign_file_reader.__file__, kind, str(path), *topic]
    quiet = subprocess.DEVNULL
    together = {**os.environ, **_QUIET, **environment}
    return subprocess.Popen(command, stdin=quiet, stdout=subprocess.PIPE, stderr=quiet, env=together)  # noqa: S603  (our own)


def handed_over(reader: subprocess.Popen[bytes]) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays that ``foreign_file_reader`` sends and what the file states.

    Raises
    ------
    ValueError
        Why there are none.
    ImportError
        It could not import what reads the file.
    """
    output = cast("IO[bytes]", reader.stdout)
    head = json.loads(output.readline() or "{}")
    if "missing" in head:
        raise ImportError(head["missing"])
    if "names" not in head:
        is_long = reader.wait() == foreign_file_reader.TOO_LONG
        broken = f"its reader {'took too long for a file of its size' if is_long else 'broke down'} ({reader.returncode})"
        raise ValueError(head.get("error", broken))
    # An object with this method alone: NumPy would seek in a real file.
    pipe = cast("IO[bytes]", SimpleNamespace(read=output.read))
    arrays: Arrays = {printable(name): np.lib.format.read_array(pipe, allow_pickle=False) for name in head["names"]}
    # Arrays of other things are not transferred; their names are reported as ignored.
    return arrays | dict.fromkeys(head["others"], np.empty(0, "U1")), head["stated"]


def _table(path: Path, arrays: Arrays, stated: Mapping[str, str]) -> ArrayTable:
    """Put arrays beside each other: those with as many rows as the longest."""
    upright = {
        name: matrix
        for name, array in arrays.items()
        if array.dtype.kind in foreign_file_reader.NUMBERS + foreign_file_reader.DATES
        and (matrix := _upright(array)).ndim == 2
        and 0 < matrix.shape[1] <= _MOST_COLUMNS
    }
    rows = max((len(array) for array in upright.values()), default=0)
    used = {name: array for name, array in upright.items() if len(array) == rows}
    if rows < 2:
        raise RecordingError(sentence("table_arrays.no_columns", path=path), Reason.BAD_DATA)
    said: list[str] = []
    left_out = [shortened(name) for name in sorted(arrays.keys() - used.keys())]
    if left_out:
        said.append(sentence("table_arrays.ignored", name=path.name, ignored=left_out, rows=rows))
    columns: list[FloatArray] = []
    names: list[str] = []
    units: list[str] = []
    zero_s: list[float] = []
    for name, array in zip(_without_group(list(used)), used.values(), strict=True):
        is_date = array.dtype.kind == foreign_file_reader.DATES
        first_s = (array[0] - np.datetime64(0, "s")) / np.timedelta64(1, "s") if is_date else np.zeros(array.shape[1])
        zero_s += first_s.tolist()
        columns.append((array - array[0]) / np.timedelta64(1, "s") if is_date else array.astype(np.float64))
        names += _names(name, array.shape[1])
        units += ["s" if is_date else ""] * array.shape[1]
    if any(units):
        said.append(sentence("table_arrays.dates", name=path.name))
    values = np.hstack(columns)
    table = ArrayTable(path=path, header=None, values=values, assumptions=tuple(said), zero_s=tuple(zero_s))
    # A single matrix has a name for itself and none for its columns.
    if len(used) == 1 and values.shape[1] > 1:
        return table
    settings, raw_zero = _stated(stated)
    return replace(table, header=tuple(names), units=tuple(units), settings=settings, raw_zero=raw_zero)


def _without_group(names: list[str]) -> list[str]:
    """Leave out the groups or structures that all names are in: ``imu0.acc`` and ``imu0.gyr`` are ``acc`` and ``gyr``."""
    parts = [name.split(".") for name in names]
    # The last part is the column's own name.
    depth = min(len(each) for each in parts) - 1
    shared = next((level for level in range(depth) if len({each[level] for each in parts}) > 1), depth)
    return [".".join(each[shared:]) for each in parts]


def _upright(array: Array) -> Array:
    """Return a matrix whose rows are samples."""
    array = np.squeeze(array)
    if array.ndim == 1:
        return array[:, None]
    on_its_side = array.ndim == 2 and array.shape[0] <= _MOST_COLUMNS < array.shape[1]
    return array.T if on_its_side else array


def _names(name: str, width: int) -> list[str]:
    """Return a name for each column; axes stand before the unit: ``acc_mps2`` gives ``acc_x_mps2``."""
    if width == 1:
        return [name]
    if width != len(AXES):
        return [f"{name}_{number + 1}" for number in range(width)]
    parts = re.split(r"[_ ./]+", name)
    found = []
    for axis in AXES:
        tried = ["_".join([*parts[:place], axis, *parts[place:]]) for place in range(len(parts), 0, -1)]
        # Where none of them is understood, the axis stands at the end.
        found.append(next((text for text in tried if named_column(text, 0) is not None), tried[0]))
    return found


def _stated(stated: Mapping[str, str]) -> tuple[dict[str, str | float], tuple[float, ...] | None]:
    """Return what our own exports say of their numbers: settings and mid-scale."""
    if "imufield_accelerometer_unit" not in stated:
        return {}, None
    settings: dict[str, str | float] = {f"{triad}_unit": stated[f"imufield_{triad}_unit"] for triad in TRIADS}
    if stated.get("imufield_increments") == "true":
        settings |= {"increments": "true", "rate_hz": float(stated["imufield_rate_hz"])}
    return settings, tuple(map(float, stated.get("imufield_raw_zero", "0,0,0").split(",")))
