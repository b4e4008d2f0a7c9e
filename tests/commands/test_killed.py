"""A capture killed at random moments, twenty times: all stays but the last second."""

from __future__ import annotations

import json
import random
import subprocess
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from imufield.acquire.recording import RecordedEvent, read_session
from imufield.acquire.session import Session
from imufield.guide.positions import scheme

if TYPE_CHECKING:
    from tests.commands.conftest import Program

KILLS = 20
SPEED = 16
SCHEME = "corners24"
LAST_S = 1.0
"""What may be lost, real time: the recorder syncs every half second, and the machine may be busy."""
ROUNDS = 8


@pytest.fixture
def port(program: Program) -> str:
    """An emulator whose operator shows all positions again and again."""
    lines = []
    for number in range(ROUNDS):
        for position in scheme(SCHEME).positions:
            lines += ["[[position]]", f'name = "{position.name} round {number}"', f"up = {position.direction.tolist()}"]
    path = program.folder / "rounds.toml"
    path.write_text("\n".join(lines))
    return program.emulate("--positions", path, "--hold-s", 6, speed=SPEED)


class Watched:
    """A running capture whose events are read as they come."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.events: list[dict[str, Any]] = []
        self._measures = threading.Event()
        self.thread = threading.Thread(target=self._read)
        self.thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.endswith("}\n"):  # the last line of a killed program may be cut
                self.events.append(json.loads(line))
            if self.events and self.events[-1]["event"] in ("noise_floor", "link_back"):
                self._measures.set()

    def kill_after(self, pause_s: float, *, measuring: bool) -> None:
        """Kill it so long after its start, or after it began to measure, however busy the machine is."""
        if measuring:
            assert self._measures.wait(30)
        time.sleep(pause_s)
        self.process.kill()
        self.process.wait()
        self.thread.join()

    @property
    def last_s(self) -> float:
        times = [event["time_s"] for event in self.events if event.get("time_s") is not None]
        return max(times, default=0.0)

    def accepted_before(self, time_s: float) -> set[str]:
        return {event["position"] for event in self.events if event["event"] == "accepted" and event["time_s"] < time_s}


def events_on_disk(folder: Path) -> list[dict[str, Any]]:
    return [item.event for item in read_session(Session.open(folder)) if isinstance(item, RecordedEvent)]


@pytest.mark.timeout(400)
def test_killed_twenty_times(program: Program, port: str) -> None:
    rng = random.Random(20)
    folder = program.folder / "session"
    arguments = (*program.capture(port, "--session", folder, "--json"), "--positions", SCHEME)
    must_be_there: set[str] = set()
    for number in range(KILLS):
        resume = ("--resume",) if (folder / "session.toml").exists() else ()
        watched = Watched(program.start(*arguments, *resume))
        watched.kill_after(rng.uniform(0.1, 1.8), measuring=number % 2 == 1)
        if not (folder / "session.toml").exists():
            continue
        recorded = events_on_disk(folder)
        accepted = [event["position"] for event in recorded if event["event"] == "accepted"]
        recorded_s = max((event["time_s"] for event in recorded if event.get("time_s") is not None), default=0.0)
        assert recorded_s > watched.last_s - LAST_S * SPEED, f"kill {number}"
        must_be_there |= watched.accepted_before(watched.last_s - LAST_S * SPEED)
        assert must_be_there <= set(accepted), f"kill {number}"
        assert len(accepted) == len(set(accepted)), f"kill {number}: a position was asked for again"
        must_be_there |= set(accepted)
    assert len(must_be_there) > 3
    ended = program.run(*arguments, "--resume", timeout_s=180)
    assert ended.returncode == 0, ended.stderr
    assert Session.open(folder).finished
    solved = program.run("solve", folder, "--json")
    assert solved.returncode == 0, solved.stderr
    names = [position["name"] for position in json.loads(solved.stdout)["position"]]
    assert sorted(names) == sorted(position.name for position in scheme(SCHEME).positions)
