"""Run by itself: ``mf4_reader.py FILE`` writes the frames of an MF4 log to standard output, as candump does.

In a process of its own, because damaged files do not merely raise errors in the package that reads them: they exhaust the stack
and leave the interpreter in a state of which it says itself that it must not be, or ask for any amount of memory.
"""

from __future__ import annotations

import gzip
import importlib.util
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can

TOO_LARGE = 3
"""Exit code where the file asks for more memory than a sound one of its size."""


def main(path: str) -> None:
    """Write the frames of ``path``."""
    # What goes wrong is told by the exit code; the package logs tracebacks besides.
    logging.disable()
    _limit_memory(Path(path).stat().st_size)
    opener: Callable[..., Any] = gzip.open if path.endswith(".gz") else open
    with opener(path, "rb") as file, can.CanutilsLogWriter(sys.stdout) as writer:
        for message in can.MF4Reader(file):
            writer(message)


def _limit_memory(size: int) -> None:
    """Do as ``array_file_reader``, which lies beside this file: imufield itself need not be found by this process."""
    spec: Any = importlib.util.spec_from_file_location("array_file_reader", Path(__file__).with_name("array_file_reader.py"))
    reader = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reader)
    reader.limit_memory(size)


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except MemoryError:
        sys.exit(TOO_LARGE)
