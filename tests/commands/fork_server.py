"""Starts the program without starting an interpreter: the modules are imported once, each command is a fork of this process.

Run by ``forks.py``, which asks through a socket: a message with the command, and with it the three standard streams and a
pipe. A guardian, forked first, writes the number of the program's process to the pipe and later how it ended.
"""

from __future__ import annotations

import array
import atexit
import contextlib
import fcntl
import gc
import json
import os
import signal
import socket
import struct
import sys
import termios
import threading
from typing import Any

MESSAGE_BYTES = 1 << 20
# What commands import when they run: imported here once for all of them.
MODULES = (
    "numpy.random",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "rich.live",
    "can",
    "cantools",
    "imufield.cli.run",
    "imufield.commands.apply",
    "imufield.commands.capture",
    "imufield.commands.emulate",
    "imufield.commands.import_files",
    "imufield.commands.probe",
    "imufield.commands.record",
    "imufield.commands.replay",
    "imufield.commands.solve",
    "imufield.commands.verify",
    "imufield.guide.view.sound",
    "imufield.guide.view.terminal",
)


def serve(channel: socket.socket) -> None:
    """Fork for each message until the other end closes; does not return in a fork."""
    while True:
        message, ancillary, _, _ = channel.recvmsg(MESSAGE_BYTES, socket.CMSG_SPACE(4 * array.array("i").itemsize))
        reap()
        if not message:
            return
        descriptors = array.array("i")
        for _, _, data in ancillary:
            descriptors.frombytes(data)
        if not os.fork():
            channel.close()
            if guard(descriptors[3]):
                os._exit(0)
            leave(run_command(json.loads(message), descriptors))
        for descriptor in descriptors:
            os.close(descriptor)


def reap() -> None:
    """Take in the guardians that have ended, and with them the processor time of what they guarded."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def guard(report: int) -> int:
    """Fork and return 0 in the program; in the guardian report how it ends, and return its number."""
    process = os.fork()
    if process:
        # What is open here would keep a reader of the program's output waiting.
        os.closerange(0, report)
        os.write(report, struct.pack("i", process))
        os.write(report, struct.pack("i", os.waitpid(process, 0)[1]))
    return process


def run_command(wanted: dict[str, Any], descriptors: array.array[int]) -> int:
    """Become the program: its streams, folder, variables and arguments; return its exit code."""
    if wanted["session"]:
        os.setsid()
    for number, descriptor in enumerate(descriptors[:3]):
        os.dup2(descriptor, number)
    os.closerange(3, max(descriptors) + 1)
    if wanted["terminal"]:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    os.chdir(wanted["folder"])
    os.environ.clear()
    os.environ.update(wanted["environment"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    encoding = sys.__stdout__.encoding if sys.__stdout__ else "utf-8"
    for number, (name, errors) in enumerate((("stdin", "strict"), ("stdout", "strict"), ("stderr", "backslashreplace"))):
        stream = open(number, "w" if number else "r", encoding=encoding, errors=errors, closefd=False)  # noqa: SIM115
        if number:
            stream.reconfigure(line_buffering=number == 2 or os.isatty(number))
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    sys.argv = ["imufield", *wanted["arguments"]]
    from imufield.cli import main

    try:
        main()
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else int(left.code is not None)
    except BaseException:  # noqa: BLE001  (a defect leaves its traceback, as from an interpreter)
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


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


if __name__ == "__main__":
    for name in MODULES:
        __import__(name)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # A collection in a fork would copy every page it looks at.
    gc.collect()
    gc.freeze()
    serve(socket.socket(fileno=int(sys.argv[1])))
