"""Starts a program without starting an interpreter: the modules are imported once, each program is a fork of this process.

It is imufield itself, or the reader of files of other programs. Run by ``forks.py``, which asks through a socket: a message
with the command, and with it the three standard streams and a pipe, to which the number of the program's process is written
and later how it ended.
"""

from __future__ import annotations

import array
import atexit
import contextlib
import fcntl
import gc
import importlib
import io
import json
import os
import pkgutil
import runpy
import select
import signal
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

MESSAGE_BYTES = 1 << 20
MOST_DESCRIPTORS = 4096
EMULATOR_SLICE_S = 0.03
# What commands import when they run: imported here once for all of them, beside the modules of the commands themselves.
MODULES = (
    "numpy.random",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "rich.live",
    "can",
    "cantools",
    "imufield.deliver.exports.registry",
    "imufield.guide.view.sound",
    "imufield.guide.view.terminal",
)
SELDOM_RUN = ("study",)
# These need no instrument and no session; typer and rich import much of themselves only for such a line.
RUN_FIRST = (["capture", "--help"], ["devices"], ["solve", "nowhere"])


@contextlib.contextmanager
def nobody_else() -> Iterator[None]:
    """Keep other clients from coming, and servers from leaving."""
    with Path(__file__).open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def serve(listener: socket.socket, run_program: Callable[[], None]) -> None:
    """Fork for each message until the last client has gone; does not return in a fork."""
    clients: list[socket.socket] = []
    reports: dict[int, int] = {}
    ended, ends = os.pipe()
    for end in (ended, ends):
        os.set_blocking(end, False)
    # A handler, or the signal would not be written to the pipe.
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.set_wakeup_fd(ends, warn_on_full_buffer=False)
    while True:
        heard: list[Any] = [listener, ended, *clients]
        ready = select.select(heard, [], [])[0]
        if ended in ready:
            os.read(ended, MESSAGE_BYTES)
            tell_ends(reports)
        if listener in ready:
            clients.append(listener.accept()[0])
        for client in clients[:]:
            if client not in ready:
                continue
            message, ancillary, _, _ = client.recvmsg(MESSAGE_BYTES, socket.CMSG_SPACE(4 * array.array("i").itemsize))
            if message:
                fork(message, ancillary, run_program, reports)
                continue
            clients.remove(client)
            client.close()
            if not clients and has_closed(listener):
                return


def has_closed(listener: socket.socket) -> bool:
    """Close the address unless somebody has just come."""
    with nobody_else():
        if select.select([listener], [], [], 0)[0]:
            return False
        Path(listener.getsockname()).unlink()
        listener.close()
        return True


def fork(message: bytes, ancillary: list[Any], run_program: Callable[[], None], reports: dict[int, int]) -> None:
    """Start the program that a message asks for."""
    descriptors = array.array("i")
    for _, _, data in ancillary:
        descriptors.frombytes(data)
    wanted = json.loads(message)
    with contextlib.suppress(ImportError):  # The program itself says what it misses.
        for name in wanted["modules"]:
            importlib.import_module(name)
    process = os.fork()
    if not process:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        leave(run_command(run_program, wanted, descriptors))
    *streams, report = descriptors
    for descriptor in streams:
        os.close(descriptor)
    reports[process] = report
    os.write(report, struct.pack("i", process))


def tell_ends(reports: dict[int, int]) -> None:
    """Write how each program that has ended did so, and close its pipe."""
    with contextlib.suppress(ChildProcessError):
        while True:
            process, status = os.waitpid(-1, os.WNOHANG)
            if not process:
                return
            report = reports.pop(process)
            with contextlib.suppress(BrokenPipeError):
                os.write(report, struct.pack("i", status))
            os.close(report)


def run_command(run_program: Callable[[], None], wanted: dict[str, Any], descriptors: array.array[int]) -> int:
    """Become the program: its streams, folder, variables and arguments; return its exit code."""
    if wanted["session"]:
        os.setsid()
    for number, descriptor in enumerate(descriptors[:3]):
        os.dup2(descriptor, number)
    # What is open here would keep others waiting, and a file that the program opens has the number it would have.
    os.closerange(3, MOST_DESCRIPTORS)
    os.chdir(wanted["folder"])
    os.environ.clear()
    os.environ.update(wanted["environment"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    importlib.import_module("at_start").do(wanted["at_start"])
    encoding = sys.__stdout__.encoding if sys.__stdout__ else "utf-8"
    for number, (name, errors) in enumerate((("stdin", "strict"), ("stdout", "strict"), ("stderr", "backslashreplace"))):
        stream = open(number, "w" if number else "r", encoding=encoding, errors=errors, closefd=False)  # noqa: SIM115
        if number:
            stream.reconfigure(line_buffering=number == 2 or os.isatty(number))
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    sys.argv = ["imufield", *wanted["arguments"]]
    try:
        run_program()
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else int(left.code is not None)
    except BaseException:  # noqa: BLE001  (a defect leaves its traceback, as from an interpreter)
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


def run_imufield() -> None:
    """Run the program itself."""
    from imufield.cli import main

    main()


def run_reader() -> None:
    """Run the program that reads a file of another program."""
    runpy.run_module("imufield.acquire.formats.foreign_file_reader", run_name="__main__", alter_sys=True)


def leave(code: int) -> None:
    """Leave as the interpreter does it, but without taking its modules apart: they are this process's own copy by then."""
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads
    atexit._run_exitfuncs()
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        # What the interpreter leaves with when its output cannot be written.
        code = 120
    os._exit(code)


def warm_up() -> None:
    """Import everything, and run what needs nothing for what is imported and made only then."""
    import imufield.commands
    import imufield.simulate.emulator.core

    # Half of the time of a captured session goes in waking up, and at 16 times the speed nobody needs it so often.
    imufield.simulate.emulator.core.SLICE_S = EMULATOR_SLICE_S
    for name in MODULES:
        __import__(name)
    for module in pkgutil.iter_modules(imufield.commands.__path__):
        if module.name not in SELDOM_RUN:
            __import__(f"imufield.commands.{module.name}")
    from imufield.cli.run import run

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        for arguments in RUN_FIRST:
            run(arguments)


def warm_up_reader() -> None:
    """Import what all readers need."""
    import numpy.lib.format  # noqa: F401


PROGRAMS = {"imufield": (warm_up, run_imufield), "reader": (warm_up_reader, run_reader)}

if __name__ == "__main__":
    begin, run_program = PROGRAMS[sys.argv[2]]
    begin()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # A collection in a fork would copy every page it looks at.
    gc.collect()
    gc.freeze()
    serve(socket.socket(fileno=int(sys.argv[1])), run_program)
