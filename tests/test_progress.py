"""The line that says what a command does and how long it still takes."""

from __future__ import annotations

import gc
import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr

import pytest

from imufield import progress
from imufield.progress import ERASE, Task, hidden, one_by_one, shown, task

ERASED = f"\r{ERASE}"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True, scope="module")
def collect_abandoned_readings() -> None:
    """Collect readings that tests before have left in their middle: tasks until the collector comes, which is seldom here."""
    gc.collect()


@pytest.fixture(autouse=True)
def no_open_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin without a task."""
    monkeypatch.setattr(progress._line, "tasks", [])


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Show the first line at once, and no other than those that a task begins with."""
    monkeypatch.setattr(progress, "FIRST_S", -1.0)
    monkeypatch.setattr(progress, "EVERY_S", 600.0)
    monkeypatch.setenv("TERM", "xterm")
    return Terminal()


@contextmanager
def command(stream: io.StringIO) -> Iterator[None]:
    """Be a command that writes to this stream."""
    with redirect_stderr(stream), shown("command"):
        yield


def words(stream: io.StringIO) -> list[str]:
    """Return what was drawn, without the times."""
    return [line.partition(":")[0] for line in stream.getvalue().split(ERASED)]


def test_a_terminal_sees_what_is_done_and_is_left_clean(terminal: Terminal) -> None:
    with command(terminal):
        with task("reading"):
            pass
        with task("solving"):
            pass
    assert words(terminal) == ["", "command", "reading", "solving", ""]
    assert terminal.getvalue().endswith(ERASED)


def test_an_interrupt_leaves_it_clean_too(terminal: Terminal) -> None:
    with pytest.raises(KeyboardInterrupt), command(terminal), task("reading"):
        raise KeyboardInterrupt
    assert words(terminal) == ["", "command", "reading", ""]
    with task("afterwards"):
        assert words(terminal)[-1] == ""


def test_what_is_printed_stands_on_a_line_of_its_own(terminal: Terminal) -> None:
    with command(terminal):
        with hidden():
            terminal.write("found\n")
            with task("beneath"):
                pass
        with task("reading"):
            pass
    assert words(terminal) == ["", "command", "found\n", "reading", ""]


def test_what_contains_others_and_is_counted_is_what_is_shown(terminal: Terminal) -> None:
    with command(terminal):
        for _ in one_by_one("methods", "ab"):
            with task("within", 10):
                pass
    assert words(terminal) == ["", "command", *["methods"] * 3, ""]
    assert "methods: 50%" in terminal.getvalue()


def test_a_terminal_that_cannot_draw_sees_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "dumb")
    with command(terminal), task("reading"):
        pass
    assert terminal.getvalue() == ""


@pytest.mark.usefixtures("terminal")
def test_a_pipe_sees_nothing() -> None:
    pipe = io.StringIO()
    with command(pipe), task("reading"):
        pass
    assert pipe.getvalue() == ""


def test_a_program_is_told_in_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FIRST_S", -1.0)
    monkeypatch.setattr(progress._line, "is_told", True)
    pipe = io.StringIO()
    with command(pipe), task("reading"):
        pass
    lines = pipe.getvalue().splitlines()
    assert [line.partition(":")[0] for line in lines] == [f"{ERASE}command", f"{ERASE}reading", ERASE]


def test_a_short_command_shows_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FIRST_S", 600.0)
    with command(terminal), task("reading"):
        pass
    assert terminal.getvalue() == ""


def test_a_terminal_that_was_closed_ends_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_: str) -> int:
        raise OSError(5, "the terminal was closed")

    monkeypatch.setattr(terminal, "write", gone)
    with command(terminal), task("reading"):
        pass


@pytest.mark.parametrize(
    ("done", "past_s", "line"),
    [
        (0, 12, "reading: 12 s"),
        (5, 0.5, "reading: 50%"),
        (5, 12, "reading: 50%, 12 s to go"),
        (1, 60, "reading: 10%, 9 min to go"),
        (1, 3600, "reading: 10%, 9.0 h to go"),
        (10, 12, "reading: 100%, 0 s to go"),
        # A file that has grown meanwhile.
        (11, 12, "reading: 12 s"),
    ],
)
def test_the_time_to_go_is_in_proportion(monkeypatch: pytest.MonkeyPatch, done: int, past_s: float, line: str) -> None:
    monkeypatch.setattr("time.monotonic", lambda: 100.0 + past_s)
    assert str(Task("reading", 10, done, 100.0)) == line


def test_a_line_is_no_longer_than_the_terminal_and_shows_what_controls_one(terminal: Terminal) -> None:
    with command(terminal), task("\x1b[2J" + "x" * 200):
        pass
    longest = terminal.getvalue().split(ERASED)[2]
    assert longest.startswith(r"\x1b[2J")
    assert len(longest) == 79
