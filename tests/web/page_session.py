"""A capture with a page, against an emulated instrument that a virtual person turns: the real programs on a real port."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen
from typing import Any

from imufield.acquire.recording.reader import RecordedEvent, read_session
from imufield.acquire.recording.session import Session
from imufield.guide.positions import scheme
from tests.commands.conftest import SPEED, Program

POSITIONS = [position.name for position in scheme("paper24").positions]
OPERATOR_HOLD_S, HOLD_S = 5.0, 2.0
PASSES = 4
"""How often the person goes through the positions: what was missed while paused or unplugged comes up again. The first position
is shown in the first pass only, so that the guide, which ends with it, waits there until the session is finished."""
WAIT_S = 300.0  # Only a program that hangs takes so long, however busy the machine.


def plug_in(program: Program, link: Path, poses: list[str], seed: int) -> Popen[str]:
    """Start an instrument that waits for its reader and is shown these positions."""
    path = program.folder / "poses.txt"
    path.write_text("\n".join(poses))
    program.emulate("--poses", path, "--hold-s", OPERATOR_HOLD_S, "--wait", "--seed", seed, "--link", link)
    return program.started[-1]


@dataclass
class PageSession:
    """A capture that is under way; what it prints goes to a file."""

    program: Program
    process: Popen[str]
    instrument: Popen[str]
    printed: Path
    link: Path
    seed: int
    url: str = ""
    watch_url: str = ""

    @classmethod
    def begin(cls, program: Program, *, seed: int = 1, name: str = "session") -> PageSession:
        """Start the instrument and the capture."""
        link = program.folder / f"imu-{name}"
        plug_in(program, link, [POSITIONS[0], *POSITIONS[1:] * PASSES], seed)
        printed = program.folder / f"{name}.jsonl"
        with printed.open("w") as output:
            how = ("--driver", "stim300", "--hold-s", HOLD_S, "--clock-speed", SPEED, "--latitude", 45, "--height", 0)
            process = program.start(
                *("capture", "--port", link, *how, "--session", program.folder / name, "--json", "--web"), stdout=output
            )
        begun = cls(program, process, program.started[-2], printed, link, seed)
        first = begun.wait_for(lambda told: told["event"] == "page")
        begun.url, begun.watch_url = first["url"], first["watch_url"]
        return begun

    def unplug(self) -> None:
        """Take the instrument away."""
        self.instrument.kill()
        self.instrument.wait()
        self.link.unlink(missing_ok=True)

    def plug_in(self) -> None:
        """Bring it back; the person goes through the positions from the second one again."""
        self.instrument = plug_in(self.program, self.link, POSITIONS[1:] * PASSES, self.seed)

    @property
    def told(self) -> list[dict[str, Any]]:
        """What the program has printed so far."""
        whole = self.printed.read_text().rpartition("\n")[0]
        return [json.loads(line) for line in whole.splitlines()]

    @property
    def session(self) -> Session:
        """The session on disk."""
        return Session.open(self.printed.with_suffix(""))

    @property
    def recorded(self) -> list[dict[str, Any]]:
        """The events in the recording, the operator's marks included."""
        return [item.event for item in read_session(self.session) if isinstance(item, RecordedEvent)]

    def wait_for(self, is_meant: Callable[[dict[str, Any]], bool], *, after: int = 0) -> dict[str, Any]:
        """Wait until an event is printed, and return it; ``after`` so many others."""
        deadline_s = time.monotonic() + WAIT_S
        while time.monotonic() < deadline_s:
            found = next(filter(is_meant, self.told[after:]), None)
            if found is not None:
                return found
            assert self.process.poll() is None, self.process.communicate()[1]
            time.sleep(0.05)
        raise AssertionError(f"not printed within {WAIT_S} s; the last was {self.told[-1]}")
