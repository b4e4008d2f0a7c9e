"""What cannot be is said before anything is promised or asked."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import pytest

from imufield.errors import Reason
from tests.commands.conftest import Program
from tests.commands.pty_terminal import Terminal
from tests.commands.told import fails


@pytest.mark.parametrize("command", ["capture --latitude 48", "record", "probe", "record --driver stim300"])
def test_a_port_that_is_not_there_is_all_that_is_said(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = [*shlex.split(command), "--port", "/dev/nope"]
    fails(line, 3, Reason.PORT_NOT_FOUND, "/dev/nope", key="link_errors.absent")
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1


def test_a_bus_that_is_not_there_is_all_that_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    error = fails(["probe", "--bus", "socketcan:nope0"], 3, Reason.PORT_NOT_FOUND, "nope0")
    told = capsys.readouterr()
    assert told.err == f"imufield: {error.message.rstrip('.')}.\n"


@pytest.mark.parametrize("command", ["capture --port /dev/nope", "capture --port /dev/nope --driver stim300"])
def test_nobody_is_asked_for_a_latitude_in_vain(program: Program, command: str) -> None:
    screen = Terminal(program, *command.split())
    assert screen.wait() == 3
    assert "/dev/nope" in screen.text
    assert "atitude" not in screen.text
    screen.close()


def test_a_session_is_resumed_on_a_port_that_is_there(program: Program) -> None:
    """The port of an unfinished session is looked for before anything else, too."""
    port = program.emulate("--positions", "faces6", "--wait")
    line = program.capture(port)
    screen = Terminal(program, *line, "--session", "mine")
    screen.wait_for("Latitude in degrees")
    screen.type("\n")
    screen.wait_for("0 of 6 done")
    screen.type("q")
    assert screen.wait() == 0
    screen.close()
    settings = program.folder / "mine" / "session.toml"
    settings.write_text(settings.read_text().replace(f'port = "{port}"', 'port = "/dev/nope"'))
    again = Terminal(program, "capture", "--resume", "--session", "mine")
    assert again.wait() == 3
    assert "atitude" not in again.text
    again.close()


@pytest.mark.skipif(os.name != "posix", reason="the ports of Windows are no files")
def test_a_port_may_be_any_name_of_it(program: Program) -> None:
    port = program.emulate("--positions", "none", "--wait")
    Path(program.folder / "imu").symlink_to(port)
    done = program.run("record", "--port", "imu", "--driver", "stim300", "--duration-s", 1, "--clock-speed", 16)
    assert done.returncode == 0, done.stderr
