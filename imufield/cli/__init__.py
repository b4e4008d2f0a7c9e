"""The command line: arguments in, exit codes out; the code of each error is in ``imufield.errors``.

What each command does is in ``imufield.commands``. Nothing heavy is imported here: each command imports its own
room, so that a prompt comes back at once.
"""

from __future__ import annotations

import atexit
import codecs
import gc
import io
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from imufield.version import __version__

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_KEPT_BYTES = 1 << 27  # Of freed memory, for the next arrays: many blocks of a recording, of a few megabytes each.
_FOR_PIPES = "imufield.pipe"  # Name of an error handler.
_MAPPED_BYTES = 1 << 25  # Of an array from which on it is mapped by itself: the most that glibc takes.


def program() -> None:
    """Run the command line as all that this process does; a script, which may go on, calls ``main``."""
    left = list[int]()
    # Where no handler is there yet: those that come later are called before.
    if not atexit._ncallbacks():  # noqa: SLF001
        atexit.register(_leave_at_once, left)
    try:
        main()
    except SystemExit as leave:
        left.append(leave.code if isinstance(leave.code, int) else int(leave.code is not None))
        raise


def main() -> None:
    """Run the command line and leave with the exit code that docs/errors.md lists."""
    # The matrices are small: threads of the linear algebra would double the processor time and gain nothing.
    for library in ("OPENBLAS", "MKL", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    # Imports make objects by tens of thousands, all to stay: at the usual 700 the collector goes through them a hundred times.
    gc.set_threshold(100_000)
    _open_closed_streams()
    _let_standard_error_fail()
    # Names of files may be no UTF-8. A pipe gets their bytes, as a shell would use them; a terminal gets them spelt out.
    codecs.register_error(_FOR_PIPES, _bytes_or_codes)
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors in ("strict", "surrogateescape"):
        sys.stdout.reconfigure(errors="backslashreplace" if sys.stdout.isatty() else _FOR_PIPES)
    if sys.argv[1:] == ["--version"]:
        # Where this fails, the whole command line says why.
        with suppress(OSError):
            sys.stdout.write(f"imufield {__version__}\n")
            sys.stdout.flush()
            return
    try:
        _keep_freed_memory()
        # Imported here, so that a Ctrl-C in the first tenth of a second is one like any other.
        from imufield.cli.run import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        from imufield.errors import EXIT_INTERRUPTED

        code = EXIT_INTERRUPTED
    # Files are closed where they are used: on the way out the collector need not go through all that there is.
    gc.freeze()
    sys.exit(code)


def _leave_at_once(left: list[int]) -> None:
    """Leave with the code that is known, if any: the interpreter would free one by one what the system frees at once."""
    # Of an output that cannot be written the interpreter tells on its own way out.
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
        # A script that has run the module inside it may have gone on.
        if left and getattr(sys.modules["__main__"], "program", None) is program:
            os._exit(left[0])


def _bytes_or_codes(error: UnicodeError) -> tuple[str | bytes, int]:
    """Return the bytes that letters of a file's name stand for; of letters that the output's encoding lacks, their codes."""
    if isinstance(error, UnicodeEncodeError):
        error.end = error.start + 1  # One letter at a time: a run may hold both.
    try:
        return codecs.lookup_error("surrogateescape")(error)
    except UnicodeEncodeError:
        return codecs.backslashreplace_errors(error)


def _keep_freed_memory() -> None:
    """Keep freed memory for the next arrays, in this process and in those it starts: see mallopt(3).

    By default it goes back to the system, which clears it page by page for the next array.
    """
    # A gain that the program can do without: what a person has set stays, and nothing depends on its success.
    if sys.platform != "linux" or "GLIBC_TUNABLES" in os.environ:
        return
    with suppress(ImportError, OSError, AttributeError):  # Only glibc has the function.
        import ctypes

        mallopt = ctypes.CDLL(None).mallopt
        # Each with its number in malloc.h.
        settings = (("MALLOC_TRIM_THRESHOLD_", -1, _KEPT_BYTES), ("MALLOC_MMAP_THRESHOLD_", -3, _MAPPED_BYTES))
        for variable, number, size_bytes in settings:
            if os.environ.setdefault(variable, str(size_bytes)) == str(size_bytes):
                mallopt(number, size_bytes)


def _open_closed_streams() -> None:
    """Put the null device where a standard stream is closed, or the next file opened would take its number and its output."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            # The lowest number that is free is this stream's own, as those below it are open by now.
            descriptor = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(descriptor, "w" if number else "r", encoding="utf-8"))


class _Forgiving(io.FileIO):
    """A file whose failed writes are lost and nothing else: the disk is full, or the reader went away."""

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


def _let_standard_error_fail() -> None:
    """Let what cannot be said on standard error end nothing: no recording, and no exit code that says something else."""
    # A terminal is never full; one that was closed is handled where commands are run.
    if not sys.stderr.isatty():
        raw = _Forgiving(sys.stderr.fileno(), "w", closefd=False)
        encoding, errors = sys.stderr.encoding, sys.stderr.errors
        sys.stderr = io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors, line_buffering=True, write_through=True)
