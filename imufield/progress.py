"""What a command does at the moment and how long it still takes: one line on a terminal that can draw, nothing elsewhere.

Whoever begins something that may take more than a second names it: ``with task("reading", total) as reading``, and counts
``reading.done`` where it can. A thread draws the line, so that nothing that computes asks the time. All that is printed goes
through ``hidden``.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from typing import IO, TypeVar

from imufield.dataclass import dataclass, field
from imufield.sentences import printable

AnItem = TypeVar("AnItem")

FIRST_S = 0.5
"""A command shorter than this needs no line."""
_FORESEEN_S = 1.0  # What the first moments foretell changes with each of them.
EVERY_S = 0.2  # Fast enough to be seen to move, slow enough to be read.
TOLD_EVERY_S = 1.0  # To a program, which shows it to others.
ERASE = "\x1b[K"
"""Begins each line that a program is told, and stands at the start of no other."""


@dataclass(slots=True, eq=False)
class Task:
    """Something under way: ``done`` of ``total``, in any unit; a total of 0 where nothing can be counted."""

    words: str
    total: float = 0.0
    done: float = 0.0
    _start_s: float = field(default_factory=time.monotonic)

    def __str__(self) -> str:
        past_s = time.monotonic() - self._start_s
        if not 0 < self.done <= self.total:
            return f"{self.words}: {_duration(past_s)}"
        to_go = f", {_duration(past_s * (self.total / self.done - 1))} to go" if past_s > _FORESEEN_S else ""
        return f"{self.words}: {self.done / self.total:.0%}{to_go}"


class _Line:
    """The line on standard error, of which a process has one."""

    def __init__(self) -> None:
        self.tasks: list[Task] = []  # Those under way, the outermost first.
        self.due_s = float("inf")  # When it is shown first.
        self._lock = threading.RLock()  # Of what follows; again by the same thread, as an interrupt may come anywhere.
        self._covers = 0  # How many are printing.
        self._is_drawn = False
        self.is_told = False  # To a program, in lines, and not drawn.

    def draw(self) -> None:
        with self._lock:
            if self._covers or not self.tasks or time.monotonic() < self.due_s:
                return
            # Of tasks within each other the first that can be counted: what it contains begins again and again.
            line = str(next((begun for begun in self.tasks if begun.total), self.tasks[-1]))
            self._is_drawn = True
            self._write(printable(line)[: _columns() - 1])

    def cover(self) -> None:
        with self._lock:
            self._covers += 1
            if self._is_drawn:
                self._is_drawn = False
                self._write("")

    def uncover(self) -> None:
        with self._lock:
            self._covers -= 1

    def _write(self, text: str) -> None:
        # A terminal that was closed is noticed by what has more to say.
        with suppress(OSError):
            # Back to the start of the line, and what stood there away.
            sys.stderr.write(f"{ERASE}{text}\n" if self.is_told else f"\r{ERASE}{text}")
            sys.stderr.flush()


_line = _Line()


@contextmanager
def task(words: str, total: float = 0.0) -> Iterator[Task]:
    """Name what is done inside the block."""
    begun = Task(words, total)
    _line.tasks.append(begun)
    _line.draw()
    try:
        yield begun
    finally:
        _line.tasks.remove(begun)


def one_by_one(words: str, items: Collection[AnItem]) -> Iterator[AnItem]:
    """Yield the items of a task that are alike."""
    with task(words, len(items)) as counting:
        for item in items:
            yield item
            counting.done += 1


def done() -> float:
    """Return the share that is done of the outermost task under way."""
    return next((begun.done / begun.total for begun in _line.tasks if begun.total), 0.0)


@contextmanager
def hidden() -> Iterator[None]:
    """Take the line away as long as something else is written to the terminal."""
    _line.cover()
    try:
        yield
    finally:
        _line.uncover()


def tell() -> None:
    """Tell the program that has started this one, as lines of standard error; an empty one where there is nothing to tell."""
    _line.is_told = True


@contextmanager
def shown(words: str) -> Iterator[None]:
    """Show the tasks inside the block, the outermost of which it is, if standard error can draw; it is left clean."""
    ended = threading.Event()

    def draw() -> None:
        while not ended.wait(TOLD_EVERY_S if _line.is_told else EVERY_S):
            _line.draw()

    if _line.is_told or can_draw(sys.stderr):
        _line.due_s = time.monotonic() + FIRST_S
        # A daemon: whatever ends the program is not kept waiting.
        threading.Thread(target=draw, name="progress", daemon=True).start()
    try:
        with task(words):
            yield
    finally:
        ended.set()
        _line.due_s = float("inf")
        with hidden():
            pass


def can_draw(stream: IO[str]) -> bool:
    """Whether a stream is a terminal that can move its cursor."""
    return stream.isatty() and os.environ.get("TERM", "") not in ("dumb", "unknown")


def _columns() -> int:
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns or 80
    except (OSError, ValueError):
        return 80


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
