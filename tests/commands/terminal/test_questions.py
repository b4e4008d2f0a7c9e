"""Questions at a terminal, answered and broken off."""

from __future__ import annotations

import os
import pty
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from imufield.commands.terminal.output import NoAnswer
from imufield.commands.terminal.questions import ask, confirm

RESCUE_S = 60.0


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Make standard input a terminal; yield the descriptor that types on it."""
    master, slave = pty.openpty()
    with os.fdopen(slave, encoding="utf-8") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        yield master
    os.close(master)


@pytest.fixture
def interrupts() -> Iterator[None]:
    """Let SIGINT interrupt, though it were ignored by who started the tests."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_that_was_only_noted_ends_the_question(keys: int) -> None:
    # A signal that another thread receives breaks off no read of this one, as one that comes just before the read begins.
    def interrupt() -> None:
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    # A question that goes on would otherwise do so for ever.
    noted, rescue = threading.Timer(0.3, interrupt), threading.Timer(RESCUE_S, os.write, (keys, b"\n"))
    rescue.start()
    try:
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012  (the interrupt must not come before)
            noted.start()
            ask("Latitude in degrees")
        assert rescue.is_alive(), "it ended when a line was typed"
    finally:
        rescue.cancel()
        rescue.join()
    noted.join()


def test_lines_typed_ahead_answer_one_question_each(keys: int, capsys: pytest.CaptureFixture[str]) -> None:
    os.write(keys, b"perhaps\nY\n 48.1 \n")
    assert confirm("Go on?")
    assert ask("Latitude in degrees") == "48.1"
    assert capsys.readouterr().out == "Go on? [Y/n]: Please answer y or n.\nGo on? [Y/n]: Latitude in degrees: "


@pytest.mark.parametrize(("answer", "meant"), [("\n", True), ("yes\n", True), ("n\n", False), ("No\n", False)])
def test_yes_or_no(keys: int, answer: str, meant: bool) -> None:
    os.write(keys, answer.encode())
    assert confirm("Go on?") is meant


def test_the_end_of_the_input_is_no_answer(keys: int) -> None:
    os.write(keys, b"\x04")
    with pytest.raises(NoAnswer):
        ask("Latitude in degrees")


def test_answers_from_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = tmp_path / "answers.txt"
    answers.write_text("n\n51\n")
    with answers.open(encoding="utf-8") as file:
        monkeypatch.setattr("sys.stdin", file)
        assert not confirm("Go on?")
        assert ask("Latitude in degrees") == "51"
        with pytest.raises(NoAnswer):
            ask("Latitude in degrees")


def test_a_narrow_terminal_breaks_no_word_of_a_question(
    keys: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    os.write(keys, b"yes\n")
    question = "Instrument, a name of the list (Enter: it is detected at each connection)"
    assert ask(question) == "yes"
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 60
    assert shown.split() == f"{question}:".split()
