"""Single keys from the terminal, without waiting for Enter and without blocking."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from types import TracebackType
from typing import Any, Self


class Keyboard:
    """Keys typed since the last look; nothing at all where standard input is no terminal.

    Use as a context manager: the terminal is put back as it was, whatever happens. Ctrl-C keeps its meaning.
    """

    def __init__(self) -> None:
        self._descriptor: int | None = None
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        if os.name == "posix" and sys.stdin is not None and sys.stdin.isatty():
            import termios
            import tty

            descriptor = self._descriptor = sys.stdin.fileno()
            self._before = termios.tcgetattr(descriptor)
            tty.setcbreak(descriptor)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._descriptor is not None and self._before is not None:
            import termios

            # The terminal may be closed already; then there is nothing to put back.
            with suppress(termios.error):
                termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)
            self._descriptor = None

    def read(self) -> str:
        """Return the characters typed since the last call, lower case, "" when there are none."""
        if os.name == "nt":
            return _read_windows()
        if self._descriptor is None:
            return ""
        import select

        typed = ""
        while select.select([self._descriptor], [], [], 0)[0]:
            data = os.read(self._descriptor, 64)
            if not data:
                self._descriptor = None  # end of file: the terminal went away
                break
            typed += data.decode("ascii", "ignore")
        return typed.lower()


def _read_windows() -> str:
    import importlib

    msvcrt: Any = importlib.import_module("msvcrt")
    typed = ""
    while msvcrt.kbhit():
        typed += msvcrt.getwch()
    return typed.lower()
