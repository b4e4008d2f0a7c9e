"""The line that says how far a long task is."""

from __future__ import annotations

import io
import sys
from contextlib import closing

import numpy as np
import pytest

from imufield.commands.terminal import progress
from imufield.commands.terminal.progress import ProgressLine
from imufield.samples import SampleUnits, make_samples

BLOCK = make_samples(np.linspace(60.0, 75.0, 10_000), np.zeros((10_000, 3)), units=SampleUnits())


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FIRST_S", -1.0)
    monkeypatch.setattr(progress, "EVERY_S", -1.0)


def test_a_terminal_sees_one_line_that_goes_away(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with closing(ProgressLine("reading")) as line:
        line.feed(BLOCK)
        line.feed(BLOCK)
        line.say("solving")
    shown = terminal.getvalue().split("\r\x1b[K")
    assert shown == [
        "",
        "reading: 0.01 million samples, to 1 min 15 s",
        "reading: 0.02 million samples, to 1 min 15 s",
        "solving",
        "",
    ]


def test_a_pipe_sees_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with closing(ProgressLine("reading")) as line:
        line.feed(BLOCK)
        line.say("solving")
    assert pipe.getvalue() == ""


def test_a_short_task_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FIRST_S", 600.0)
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with closing(ProgressLine("reading")) as line:
        line.feed(BLOCK)
        line.say("solving")
    assert terminal.getvalue() == ""
