"""Single keys, typed on a pseudo-terminal."""

from __future__ import annotations

import os
import pty
import sys
import termios
import time
import types
from collections.abc import Iterator
from typing import TextIO

import pytest

from imufield.guide.view.terminal import Keyboard

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are a POSIX thing")


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, TextIO]]:
    """Put a terminal in place of standard input; return the end where one types, and that input."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as screen:
        monkeypatch.setattr(sys, "stdin", screen)
        yield ours, screen
    os.close(ours)


def typed(keyboard: Keyboard, count: int) -> str:
    """Read until so many characters have come; the kernel hands them over when it likes."""
    found, until_s = "", time.monotonic() + 60
    while len(found) < count and time.monotonic() < until_s:
        found += keyboard.read()
    return found


def test_keys_come_without_enter_and_in_lower_case(terminal: tuple[int, TextIO]) -> None:
    ours, _ = terminal
    with Keyboard() as keyboard:
        assert keyboard.read() == ""
        os.write(ours, b"Rs")
        assert typed(keyboard, 2) == "rs"
        os.write(ours, "ä".encode() + b"q")
        assert typed(keyboard, 1) == "q"


def test_the_terminal_is_as_it_was_whatever_happens(terminal: tuple[int, TextIO]) -> None:
    _, screen = terminal
    before = termios.tcgetattr(screen.fileno())
    keyboard = Keyboard()

    def fail() -> None:
        with keyboard:
            assert termios.tcgetattr(screen.fileno()) != before
            raise RuntimeError("on the way")

    with pytest.raises(RuntimeError):
        fail()
    assert termios.tcgetattr(screen.fileno()) == before
    assert keyboard.read() == ""


def test_where_there_is_no_terminal_nobody_types(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull) as nothing:  # noqa: PTH123  (os.devnull is no path of ours)
        monkeypatch.setattr(sys, "stdin", nothing)
        with Keyboard() as keyboard:
            assert keyboard.read() == ""
    monkeypatch.setattr(sys, "stdin", None)
    with Keyboard() as keyboard:
        assert keyboard.read() == ""


def test_an_end_of_file_ends_the_reading(monkeypatch: pytest.MonkeyPatch, terminal: tuple[int, TextIO]) -> None:
    with Keyboard() as keyboard:
        reader, writer = os.pipe()
        os.close(writer)
        monkeypatch.setattr(keyboard, "_descriptor", reader)
        assert keyboard.read() == ""
        assert keyboard.read() == ""
        os.close(reader)


def test_windows_keys_come_from_its_own_library(monkeypatch: pytest.MonkeyPatch) -> None:
    waiting = list("Qr")
    library = types.SimpleNamespace(kbhit=lambda: bool(waiting), getwch=lambda: waiting.pop(0))
    monkeypatch.setitem(sys.modules, "msvcrt", library)
    monkeypatch.setattr("imufield.guide.view.terminal.os", types.SimpleNamespace(name="nt"))
    assert Keyboard().read() == "qr"
