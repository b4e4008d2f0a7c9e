"""The commands that a page has started, each a process of its own: what they say, how they end, how they are ended."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import IO

from imufield.dataclass import asdict, dataclass, field
from imufield.errors import EXIT_INTERRUPTED, UsageError
from imufield.limits import LONGEST_CLOSING_S
from imufield.progress import ERASE
from imufield.sentences import Sentences, printable
from imufield.web.board import Json

sentence = Sentences(__package__)

MOST_AT_ONCE = 4
"""Commands at once: an emulated instrument, a capture, and two that compute. The next one waits for its turn."""
MOST_WAITING = 16
"""A page asks for one thing after the other: more commands than a person starts."""
LONGEST_OUTPUT = 1 << 22
"""Characters of one line: the parameters of a thousand positions take half of it."""
END_S = 2 * LONGEST_CLOSING_S
"""Twice what a command that is interrupted has by itself; then it is killed."""
PROGRESS = "progress"
# Live values of the guide, which has a page of its own for them.
_PASSING = ("turning", "holding")


class Jobs:
    """Starts commands and tells what becomes of them.

    Parameters
    ----------
    tell : callable
        Given what happens, from threads of the jobs; nothing where only what runs is to be shown anew.
    """

    def __init__(self, tell: Callable[..., None]) -> None:
        self._tell = tell
        self._lock = threading.Lock()
        self._started = 0
        self._heads: dict[int, _Head] = {}
        self._waiting: dict[int, list[str]] = {}
        self._running: dict[int, subprocess.Popen[str]] = {}
        self._ending: set[int] = set()  # Asked to end: nobody is given one of these.
        self._alone: set[int] = set()
        self._handed_out: set[int] = set()  # Whoever was given one of these has not begun to read it yet.

    def start(self, action: str, values: Json, words: list[str], *, is_alone: bool = False) -> int:
        """Start ``imufield WORDS``, now or when another has ended, and return its number.

        With ``is_alone`` one of the same action at the same port that runs is returned in its place; one that is ending is
        waited for.

        Raises
        ------
        UsageError
            If too many are waiting.
        """
        with self._lock:
            same = [number for number in self._at(_place(action, values)) if is_alone and number not in self._ending]
            if same:
                self._handed_out.add(same[0])
                return same[0]
            if len(self._waiting) >= MOST_WAITING:
                raise UsageError(sentence("jobs.too_many", limit=MOST_WAITING))
            self._started += 1
            number = self._started
            head = _Head(job=number, action=action, values=values, command=shlex.join(["imufield", *words]))
            self._heads[number], self._waiting[number] = head, words
            if is_alone:
                self._alone.add(number)
                self._handed_out.add(number)
            # From now on it is read.
            self._handed_out -= self._offering(values.get("port"))
        self._tell(asdict(head))
        self._begin_next()
        return number

    def _at(self, place: tuple[object, ...]) -> list[int]:
        return [number for number, head in self._heads.items() if _place(head.action, head.values) == place]

    def _offering(self, port: object) -> set[int]:
        """Return the virtual instruments at a port."""
        return {number for number, head in self._heads.items() if port and head.port == port}

    def _next(self) -> int | None:
        """Return the number of the next one; what is alone begins behind the one before it, at whose port it will be."""
        places = {number: _place(self._heads[number].action, self._heads[number].values) for number in self._waiting}
        before = {number: {*self._at(place)} & self._running.keys() for number, place in places.items()}
        return next((number for number in self._waiting if not (number in self._alone and before[number])), None)

    def _begin_next(self) -> None:
        """Start those whose turn it is."""
        refused: dict[int, str | None] = {}
        with self._lock:
            while len(self._running) < MOST_AT_ONCE and (number := self._next()) is not None:
                try:
                    process = _started(self._waiting.pop(number))
                # No process or memory is left: the page hears it as it hears of any other failure.
                except OSError as error:
                    refused[number] = error.strerror
                    continue
                self._running[number] = process
                threading.Thread(target=self._follow, args=(number, process), daemon=True).start()
        for number, cause in refused.items():
            self._tell({"job": number, "said": sentence("jobs.not_started", cause=cause)})
            self._end(number, UsageError.exit_code)

    def unfinished(self) -> list[Json]:
        """Return those that have not ended, each with the newest of what it has told of each kind, the very newest last."""
        with self._lock:
            return [asdict(head) for head in self._heads.values()]

    def cancel(self, number: object) -> None:
        """Interrupt a job as Ctrl-C does; one that has ended stays ended."""
        if isinstance(number, bool) or not isinstance(number, int):
            return
        with self._lock:
            process = self._running.get(number)
            waited = self._waiting.pop(number, None)
            # A number that was never given, or has ended, may not mark the job that gets it.
            if number in self._heads:
                self._ending.add(number)
        if process is not None:
            _interrupt(process)
        elif waited is not None:
            self._end(number, EXIT_INTERRUPTED)

    def release(self, port: object) -> None:
        """End the virtual instrument at a port where nobody reads it: what it was begun for did not begin."""
        with self._lock:
            self._handed_out -= self._offering(port)
            unread = self._unread(port)
        for number in unread:
            self.cancel(number)

    def _unread(self, port: object) -> set[int]:
        is_read = any(head.values.get("port") == port for head in self._heads.values())
        return set() if is_read else self._offering(port) - self._handed_out

    def _end(self, number: int, code: int) -> None:
        with self._lock:
            self._running.pop(number, None)
            port = self._heads.pop(number).values.get("port")
            for kept in (self._ending, self._alone, self._handed_out):
                kept.discard(number)
            # A virtual instrument ends with the last command that reads it.
            unread = self._unread(port)
        self._tell({"job": number, "code": code})
        for other in unread:
            self.cancel(other)
        self._begin_next()

    def close(self) -> None:
        """End all that runs."""
        with self._lock:
            self._waiting.clear()
            left = [*self._running.values()]
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
        _interrupt(process)
        # Before it can handle it.
        self._end(number, EXIT_INTERRUPTED if code == -signal.SIGTERM else code)

    def _read(self, number: int, stream: IO[str], kind: str) -> None:
        while line := stream.readline(LONGEST_OUTPUT):
            text = line.rstrip("\n")
            if text.startswith(ERASE):
                # How far a command is: shown, and nothing to be kept.
                words = printable(text.removeprefix(ERASE))
                self._note(number, PROGRESS, {"event": PROGRESS, "words": words} if words else None)
                self._tell()
                continue
            value = _value(text) if kind == "line" else None
            if value is None:
                self._tell({"job": number, kind: printable(text)})
            elif (event := value.get("event")) not in _PASSING:
                # A result has no name: it is told once.
                if event is not None:
                    self._note(number, event, value)
                self._tell({"job": number, "value": value})
        stream.close()

    def _note(self, number: int, event: object, value: Json | None) -> None:
        """Keep the newest value of an event, behind those of the others; None forgets the one before."""
        with self._lock:
            told = self._heads[number].told
            told.pop(event, None)
            if value is not None:
                told[event] = value


@dataclass(frozen=True, slots=True, kw_only=True)
class _Head:
    job: int
    action: str
    values: Json
    command: str
    told: dict[object, Json] = field(default_factory=dict)

    @property
    def port(self) -> object:
        """That it offers."""
        return self.told.get("started", {}).get("port")


def _place(action: str, values: Json) -> tuple[object, ...]:
    """Return what a command does, and where."""
    return action, values.get("port"), values.get("bus")


def _started(words: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(  # noqa: S603  (words of the table of actions)
        # A folder of data holds no program: nothing is imported from where this one runs.
        [sys.executable, "-P", "-m", "imufield.cli.watched", *words],
        # Held open as long as this program lives: it ends what it has started even where it is killed.
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
        # Its own: a Ctrl-C at the terminal is for this program, which hands it on in order.
        start_new_session=True,
    )


def _value(line: str) -> Json | None:
    """Return the value that a line holds; None for words."""
    if line.startswith("{"):
        with suppress(ValueError):
            # What is no number in JSON would be none on its way to the pages, either.
            found: Json = json.loads(line, parse_constant=lambda _: None)
            json.dumps(found, allow_nan=False)  # "1e999" is none, and a name that says so.
            return found
    return None


def _interrupt(process: subprocess.Popen[str]) -> None:
    if process.stdin is not None:
        process.stdin.close()
