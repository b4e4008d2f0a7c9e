"""A capture killed at random moments, again and again: all stays but the last second."""

from __future__ import annotations

import json
import os
import random
import subprocess
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import pytest

from imufield.acquire.recording import RecordedEvent, read_session
from imufield.acquire.session import Session
from imufield.guide.positions import scheme
from tests.torture.conftest import FULL, Campaign

if TYPE_CHECKING:
    from tests.commands.conftest import Program

SPEED = 16
SCHEME = "corners24"
LAST_S = 1.0
"""What may be lost, real time, beyond what the disk and a busy machine themselves took."""
ROUNDS = 8
KILLS_A_SESSION = 20
"""Then it is resumed to its end and solved."""


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


class Stalls:
    """How long the machine itself stands still: a small file written and synced again and again, beside the program."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "stalls"
        self.longest_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        with self.path.open("wb") as file:
            while not self._over.is_set():
                before_s = time.monotonic()
                time.sleep(0.01)
                file.write(b"x" * 4096)
                os.fsync(file.fileno())
                self.longest_s = max(self.longest_s, time.monotonic() - before_s)


class Watched:
    """A running capture whose events are read as they come."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.events: list[dict[str, Any]] = []
        self.killed_s = 0.0
        self.thread = threading.Thread(target=self._read)
        self.thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.endswith("}\n"):  # the last line of a killed program may be cut
                self.events.append({"received_s": time.time(), **json.loads(line)})

    def kill_after(self, events: int, pause_s: float) -> None:
        """Kill it a moment after so many events, or when it ended, so that a slow machine gets as far as a fast one."""
        while len(self.events) < events and self.process.poll() is None:
            time.sleep(0.01)
        time.sleep(pause_s)
        self.killed_s = time.time()
        self.process.kill()
        self.process.wait()
        self.thread.join()

    def accepted_before(self, moment_s: float) -> set[str]:
        """Return the positions whose acceptance was read before a moment of the host's clock."""
        accepted = (event for event in self.events if event["event"] == "accepted")
        return {event["position"] for event in accepted if event["received_s"] < moment_s}


def events_on_disk(folder: Path) -> list[dict[str, Any]]:
    return [item.event for item in read_session(Session.open(folder)) if isinstance(item, RecordedEvent)]


@pytest.mark.timeout(400)
@pytest.mark.parametrize("number", range(10 if FULL else 1))
def test_killed_twenty_times(program: Program, port: str, number: int, campaign: Campaign) -> None:
    rng = random.Random(20 + number)
    folder = program.folder / "session"
    arguments = (*program.capture(port, "--session", folder, "--json"), "--positions", SCHEME)
    must_be_there: set[str] = set()
    for kill in range(KILLS_A_SESSION):
        resume = ("--resume",) if (folder / "session.toml").exists() else ()
        with Stalls(program.folder) as stalls:
            watched = Watched(program.start(*arguments, *resume))
            watched.kill_after(rng.randrange(12), rng.uniform(0.0, 0.8))
        may_miss_s = LAST_S + 2 * stalls.longest_s
        if not (folder / "session.toml").exists():
            continue
        recorded = events_on_disk(folder)
        accepted = [event["position"] for event in recorded if event["event"] == "accepted"]
        unwritten_s = watched.killed_s - Session.open(folder).parts[-1].stat().st_mtime
        assert unwritten_s < may_miss_s, f"kill {kill}"
        must_be_there |= watched.accepted_before(watched.killed_s - may_miss_s)
        assert must_be_there <= set(accepted), f"kill {kill}"
        assert len(accepted) == len(set(accepted)), f"kill {kill}: a position was asked for again"
        must_be_there |= set(accepted)
    assert len(must_be_there) > 3
    ended = program.run(*arguments, "--resume", timeout_s=180)
    assert ended.returncode == 0, ended.stderr
    assert Session.open(folder).finished
    solved = program.run("solve", folder, "--json")
    assert solved.returncode == 0, solved.stderr
    names = [position["name"] for position in json.loads(solved.stdout)["position"]]
    assert sorted(names) == sorted(position.name for position in scheme(SCHEME).positions)
    campaign.tell(
        "`capture` killed (SIGKILL) at a random moment and resumed; then the session ended and solved",
        f"{KILLS_A_SESSION} kills",
        f"at most the last second; {len(must_be_there)} positions accepted before a kill, all there",
    )
