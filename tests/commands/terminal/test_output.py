"""Sentences on a terminal and in a pipe."""

from __future__ import annotations

import sys

import pytest

from imufield.commands.terminal.output import say

SENTENCE = "instrument: serial number N25581846020020, firmware 31, hardware E"


def test_a_terminal_gets_whole_words(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    say(SENTENCE, indent=2)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 40
    assert all(line.startswith("  ") for line in lines[1:])
    assert " ".join(line.strip() for line in lines) == SENTENCE


def test_a_pipe_gets_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    say(SENTENCE, err=True, indent=2)
    assert capsys.readouterr().err == f"{SENTENCE}\n"
