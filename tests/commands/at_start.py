"""What a program can be asked to do before it begins, by name: it is called in the process of the program."""

from __future__ import annotations

import atexit
import ctypes
import fcntl
import importlib
import os
import resource
import signal
import termios
from collections.abc import Iterable, Sequence
from pathlib import Path


def do(calls: Iterable[Sequence[object]]) -> None:
    """Call functions of this module, each given as its name and its arguments."""
    for name, *values in calls:
        globals()[str(name)](*values)


def take_terminal() -> None:
    """Make standard input the terminal that controls this session."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def limit_file_size(size: int) -> None:
    """Let no file grow beyond this, as a disk that is full."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def ignore_hangup() -> None:
    """Ignore that the terminal is closed, as ``nohup`` does."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)


def give_up_privileges() -> None:
    """Take from root, to whom nothing is forbidden, the right to pass over the permissions of files (Linux)."""
    if os.geteuid() != 0:
        return
    version_3, override, read_search = 0x20080522, 1, 2
    header, sets, library = (ctypes.c_uint32 * 2)(version_3, 0), (ctypes.c_uint32 * 6)(), ctypes.CDLL(None)
    library.capget(header, sets)
    # Effective, permitted and inheritable of the first 32 capabilities.
    for number in range(3):
        sets[number] &= ~(1 << override | 1 << read_search)
    if library.capset(header, sets):
        raise OSError("the capabilities cannot be changed")


def limit_and_measure(report: str, processor_s: int) -> None:
    """Let no process take longer, and write the most memory that one of them took when the program ends (Linux)."""
    for name, most in (("RLIMIT_CPU", processor_s), ("RLIMIT_CORE", 0), ("RLIMIT_AS", 4 << 30)):
        resource.setrlimit(getattr(resource, name), (most, resource.getrlimit(getattr(resource, name))[1]))

    def measure() -> None:
        lines = Path("/proc/self/status").read_text().splitlines()
        own_kib = int(next(line for line in lines if line.startswith("VmHWM")).split()[1])
        most_kib = max(own_kib, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
        Path(report).write_text(str(most_kib << 10))

    atexit.register(measure)


def show_progress_at_once() -> None:
    """Let commands that are over in no time say what they do, as those do that take longer."""
    vars(importlib.import_module("imufield.progress"))["FIRST_S"] = -1.0


def tell_slowness_within_a_second() -> None:
    """Let an emulated instrument say after its first second that it is too slow, not after five of them."""
    vars(importlib.import_module("imufield.simulate.emulator.core"))["_SLOW_FOR_S"] = 1.0
