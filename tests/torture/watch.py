"""Run a command in this process and watch what it does: time, memory, files written, programs started, code loaded."""

from __future__ import annotations

import contextlib
import io
import os
import resource
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from imufield.acquire.formats import foreign_file_reader
from imufield.cli.run import run

LONGEST_S = 10
"""Of processor time, so that a busy machine is no hang; waiting for something is caught by the test's time limit."""
MOST_MEMORY = 1 << 30
"""Bytes of address space beyond what the test process has."""
NEVER = {"os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen", "pickle.find_class", "socket.connect"}
"""What no file may lead to."""
READER = [sys.executable, "-P", foreign_file_reader.__file__]
"""The one exception, with a kind and a file's name behind it."""
EXIT_CODES = {0, 2, 3, 4, 5, 6, 7}
_WRITING = 0o3
"""O_WRONLY and O_RDWR of the flags of open()."""


@dataclass
class _Watch:
    """What the audit hook looks at; hooks cannot be taken away, so it is there once and for all."""

    allowed: Path | None = None
    seen: list[str] = field(default_factory=list)

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.allowed is None:
            return
        if event in NEVER and not (event == "subprocess.Popen" and [*arguments[1]][:3] == READER):
            self.seen.append(f"{event} {arguments!r}")
        if event == "open" and arguments[2] & _WRITING and isinstance(arguments[0], str | bytes):
            path = Path(arguments[0].decode() if isinstance(arguments[0], bytes) else arguments[0])
            allowed = any(path.resolve().is_relative_to(place) for place in (self.allowed, *_own_places()))
            if not (allowed or path.is_relative_to("/dev") or "__pycache__" in path.parts):
                self.seen.append(f"wrote {path}")


def _own_places() -> list[Path]:
    """Return where the program keeps what only saves it time."""
    return [Path(os.environ[name], "imufield").resolve() for name in ("XDG_CACHE_HOME", "XDG_STATE_HOME")]


_WATCH = _Watch()
sys.addaudithook(_WATCH)


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    error: str


class HangError(BaseException):
    """A command took longer than allowed; no handler of the program may catch this."""


def attempt(arguments: list[str], allowed: Path) -> Outcome:
    """Run one command that may write below ``allowed`` only.

    Raises
    ------
    HangError, MemoryError, AssertionError
        If it takes too long, too much memory, or does what no file may lead to.
    """
    out, error = io.StringIO(), io.StringIO()
    _WATCH.seen.clear()
    with _limits(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        _WATCH.allowed = allowed.resolve()
        try:
            code = run(arguments)
        finally:
            _WATCH.allowed = None
    assert not _WATCH.seen, [*_WATCH.seen]
    assert code in EXIT_CODES, (code, error.getvalue())
    assert (code == 0) or error.getvalue().strip(), f"left with {code} and said nothing"
    return Outcome(code, out.getvalue(), error.getvalue())


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    present = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = signal.signal(signal.SIGPROF, _hang)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    resource.setrlimit(resource.RLIMIT_AS, (present + MOST_MEMORY, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _hang(number: int, frame: FrameType | None) -> None:
    raise HangError(f"longer than {LONGEST_S} s")
