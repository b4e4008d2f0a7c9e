"""The commands that a page has started, each a process of its own: what they say, how they end, how they are ended."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import IO

from imufield.errors import UsageError
from imufield.sentences import Sentences, printable
from imufield.web.board import Json

sentence = Sentences(__package__)

MOST_AT_ONCE = 4
"""Commands at once: an emulated instrument, a capture, and two that compute."""
LONGEST_OUTPUT = 1 << 22
"""Characters of one line: the parameters of a thousand positions take half of it."""
END_S = 5.0
"""What is interrupted closes its files; what has not ended by then is killed."""
# Live values of the guide, which has a page of its own for them.
_PASSING = ("turning", "holding")


class Jobs:
    """Starts commands and tells what becomes of them.

    Parameters
    ----------
    tell : callable
        Given what happens, from threads of the jobs.
    """

    def __init__(self, tell: Callable[[Json], None]) -> None:
        self._tell = tell
        self._lock = threading.Lock()
        self._started = 0
        self._running: dict[int, tuple[subprocess.Popen[str], Json]] = {}

    def start(self, action: str, values: Json, words: list[str]) -> int:
        """Start ``imufield WORDS`` and return its number.

        Raises
        ------
        UsageError
            If too many are running.
        """
        with self._lock:
            if len(self._running) >= MOST_AT_ONCE:
                raise UsageError(sentence("jobs.too_many", limit=MOST_AT_ONCE))
            process = subprocess.Popen(  # noqa: S603  (words of the table of actions)
                # A folder of data holds no program: nothing is imported from where this one runs.
                [sys.executable, "-P", "-m", "imufield", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                # Its own: a Ctrl-C at the terminal is for this program, which hands it on in order.
                start_new_session=True,
            )
            self._started += 1
            number = self._started
            head: Json = {
                "job": number,
                "action": action,
                "values": values,
                "command": shlex.join(["imufield", *words]),
            }
            self._running[number] = process, head
        self._tell(head)
        threading.Thread(target=self._follow, args=(number, process), daemon=True).start()
        return number

    def running(self) -> list[Json]:
        """Return the heads of those that have not ended."""
        with self._lock:
            return [head for _, head in self._running.values()]

    def cancel(self, number: object) -> None:
        """Interrupt a job as Ctrl-C does; one that has ended stays ended."""
        with self._lock:
            process, _ = self._running.get(number, (None, None)) if isinstance(number, int) else (None, None)
        if process is not None:
            _interrupt(process)

    def close(self) -> None:
        """End all that runs."""
        with self._lock:
            left = [process for process, _ in self._running.values()]
        for process in left:
            _interrupt(process)
        for process in left:
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()

    def _follow(self, number: int, process: subprocess.Popen[str]) -> None:
        """Tell what a process says until it has ended."""
        if process.stdout is None or process.stderr is None:
            return
        errors = threading.Thread(target=self._read, args=(number, process.stderr, "said"), daemon=True)
        errors.start()
        self._read(number, process.stdout, "line")
        errors.join()
        code = process.wait()
        with self._lock:
            del self._running[number]
        self._tell({"job": number, "code": code})

    def _read(self, number: int, stream: IO[str], kind: str) -> None:
        while line := stream.readline(LONGEST_OUTPUT):
            text = line.rstrip("\n")
            value = _value(text) if kind == "line" else None
            if value is None:
                self._tell({"job": number, kind: printable(text)})
            elif value.get("event") not in _PASSING:
                self._tell({"job": number, "value": value})
        stream.close()


def _value(line: str) -> Json | None:
    """Return the value that a line holds; None for words."""
    if line.startswith("{"):
        with suppress(ValueError):
            found: Json = json.loads(line)
            return found
    return None


def _interrupt(process: subprocess.Popen[str]) -> None:
    with suppress(ProcessLookupError):
        # All of its group, as a terminal does: what it has started itself hears it, too.
        os.killpg(process.pid, signal.SIGINT)
