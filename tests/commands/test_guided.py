"""The guided capture in a terminal: keys in, screen out, against emulated instruments; cables pulled, processes killed."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from imufield.acquire.recording.session import Session
from tests.commands.conftest import FACES, newest, recorded_events
from tests.commands.pty_terminal import Terminal
from tests.commands.told import missing, says

if TYPE_CHECKING:
    from tests.commands.conftest import Program


def accepted(session: Session) -> list[str]:
    """Return the positions that were accepted, as they are on disk."""
    return [str(event["position"]) for event in recorded_events(session) if event["event"] == "accepted"]


def open_terminal(opened: list[Terminal], program: Program, *arguments: object, **variables: str) -> Terminal:
    terminal = Terminal(program, *arguments, variables=variables)
    opened.append(terminal)
    return terminal


def test_a_session_with_pictures_keys_big_letters_and_bell(program: Program, terminals: list[Terminal]) -> None:
    port = program.emulate("--positions", "faces6", "--hold-s", 8, "--wait", speed=8.0)
    options = ("--positions", "faces6", "--hold-s", 2, "--clock-speed", 8, "--latitude", 48)
    terminal = open_terminal(terminals, program, "capture", "--port", port, "--driver", "stim300", *options, SSH_CONNECTION="1")
    terminal.expect("positions")
    terminal.expect("goal")
    place = terminal.expect("accepted")
    terminal.type("b")
    terminal.expect("##      ##", after=place)
    terminal.type("b")
    place = terminal.expect("stillness", after=len(terminal.text))
    terminal.type("u")
    place = terminal.expect(" undone", after=place)
    # A key without a meaning is answered, one of an arrow, Delete or PageUp is none.
    terminal.type("\x1b[A\x1b[3~\x1b[5~?")
    place = terminal.expect("retake (suspect", after=place)
    terminal.type("x")
    terminal.expect("does nothing", after=place)
    assert terminal.text.count("does nothing") == terminal.text.count("'x' does nothing")
    terminal.type("ff")
    assert terminal.wait() == 0
    assert "\a" in terminal.raw
    assert "imufield capture --resume" in terminal.text
    assert newest(program).finished


@pytest.mark.parametrize("size", [(60, 20), (120, 40), (200, 60)])
def test_the_window_is_used_whatever_its_size(program: Program, terminals: list[Terminal], size: tuple[int, int]) -> None:
    """Keys and what to do in each; traces and log in the large ones, which are filled to the last line."""
    port = program.emulate("--positions", "faces6", "--hold-s", 6, "--wait")
    terminal = Terminal(program, *program.capture(port, "--quiet", "--latitude", 48), size=size)
    terminals.append(terminal)
    place = terminal.expect("1 of ")
    terminal.expect("q quit", after=place)
    assert ("signals: acc m/s^2, gyro deg/s" in terminal.text) == (size[1] >= 40)
    # From one line of keys to the next lies a whole picture: as many lines as the window has.
    place = terminal.expect("q quit", after=terminal.expect("q quit", after=len(terminal.text)))
    frame = terminal.text[:place].split("q quit")[-2]
    assert frame.count("\n") == size[1] - 1
    terminal.type("q")
    assert terminal.wait() == 0


def test_a_terminal_that_cannot_draw_gets_lines(program: Program, terminals: list[Terminal]) -> None:
    port = program.emulate("--positions", "faces6", "--hold-s", 6, "--wait")
    terminal = open_terminal(terminals, program, *program.capture(port, "--quiet", "--latitude", 48), TERM="dumb")
    place = terminal.expect("accepted")
    terminal.type("?")
    terminal.expect("retake", after=place)
    terminal.type("q")
    assert terminal.wait() == 0
    assert "\x1b" not in terminal.raw


def test_quiet_is_quiet_and_no_colour_is_none(program: Program, terminals: list[Terminal]) -> None:
    port = program.emulate("--positions", "faces6", "--hold-s", 6, "--wait")
    arguments = program.capture(port, "--quiet", "--latitude", 48)
    terminal = open_terminal(terminals, program, *arguments, NO_COLOR="1")
    terminal.expect("accepted")
    terminal.type("q")
    assert terminal.wait() == 0
    assert "\a" not in terminal.raw
    assert "\x1b[32m" not in terminal.raw
    assert "\x1b[1;32m" not in terminal.raw


def test_a_killed_capture_goes_on_where_it_was(program: Program, terminals: list[Terminal]) -> None:
    port = program.show("+x", "+y")
    terminal = open_terminal(terminals, program, *program.capture(port, "--latitude", 48))
    terminal.expect("2 of 6 done")
    # What comes in the last moments before a kill may be gone, so that it comes when both are on disk.
    while len(accepted(newest(program))) < 2:
        assert terminal.process.poll() is None
        time.sleep(0.1)
    terminal.process.send_signal(signal.SIGKILL)
    assert terminal.wait() == -signal.SIGKILL
    assert accepted(newest(program)) == ["+x", "+y"]
    again = open_terminal(
        terminals, program, "capture", "--resume", "--session", newest(program).folder, IMUFIELD_CLOCK_SPEED="16"
    )
    again.expect("2 of 6 done")
    again.type("ff")
    assert again.wait() == 0
    assert len(newest(program).parts) == 2


def unplug(terminal: Terminal, emulator: subprocess.Popen[str], link: Path) -> int:
    """Take the instrument away behind the first position; return where the screen says that it is gone."""
    place = terminal.expect("accepted")
    # The link first: the number of its pseudo-terminal is free at once, and may be that of another test's terminal next.
    link.unlink()
    emulator.kill()
    emulator.wait()
    return terminal.expect("N O   L I N K", after=place)


def test_unplugged_and_plugged_in_again(program: Program, terminals: list[Terminal]) -> None:
    link = program.folder / "imu"
    first = program.emulate("--positions", "faces6", "--hold-s", 6, "--link", link)
    emulator = program.started[-1]
    terminal = open_terminal(terminals, program, *program.capture(first, "--latitude", 48))
    place = unplug(terminal, emulator, link)
    program.emulate("--positions", "faces6", "--hold-s", 6, "--link", link)
    place = terminal.expect("link ok", after=place)
    terminal.expect("of 6 done", after=place)
    terminal.type("q")
    assert terminal.wait() == 0
    assert not newest(program).finished


@pytest.mark.parametrize(
    ("driver", "options", "facts"),
    [("stim300", ("--seed", 2), ("--resume",)), ("witmotion", (), ("10 s",)), ("stim300", ("--seed", 1), ())],
    ids=["another serial number", "another kind", "the same"],
)
def test_who_is_there_behind_a_reconnection(
    program: Program, terminals: list[Terminal], driver: str, options: tuple[object, ...], facts: tuple[str, ...]
) -> None:
    link = program.folder / "imu"
    port = program.show("+x", "-x", options=("--link", link, "--seed", 1))
    first = program.started[-1]
    terminal = open_terminal(terminals, program, *program.capture(port, "--latitude", 48))
    place = unplug(terminal, first, link)
    program.emulate("--positions", "none", "--link", link, *options, driver=driver)
    if not facts:
        terminal.expect("link ok", after=place)
        terminal.type("q")
    assert terminal.wait() == (3 if facts else 0)
    assert not missing(terminal.text, *facts)
    first_accepted, *later = accepted(newest(program))
    assert first_accepted == "+x"
    # The same instrument lies on another side by now, which is measured unless the key comes first.
    assert not (facts and later)


def test_a_stopped_process_goes_on_where_it_was(program: Program, terminals: list[Terminal]) -> None:
    """What a suspended computer does: the program stands still, the instrument goes on, the host's clock jumps."""
    port = program.show(*FACES)
    terminal = open_terminal(terminals, program, *program.capture(port, "--latitude", 48))
    place = terminal.expect("accepted")
    terminal.process.send_signal(signal.SIGSTOP)
    time.sleep(3.0)
    terminal.process.send_signal(signal.SIGCONT)
    place = terminal.expect("of 6 done", after=place)
    assert terminal.wait() == 0
    assert "accuracy so far (1 sigma): bias" in " ".join(terminal.text.split())
    session = newest(program)
    assert session.finished
    assert len(session.parts) == 1
    assert program.run("solve", session.folder).returncode == 0


