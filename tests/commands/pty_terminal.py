"""The program on a terminal of its own: keys in, screen out."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import struct
import termios
import time
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.commands.conftest import Program

WAIT_S = 900.0  # Only a program that hangs takes so long, however busy the machine.
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Terminal:
    """A terminal of columns and lines with the program in it; ``at_start`` as in ``forks.Forked``."""

    def __init__(
        self,
        program: Program,
        *arguments: object,
        variables: dict[str, str] | None = None,
        at_start: Iterable[Sequence[object]] = (),
        size: tuple[int, int] = (80, 24),
    ) -> None:
        self._master, self._slave = pty.openpty()
        self._is_open = True
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
        self._before = termios.tcgetattr(self._slave)
        self.process = program.start(
            *arguments,
            # Of the tests' own terminal, where they have one, they would go before the size of this one.
            variables={"TERM": "xterm-256color", "COLUMNS": str(size[0]), "LINES": str(size[1]), **(variables or {})},
            stdin=self._slave,
            stdout=self._slave,
            stderr=self._slave,
            start_new_session=True,
            at_start=[("take_terminal",), *at_start],
        )
        self.raw = ""
        """All that was sent, control sequences included."""
        self.text = ""
        """All that was shown."""
        self._seen = 0

    def read(self, seconds: float = 0.1) -> None:
        if select.select([self._master], [], [], seconds)[0]:
            data = os.read(self._master, 65536).decode("utf-8", "replace")
            self.raw += data
            self.text += _CONTROL.sub("", data)

    def expect(self, words: str, *, after: int = 0) -> int:
        """Wait for words on the screen; return where they ended."""
        limit_s = time.monotonic() + WAIT_S
        while words not in self.text[after:]:
            assert time.monotonic() < limit_s, f"{words!r} is not in {self.text[-3000:]!r}"
            self.read()
        return self.text.index(words, after) + len(words)

    def wait_for(self, words: str) -> str:
        """Return everything shown since the last call, once these words are in it."""
        begin = self._seen
        self.expect(words, after=begin)
        self._seen = len(self.text)
        return self.text[begin:]

    def type(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    def wait(self) -> int:
        """Return the exit code; a program that was not killed has left the terminal as it was."""
        limit_s = time.monotonic() + WAIT_S
        while self.process.poll() is None and time.monotonic() < limit_s:
            # A program that writes to a terminal nobody reads would wait for ever.
            self.read()
        self.read()
        code = self.process.wait(WAIT_S)
        after = termios.tcgetattr(self._slave)
        assert code < 0 or after == self._before, (
            f"the terminal is not as it was: {self._before} became {after}, exit code {code}"
        )
        return code

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            os.close(self._slave)
            os.close(self._master)
