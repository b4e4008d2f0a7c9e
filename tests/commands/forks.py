"""A program as a process that is forked from one that has imported it already: half a second to a second less for each.

It is a process like any other: its own streams, folder, variables, process number, signals and exit code.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from tests.commands.fork_server import nobody_else

SERVER = Path(__file__).with_name("fork_server.py")
# As readers of other programs' files are started; libraries look when they are imported.
AT_IMPORT = {**{f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}, "ARROW_DEFAULT_MEMORY_POOL": "system"}
# Variables that an interpreter reads at its start, and libraries at their import.
READ_AT_START = ("PYTHON", "LC_", "LANG", "OPENBLAS", "TYPER", "FORCE_COLOR", "PY_COLORS", "TERMINAL_WIDTH")
ENDED_UNSEEN = 1 << 8


def can_fork(variables: Mapping[str, str], options: Mapping[str, Any]) -> bool:
    """Whether a fork does what a new interpreter would do."""
    return options.get("preexec_fn") is None and not any(name.startswith(READ_AT_START) for name in variables)


@cache
def server(program: str) -> socket.socket:
    """Return a connection to the process to fork a program from: those of a test run share one, which ends with them."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", f"of{os.getpid()}")
    address = Path(tempfile.gettempdir(), f"imufield-{program}-{run}")
    ours = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with nobody_else():
        if not address.exists():
            start(program, address)
        ours.connect(str(address))
    atexit.register(ours.close)
    return ours


def start(program: str, address: Path) -> None:
    """Start the process to fork a program from; it can be asked at once."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(address))
        listener.listen(128)
        listener.set_inheritable(True)
        # Nobody waits for its end: it may outlive the one that starts it.
        os.posix_spawn(
            sys.executable,
            [sys.executable, str(SERVER), str(listener.fileno()), program],
            {**os.environ, **AT_IMPORT},
            file_actions=[(os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)],
            setsid=True,
        )


class Forked(subprocess.Popen[str]):
    """``imufield`` with these arguments, as ``subprocess.Popen`` would start it, or another program of ``fork_server.py``.

    ``at_start`` names functions of ``at_start.py``, each with its arguments, that are called first, ``modules`` what is
    imported before the fork.
    """

    def __init__(
        self,
        arguments: list[str],
        *,
        program: str = "imufield",
        at_start: Iterable[Sequence[object]] = (),
        modules: Iterable[str] = (),
        **options: Any,
    ) -> None:
        self._program, self._at_start, self._modules = program, [*at_start], [*modules]
        self._report = -1
        super().__init__(arguments, **options)

    def _execute_child(self, args: list[str], executable: object, preexec_fn: object, *others: Any) -> None:
        _, _, folder, environment, _, _, _, read_in, write_in, read_out, write_out, read_error, write_error, *rest = others
        self._report, report = os.pipe()
        streams = [own if given == -1 else given for own, given in enumerate((read_in, write_out, write_error))]
        wanted = {
            "arguments": args,
            "folder": str(folder),
            "environment": environment,
            "session": rest[5],
            "at_start": self._at_start,
            "modules": self._modules,
        }
        socket.send_fds(server(self._program), [json.dumps(wanted).encode()], [*streams, report])
        os.close(report)
        self.pid = self._read_report()
        self._child_created = True
        self._close_pipe_fds(read_in, write_in, read_out, write_out, read_error, write_error)  # type: ignore[attr-defined]

    def _read_report(self) -> int:
        data = os.read(self._report, 4)
        return struct.unpack("i", data)[0] if data else ENDED_UNSEEN

    def _try_wait(self, wait_flags: int) -> tuple[int, int]:
        if wait_flags & os.WNOHANG and not select.select([self._report], [], [], 0)[0]:
            return 0, 0
        status = self._read_report()
        os.close(self._report)
        return self.pid, status

    def _internal_poll(self, *_: object, **__: object) -> int | None:
        # Another thread that waits for the end reads the report, and closes it.
        lock: threading.Lock = self._waitpid_lock  # type: ignore[attr-defined]
        if lock.acquire(blocking=False):
            try:
                if self.returncode is None and self._report >= 0:
                    process, status = self._try_wait(os.WNOHANG)
                    if process:
                        self._handle_exitstatus(status)  # type: ignore[attr-defined]
            finally:
                lock.release()
        return self.returncode
