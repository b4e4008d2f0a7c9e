"""Program that reads a file of another program in a process of its own: ``python -P array_file_reader.py KIND FILE``.

The libraries that read such files are written in C and believe what a file says of its sizes and types: a damaged MATLAB file
kills SciPy's reader, a few hundred bytes of HDF5, Parquet or packed NumPy unpack to gigabytes, and a damaged MF4 log exhausts
the stack. Here that is the end of this process and not of the one that asked.

Of arrays, standard output gets a line of JSON with the names and what the file states, or with what is wrong, and then each
array in NumPy's format; of an MF4 log it gets the frames as candump writes them. This file imports nothing of imufield, so
that it runs wherever the libraries are found.
"""

from __future__ import annotations

import gzip
import json
import logging
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
from typing import IO, Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

# The type of the numbers is known when the file is read.
Array = NDArray[Any]
Arrays = dict[str, Array]
Content = tuple[Arrays, Mapping[str, object]]
"""Arrays by name, and the attributes of the file."""

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
TOO_LARGE = 3
"""Exit code where an MF4 log asks for more memory than a sound one of its size."""
_OWN = "imufield_"  # What our own exports state of their numbers begins with this.


def read_mat(path: Path) -> Content:
    """Return the arrays of a MATLAB file of version 4 to 7."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        return dict(_of_structure(loadmat(path, simplify_cells=True))), {}
    except MatReadError as error:
        raise ValueError(str(error)) from error


def _of_structure(content: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, Array]]:
    """Yield the arrays of a MATLAB file, those in structures by their dotted names."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, np.ndarray) and value.dtype.kind in NUMBERS:
            yield prefix + name, value
        elif isinstance(value, dict):
            yield from _of_structure(value, f"{prefix}{name}.")


def read_hdf5(path: Path) -> Content:
    """Return the datasets and records of an HDF5 file and its attributes."""
    import h5py

    arrays: Arrays = {}
    with h5py.File(path, "r") as file:
        names: list[str] = []
        # Links to outside are not followed.
        file.visit(names.append)
        for name in names:
            item = file[name]
            # "#refs#" is where MATLAB keeps what has no name.
            if name.startswith("#") or not isinstance(item, h5py.Dataset):
                continue
            # Asked before its size: that of a virtual dataset may be looked up in the other files.
            if item.external or item.is_virtual:
                raise ValueError(f"the numbers of {name} are in other files, which are not read")
            if item.size == 0:
                continue
            if item.dtype.names:
                arrays |= {f"{name}.{part}": item[part] for part in item.dtype.names}
            elif item.dtype.kind in NUMBERS:
                arrays[name.replace("/", ".")] = item[()]
        return arrays, {name: value for name, value in file.attrs.items() if name.startswith(_OWN)}


def read_parquet(path: Path) -> Content:
    """Return the columns of a Parquet file and what its writer says of it."""
    import pyarrow.parquet as parquet

    # One thread: each of them would take address space of its own.
    table = parquet.read_table(path, use_threads=False)
    stated = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items() if key != b"ARROW:schema"}
    return {name: table.column(name).to_numpy() for name in table.column_names}, stated


def read_numpy(path: Path) -> Content:
    """Return what is in a .npy or .npz file."""
    # Opened here: NumPy leaves a damaged archive open.
    with path.open("rb") as file:
        content = np.load(file, allow_pickle=False)
        names = content.dtype.names if isinstance(content, np.ndarray) else content.files
        return ({name: content[name] for name in names} if names else {"": content}), {}


READERS: dict[str, Callable[[Path], Content]] = {
    "mat": read_mat,
    "hdf5": read_hdf5,
    "parquet": read_parquet,
    "numpy": read_numpy,
}
"""By the name of the kind on the command line."""


def memory_limit_bytes(size: int) -> int:
    """Return what a process may take, beyond itself, that reads a file of ``size`` bytes."""
    return MEMORY_LIMIT_BYTES + MEMORY_PER_BYTE * size


def limit_memory(size: int) -> None:
    """Keep this process to the memory that a sound file of this size may need, where the system can."""
    present_bytes = 0
    # The address space that this process has taken already, where the system says.
    with suppress(OSError, ValueError):
        present_bytes = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * mmap.PAGESIZE
    _limit("RLIMIT_AS", present_bytes + memory_limit_bytes(size))
    # A reader that dies on purpose leaves no image of its memory beside the user's files.
    _limit("RLIMIT_CORE", 0)


def _limit(name: str, most: int) -> None:
    """Lower a limit of this process, where the system has it and it is not lower yet."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        soft, hard = resource.getrlimit(getattr(resource, name))
        if soft == resource.RLIM_INFINITY or soft > most:
            resource.setrlimit(getattr(resource, name), (most, hard))


def write_arrays(kind: str, path: Path) -> None:
    """Read, and write names and arrays, or what is wrong."""
    warnings.simplefilter("ignore")
    output = sys.stdout.buffer
    arrays: Arrays = {}
    try:
        size = path.stat().st_size
        limit_memory(size)
        _limit("RLIMIT_CPU", LONGEST_S + 60 * size // 100_000_000)
        arrays, stated = READERS[kind](path)
        numbers = [name for name, array in arrays.items() if array.dtype.kind in NUMBERS + DATES]
        head = {
            "names": numbers,
            "others": [name for name in arrays if name not in numbers],
            "stated": {name: str(value) for name, value in stated.items() if name.startswith(_OWN)},
        }
    except ImportError as error:
        numbers, head = [], {"missing": first_line(error)}
    except MemoryError:
        numbers, head = [], {"error": "its numbers need more memory than those of a sound file of its size"}
    except DAMAGE as error:
        numbers, head = [], {"error": first_line(error)}
    output.write(json.dumps(head).encode() + b"\n")
    # An object with this method alone: NumPy would seek in a real file.
    pipe = cast("IO[bytes]", SimpleNamespace(write=output.write))
    for name in numbers:
        np.lib.format.write_array(pipe, arrays[name], allow_pickle=False)
    output.flush()


def first_line(error: BaseException) -> str:
    """Return what an error says, in a line; its kind where it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def write_frames(path: Path) -> None:
    """Write the frames of an MF4 log as text; what goes wrong is told by the exit code."""
    import can

    # The package logs tracebacks besides.
    logging.disable()
    limit_memory(path.stat().st_size)
    opener = cast("Callable[..., BinaryIO]", gzip.open if path.suffix == ".gz" else open)
    with opener(path, "rb") as file, can.CanutilsLogWriter(sys.stdout) as writer:
        for message in can.MF4Reader(file):
            writer(message)


if __name__ == "__main__":
    if sys.argv[1] == "mf4":
        try:
            write_frames(Path(sys.argv[2]))
        except MemoryError:
            sys.exit(TOO_LARGE)
    else:
        write_arrays(sys.argv[1], Path(sys.argv[2]))