def test_a_full_disk_ends_with_a_sentence_and_a_resume(program: Program, terminals: list[Terminal]) -> None:
    port = program.show("+x", rate_hz=500)
    options = program.capture(port, "--latitude", 48)
    limit = 500_000
    full = Terminal(program, *options, at_start=[("limit_file_size", limit)])
    terminals.append(full)
    assert full.wait() == 4
    part = newest(program).parts[-1].relative_to(program.folder)
    assert says(full.text, "", "files.size_limit", path=part, cause=os.strerror(errno.EFBIG), advice="")
    assert "1 of 6 positions measured so far" in full.text
    assert accepted(newest(program)) == ["+x"]
    folder = newest(program).folder
    again = open_terminal(terminals, program, "capture", "--resume", "--session", folder, IMUFIELD_CLOCK_SPEED="16")
    again.expect("1 of 6 done")
    again.type("ff")
    assert again.wait() == 0
    assert len(newest(program).parts) == 2


def test_whole_turns_are_asked_for_after_the_positions(program: Program, terminals: list[Terminal]) -> None:
    port = program.emulate("--positions", "none")
    terminal = open_terminal(terminals, program, *program.capture(port, "--rotations", "rolled", "--latitude", 48))
    terminal.expect("accepted")
    terminal.type("sssss")
    terminal.expect("R O L L")
    terminal.type("ff")
    assert terminal.wait() == 0
    assert newest(program).metadata["guide"]["rotations"] == "horizontal"
    refused = program.run(*program.capture(port, "--rotations", "sideways"))
    assert refused.returncode == 2
    unknown = {"name": "rotations", "value": "sideways", "choices": ("rolled", "table")}
    assert says(refused.stderr, "commands/options", "shared.unknown_choice", **unknown)
