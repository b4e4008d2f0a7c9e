"""Program that reads a MATLAB file in a process of its own: ``python -P matlab_reader.py FILE``.

SciPy's reader follows type numbers of the file unchecked, and a damaged one kills the process; here that is this process and
not the one that asked. What is read goes to standard output: a line of JSON with the names, or with what is wrong, and then
each array in NumPy's format. This file imports nothing of imufield, so that it runs wherever NumPy and SciPy are found.
"""

from __future__ import annotations

import json
import struct
import sys
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

MEMORY_LIMIT_BYTES = 1 << 30
LONGEST_S = 60
"""Of processor time, and as much again for every 100 MB of the file."""
MEMORY_PER_BYTE = 64
"""Numbers of an instrument do not pack more tightly than this; a small file that unpacks to gigabytes is a trap."""
DAMAGE = (
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RuntimeError, OSError, EOFError),
    *(MemoryError, struct.error, zlib.error, MatReadError),
)
"""What scipy raises in damaged files, besides ending the process; a version it cannot read is a ``RuntimeError``, too."""


def arrays_of(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays of a MATLAB file, those in structures by their dotted names."""
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, np.ndarray) and value.dtype.kind in "iufb":
            yield prefix + name, value
        elif isinstance(value, dict):
            yield from arrays_of(value, f"{prefix}{name}.")


def set_limits(size: int) -> None:
    """Keep this process to the time and memory that a sound file of this size may need, where the system can."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        limit = MEMORY_LIMIT_BYTES + MEMORY_PER_BYTE * size
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        if soft == resource.RLIM_INFINITY or soft > limit:
            resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
        longest_s = LONGEST_S * (1 + size // 100_000_000)
        resource.setrlimit(resource.RLIMIT_CPU, (longest_s, longest_s))
        # A reader that dies on purpose leaves no image of its memory beside the user's files.
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main(path: Path) -> None:
    """Read, and write names and arrays, or what is wrong."""
    warnings.simplefilter("ignore")
    output = sys.stdout.buffer
    try:
        set_limits(path.stat().st_size)
        arrays = dict(arrays_of(loadmat(path, simplify_cells=True)))
    except DAMAGE as error:
        cause = str(error).strip().splitlines()[:1] or [type(error).__name__]
        output.write(json.dumps({"error": cause[0]}).encode() + b"\n")
        return
    output.write(json.dumps({"names": list(arrays)}).encode() + b"\n")
    # NumPy would seek in what it takes for a file.
    pipe: Any = SimpleNamespace(write=output.write)
    for array in arrays.values():
        np.lib.format.write_array(pipe, array, allow_pickle=False)
    output.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
