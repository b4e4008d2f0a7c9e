"""Run by itself: ``mf4_reader.py FILE`` writes the frames of an MF4 log to standard output, as candump does.

In a process of its own, because damaged files do not merely raise errors in the package that reads them: they exhaust the stack
and leave the interpreter in a state of which it says itself that it must not be.
"""

from __future__ import annotations

import gzip
import logging
import sys
from collections.abc import Callable
from typing import Any

import can


def main(path: str) -> None:
    """Write the frames of ``path``."""
    # What goes wrong is told by the exit code; the package logs tracebacks besides.
    logging.disable()
    opener: Callable[..., Any] = gzip.open if path.endswith(".gz") else open
    with opener(path, "rb") as file, can.CanutilsLogWriter(sys.stdout) as writer:
        for message in can.MF4Reader(file):
            writer(message)


if __name__ == "__main__":
    main(sys.argv[1])
