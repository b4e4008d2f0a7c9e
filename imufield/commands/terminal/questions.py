"""Questions to the person at the terminal; one Ctrl-C ends them, whenever it comes."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable
from typing import TypeVar

from imufield.commands.terminal.output import NoAnswer, echo, say
from imufield.deliver.parameters.printed_numbers import hanging
from imufield.errors import ImufieldError
from imufield.progress import hidden

Answer = TypeVar("Answer")

LOOK_S = 0.1
"""How long an interrupt may go unnoticed."""


def ask(question: str) -> str:
    """Return what is typed to a question, without the blanks around it.

    ``input`` loses an interrupt that comes when the question is shown but its read has not begun:
    the signal is noted, and the read waits for a line all the same. Here a read begins when the line is there.

    Raises
    ------
    NoAnswer
        At the end of the input.
    """
    with hidden():
        echo(hanging("", f"{question}:"), end=" ")
        _wait_for_line()
        line = sys.stdin.readline()
    if not line:
        raise NoAnswer
    return line.strip()


def ask_until(question: str, read: Callable[[str], Answer]) -> Answer:
    """Return what ``read`` makes of an answer; one that it refuses by an ``ImufieldError`` is asked again.

    Raises
    ------
    NoAnswer
        At the end of the input.
    """
    while True:
        try:
            return read(ask(question))
        except ImufieldError as error:
            say(f"{error.message}.")


def confirm(question: str) -> bool:
    """Return whether a question was answered with yes, which Enter alone is too; what is neither yes nor no is asked again.

    Raises
    ------
    NoAnswer
        At the end of the input.
    """
    while (answer := ask(f"{question} [Y/n]").lower()) not in ("", "y", "yes", "n", "no"):
        echo("Please answer y or n.")
    return not answer.startswith("n")


def _wait_for_line() -> None:
    # A pipe may hold several lines, of which all but the first would be in our buffer, where select does not see them.
    if os.name == "posix" and sys.stdin.isatty():
        while not select.select([sys.stdin], [], [], LOOK_S)[0]:
            pass
