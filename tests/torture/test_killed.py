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

from imufield.acquire.recording.session import Session
from tests.torture.captures import accepted_on_disk, capture_into, end_and_solve, show_rounds
from tests.torture.conftest import FULL, Campaign

if TYPE_CHECKING:
    from tests.commands.conftest import Program

LAST_S = 1.0
"""What may be lost, real time, beyond what the disk and a busy machine themselves took."""
KILLS_A_SESSION = 20 if FULL else 8
"""Then it is resumed to its end and solved."""
LONG = "paper36" if FULL else "paper24"
"""So many positions that none is asked for again at the end, to see the drift, before the last kill."""


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


def part_count(folder: Path) -> int:
    """Return how many parts a session has; 0 where there is none yet."""
    return len(Session.open(folder).parts) if (folder / "session.toml").exists() else 0


@pytest.mark.parametrize("number", range(10 if FULL else 1))
def test_killed_twenty_times(program: Program, number: int, campaign: Campaign) -> None:
    rng = random.Random(20 + number)
    folder = program.folder / "session"
    port = show_rounds(program, LONG)
    must_be_there: set[str] = set()
    for kill in range(KILLS_A_SESSION):
        begun = part_count(folder)
        with Stalls(program.folder) as stalls:
            watched = Watched(program.start(*capture_into(program, port, folder, LONG)))
            watched.kill_after(rng.randrange(12), rng.uniform(0.0, 0.8))
        may_miss_s = LAST_S + 2 * stalls.longest_s
        if not (folder / "session.toml").exists():
            continue
        accepted = accepted_on_disk(folder)
        assert len(accepted) == len(set(accepted)), f"kill {kill}: a position was asked for again"
        if part_count(folder) > begun:  # else it was killed before it read the port, and the last part is of the run before
            unwritten_s = watched.killed_s - Session.open(folder).parts[-1].stat().st_mtime
            assert unwritten_s < may_miss_s, f"kill {kill}"
        must_be_there |= watched.accepted_before(watched.killed_s - may_miss_s)
        assert must_be_there <= set(accepted), f"kill {kill}"
        must_be_there |= set(accepted)
    assert len(must_be_there) > 1
    end_and_solve(program, port, folder, LONG)
    campaign.tell(
        "`capture` killed (SIGKILL) at a random moment and resumed; then the session ended and solved",
        KILLS_A_SESSION,
        "kills",
        "at most the last second; {positions} positions accepted before a kill, all there",
        positions=len(must_be_there),
    )
