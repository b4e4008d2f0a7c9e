"""Program that reads a file of arrays in a process of its own: ``python -P array_file_reader.py KIND FILE``.

The libraries that read them are written in C and believe what a file says of its sizes and types: a damaged MATLAB file kills
SciPy's reader, and a few hundred bytes of HDF5, Parquet or packed NumPy unpack to gigabytes. Here that is the end of this
process and not of the one that asked. What is read goes to standard output: a line of JSON with the names and what the file
states, or with what is wrong, and then each array in NumPy's format. This file imports nothing of imufield, so that it runs
wherever NumPy and SciPy are found.
"""

from __future__ import annotations

import json
import mmap
import struct
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

MEMORY_LIMIT_BYTES = 1 << 30
"""For the libraries and small files: pyarrow maps 0.2 GB as it loads, and the pages and copies of a small file take a few
times its numbers."""
LONGEST_S = 10
"""Of processor time, and a minute more for every 100 MB of the file. Small files take some tenths of a second, and on a slow
computer seconds, nearly all of it to load the libraries."""
MEMORY_PER_BYTE = 64
"""Numbers of an instrument do not pack more tightly than this; a small file that unpacks to gigabytes is a trap."""
DAMAGE = (
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RuntimeError, OSError, EOFError),
    *(MemoryError, SyntaxError, RecursionError, struct.error, tokenize.TokenError, zlib.error, zipfile.BadZipFile),
)
"""What the libraries raise in damaged files, besides ending the process: their own errors derive from ValueError, OSError and
RuntimeError, the others come out of the parsing of sizes, names and (NumPy) a head written in Python."""
NUMBERS = "iufb"
"""Kinds of data in NumPy that are numbers: whole, without sign, floating, truth values."""
DATES = "M"
_OWN = "imufield_"  # What our own exports state of their numbers begins with this.


def read_mat(path: Path) -> tuple[Arrays, Mapping[Any, Any]]:
    """Return the arrays of a MATLAB file of version 4 to 7."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        return dict(_of_structure(loadmat(path, simplify_cells=True))), {}
    except MatReadError as error:
        raise ValueError(str(error)) from error


def _of_structure(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays of a MATLAB file, those in structures by their dotted names."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, np.ndarray) and value.dtype.kind in NUMBERS:
            yield prefix + name, value
        elif isinstance(value, dict):
            yield from _of_structure(value, f"{prefix}{name}.")


def read_hdf5(path: Path) -> tuple[Arrays, Mapping[Any, Any]]:
    """Return the datasets and records of an HDF5 file and its attributes."""
    import h5py

    with h5py.File(path, "r") as file:
        arrays: Arrays = {}
        file.visititems(lambda name, item: _add_dataset(arrays, name, item))
        return arrays, {name: value for name, value in file.attrs.items() if name.startswith(_OWN)}


def _add_dataset(arrays: Arrays, name: str, item: Any) -> None:
    # "#refs#" is where MATLAB keeps what has no name; links to outside are not followed by visititems.
    if not hasattr(item, "shape") or name.startswith("#") or item.size == 0:
        return
    if item.dtype.names:
        arrays.update({f"{name}.{part}": item[part] for part in item.dtype.names})
    elif item.dtype.kind in NUMBERS:
        arrays[name.replace("/", ".")] = item[()]


def read_parquet(path: Path) -> tuple[Arrays, Mapping[Any, Any]]:
    """Return the columns of a Parquet file and what its writer says of it."""
    import pyarrow.parquet as parquet

    # One thread: each of them would take address space of its own.
    table = parquet.read_table(path, use_threads=False)
    stated = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items() if key != b"ARROW:schema"}
    return {name: table.column(name).to_numpy() for name in table.column_names}, stated


def read_numpy(path: Path) -> tuple[Arrays, Mapping[Any, Any]]:
    """Return what is in a .npy or .npz file."""
    # Opened here: NumPy leaves a damaged archive open.
    with path.open("rb") as file:
        content = np.load(file, allow_pickle=False)
        names = content.dtype.names if isinstance(content, np.ndarray) else content.files
        return ({name: content[name] for name in names} if names else {"": content}), {}


READERS: dict[str, Callable[[Path], tuple[Arrays, Mapping[Any, Any]]]] = {
    "mat": read_mat,
    "hdf5": read_hdf5,
    "parquet": read_parquet,
    "numpy": read_numpy,
}
"""By the name of the kind on the command line."""


def set_limits(size: int) -> None:
    """Keep this process to the time and memory that a sound file of this size may need, where the system can."""
    limit_memory(size)
    _limit("RLIMIT_CPU", LONGEST_S + 60 * size // 100_000_000)


def memory_limit_bytes(size: int) -> int:
    """Return what a process may take, beyond itself, that reads a file of ``size`` bytes."""
    return MEMORY_LIMIT_BYTES + MEMORY_PER_BYTE * size


def limit_memory(size: int) -> None:
    """Keep this process to the memory that a sound file of this size may need, where the system can."""
    _limit("RLIMIT_AS", _present_bytes() + memory_limit_bytes(size))
    # A reader that dies on purpose leaves no image of its memory beside the user's files.
    _limit("RLIMIT_CORE", 0)


def _limit(name: str, most: int) -> None:
    """Lower a limit of this process, where the system has it and it is not lower yet."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        soft, hard = resource.getrlimit(getattr(resource, name))
        if soft == resource.RLIM_INFINITY or soft > most:
            resource.setrlimit(getattr(resource, name), (most, hard))


def _present_bytes() -> int:
    """Return the address space that this process has taken already, 0 where the system does not say."""
    with suppress(OSError, ValueError):
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * mmap.PAGESIZE
    return 0


def main(kind: str, path: Path) -> None:
    """Read, and write names and arrays, or what is wrong."""
    warnings.simplefilter("ignore")
    output = sys.stdout.buffer
    try:
        set_limits(path.stat().st_size)
        arrays, stated = READERS[kind](path)
    except ImportError as error:
        _write_line(output, {"missing": _first_line(error)})
        return
    except MemoryError:
        _write_line(output, {"error": "its numbers need more memory than those of a sound file of its size"})
        return
    except DAMAGE as error:
        _write_line(output, {"error": _first_line(error)})
        return
    numbers = [name for name, array in arrays.items() if array.dtype.kind in NUMBERS + DATES]
    head = {
        "names": numbers,
        "others": [name for name in arrays if name not in numbers],
        "stated": {str(name): str(value) for name, value in stated.items() if str(name).startswith(_OWN)},
    }
    _write_line(output, head)
    # NumPy would seek in what it takes for a file.
    pipe: Any = SimpleNamespace(write=output.write)
    for name in numbers:
        np.lib.format.write_array(pipe, arrays[name], allow_pickle=False)
    output.flush()


def _write_line(output: IO[bytes], content: Mapping[str, Any]) -> None:
    output.write(json.dumps(content).encode() + b"\n")


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
