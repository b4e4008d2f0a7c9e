"""A capture that something ends again and again, and what must be left of it."""

from __future__ import annotations

import json
from pathlib import Path

from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.reader import read_session
from imufield.acquire.recording.session import Session
from imufield.guide.positions import scheme
from tests.commands.conftest import Program, recorded_events

SPEED = 16
SCHEME = "corners24"
ROUNDS = 8


def show_rounds(program: Program, positions: str = SCHEME) -> str:
    """Start an emulator whose operator shows all positions again and again; return its port."""
    lines = []
    for number in range(ROUNDS):
        for position in scheme(positions).positions:
            lines += ["[[position]]", f'name = "{position.name} round {number}"', f"up = {position.direction.tolist()}"]
    path = program.folder / "rounds.toml"
    path.write_text("\n".join(lines))
    return program.emulate("--positions", path, "--hold-s", 6, speed=SPEED)


def capture_into(program: Program, port: str, folder: Path, positions: str = SCHEME) -> tuple[str, ...]:
    """Return the arguments that capture these positions into a folder, or go on there."""
    resume = ("--resume",) if (folder / "session.toml").exists() else ()
    return (*program.capture(port, "--session", folder, "--json"), "--positions", positions, *resume)


def accepted_on_disk(folder: Path) -> list[str]:
    """Return the positions that were accepted, in their order."""
    return [event["position"] for event in recorded_events(Session.open(folder)) if event["event"] == "accepted"]


def bytes_on_disk(folder: Path) -> int:
    return sum(len(item.data) for item in read_session(Session.open(folder)) if isinstance(item, Chunk))


def end_and_solve(program: Program, port: str, folder: Path, positions: str = SCHEME) -> None:
    """Resume it to its end where it has none, and solve: every position is there once."""
    if not Session.open(folder).finished:
        ended = program.run(*capture_into(program, port, folder, positions))
        assert ended.returncode == 0, ended.stderr
    assert Session.open(folder).finished
    solved = program.run("solve", folder, "--json")
    assert solved.returncode == 0, solved.stderr
    names = [position["name"] for position in json.loads(solved.stdout)["position"]]
    assert sorted(names) == sorted(position.name for position in scheme(positions).positions)
