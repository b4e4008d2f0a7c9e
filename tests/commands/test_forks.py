"""A program that is forked and one that is started by an interpreter of its own are the same to a test."""

from __future__ import annotations

import pytest

from tests.commands.conftest import Program
from tests.commands.forks import Forked
from tests.commands.pty_terminal import Terminal


# A variable that an interpreter reads at its start: no fork can follow it.
@pytest.mark.parametrize(("variables", "forked"), [({}, True), ({"PYTHONHASHSEED": "1"}, False)])
def test_both_take_the_terminal_and_its_keys(program: Program, variables: dict[str, str], forked: bool) -> None:
    port = program.emulate("--positions", "faces6", "--wait")
    screen = Terminal(program, "capture", "--port", port, "--driver", "stim300", variables=variables)
    assert isinstance(screen.process, Forked) is forked
    screen.wait_for("Latitude in degrees")
    # Only of the terminal that controls the program does a key make a signal.
    screen.type("\x03")
    assert screen.wait() == 130
    screen.close()
