"""A capture with a page, against an emulated instrument that a virtual operator turns: the real programs on a real port.

And the same capture without one: its bytes and marks, from the recording, through the loop of every capture.
"""

from __future__ import annotations

import json
import re
import shutil
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, Popen
from typing import TYPE_CHECKING, Any

from imufield.acquire.decoded_session import UNPLUGGED, recorded_protocol
from imufield.acquire.instrument.connected import Connected
from imufield.acquire.instrument.same_stream import SameStream
from imufield.acquire.link.host_clock import SystemClock
from imufield.acquire.link.serial import Chunk
from imufield.acquire.recording.reader import PartStart, RecordedEvent, read_session
from imufield.acquire.recording.recorder import Recorder
from imufield.acquire.recording.session import Session
from imufield.commands.terminal.guided import FINISH, CaptureLoop
from imufield.commands.terminal.views import View
from imufield.errors import LinkError, Reason
from imufield.guide.positions import scheme
from imufield.guide.view.marks import KEYS
from imufield.pipeline.chain import MARK, Chain, ReadingPlan
from imufield.pipeline.intake import Intake
from tests.commands.conftest import SPEED, Program, recorded_events

if TYPE_CHECKING:
    from playwright.sync_api import Page

POSITIONS = [position.name for position in scheme("paper24").positions]
HOLD_S = 2.0
WAIT_S = 300.0  # Only a program that hangs takes so long, however busy the machine.


@dataclass
class PageSession:
    """A capture that is under way; what it prints goes to a file, which the person who turns the instrument reads.

    That person shows what the guide asks for, again and again where it is refused; only not the first position once more at the
    end, so that the guide waits there until the session is finished. However busy the machine is, nothing is missed.
    """

    program: Program
    process: Popen[str]
    instrument: Popen[str]
    printed: Path
    link: Path
    seed: int
    asked: str = ""
    url: str = ""
    watch_url: str = ""

    @classmethod
    def begin(cls, program: Program, *, seed: int = 1, name: str = "session") -> PageSession:
        """Start the instrument and the capture."""
        link = program.folder / f"imu-{name}"
        printed = program.folder / f"{name}.jsonl"
        instrument = cls._instrument(program, link, seed)
        with printed.open("w") as output, socket.create_server(("127.0.0.1", 0)) as free:
            # A port of its own: beside another session the network of that one may still hold the usual port.
            how = ("--driver", "stim300", "--hold-s", HOLD_S, "--clock-speed", SPEED, "--latitude", 45, "--height", 0)
            port = ("--web-port", free.getsockname()[1])
            free.close()
            process = program.start(
                *("capture", "--port", link, *how, "--session", program.folder / name, "--json", "--web", *port), stdout=output
            )
        begun = cls(program, process, instrument, printed, link, seed)
        threading.Thread(target=begun._turn_it, daemon=True).start()
        first = begun.wait_for(lambda told: told["event"] == "page")
        begun.url, begun.watch_url = first["url"], first["watch_url"]
        return begun

    @staticmethod
    def _instrument(program: Program, link: Path, seed: int) -> Popen[str]:
        """Start an instrument that waits for its reader and is shown what is written to it."""
        how = ("--poses", "-", "--hold-s", 1.0, "--wait", "--seed", seed, "--link", link)
        program.emulate(*how, stdin=PIPE)
        return program.started[-1]

    def _turn_it(self) -> None:
        """Follow the guide until the capture ends."""
        accepted = set[str]()
        with self.printed.open() as printed:
            while self.process.poll() is None:
                line = printed.readline()
                if not line.endswith("\n"):
                    printed.seek(printed.tell() - len(line))
                    time.sleep(0.02)
                    continue
                told = json.loads(line)
                if told["event"] == "accepted":
                    accepted.add(told["position"])
                elif told["event"] == "move" and len(accepted) < len(POSITIONS):
                    self._show(told["position"])
                elif told["event"] in ("rejected", "marked") and self.asked:
                    self._show(self.asked)

    def _show(self, position: str) -> None:
        self.asked = position
        # The cable is out: it is shown when it is in again.
        with suppress(OSError, ValueError):
            assert self.instrument.stdin is not None
            self.instrument.stdin.write(f"{position}\n")
            self.instrument.stdin.flush()

    def unplug(self) -> None:
        """Take the instrument away."""
        self.instrument.kill()
        self.instrument.wait()
        self.link.unlink(missing_ok=True)

    def plug_in(self) -> None:
        """Bring it back."""
        self.instrument = self._instrument(self.program, self.link, self.seed)
        self._show(self.asked)

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
        return recorded_events(self.session)

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


def wait_for(page: Page, place: str, words: str) -> None:
    page.locator(place, has_text=re.compile(words)).first.wait_for()


def finish(session: PageSession, page: Page) -> None:
    """Press until the session is done: the second may come too late for the first, and the guide asks again."""
    event = None
    while event != "done":
        before = len(session.told)
        page.keyboard.press("f")
        event = session.wait_for(_answers_finish, after=before)["event"]


def _answers_finish(told: dict[str, Any]) -> bool:
    return told["event"] == "done" or (told["event"] == "marked" and told["action"] == "finish")


class Recorded:
    """A recording of one part as link and keyboard: each read its chunk, each mark its key, each cut the error of a cable."""

    name = "recording"

    def __init__(self, session: Session) -> None:
        first, *self._items = read_session(session)
        assert isinstance(first, PartStart)
        self.metadata = first.metadata
        self._keys = ""
        self._put_back: list[Chunk | Exception] = []
        self._is_over = False
        self._key = {action: key for key, action in KEYS.items()}
        # What is finished for sure takes two; a third press, before all has ended, is one more mark.
        self._key["finish"] = 2 * FINISH

    def read(self) -> Chunk | None:
        """Return the next chunk, behind the last one silence; the keys that came behind it wait for ``keys``."""
        found = self._put_back.pop(0) if self._put_back else self._next()
        if isinstance(found, Exception):
            raise found
        return found

    def _next(self) -> Chunk | Exception | None:
        while self._items:
            item = self._items.pop(0)
            if isinstance(item, RecordedEvent) and item.event["event"] == UNPLUGGED:
                found: Chunk | Exception = LinkError("cut", Reason.DISCONNECTED)
            elif isinstance(item, Chunk):
                found = item
            else:
                continue
            while self._items and isinstance(behind := self._items[0], RecordedEvent) and behind.event["event"] != UNPLUGGED:
                self._items.pop(0)
                if behind.event["event"] == MARK:
                    action = str(behind.event["action"])
                    self._keys += self._key[action]
                    self._key["finish"] = FINISH if action == "finish" else self._key["finish"]
            return found
        assert not self._is_over, "the capture without a page has not ended where the one with a page did"
        self._is_over = True
        return None

    def put_back(self, items: Sequence[Chunk | Exception]) -> None:
        self._put_back = [*items, *self._put_back]

    def drain(self) -> list[Chunk]:
        return [item for item in self._items if isinstance(item, Chunk)]

    def reopen(self) -> bool:
        return True

    def keys(self) -> str:
        keys, self._keys = self._keys, ""
        return keys


def without_a_page(session: Session, folder: Path) -> Session:
    """Capture what was recorded once more, into another folder, without a page."""
    shutil.copytree(session.folder, folder, ignore=lambda _, names: [name for name in names if name != "session.toml"])
    again, recorded = Session.open(folder), Recorded(session)
    again.update(finished=False)
    stream = SameStream(recorded.name, SPEED)
    stream.begin()
    chain = Chain(ReadingPlan.of(again), listeners=(stream.hear,))
    protocol = recorded_protocol(recorded.metadata, again)
    with Recorder(again.add_part(), recorded.metadata) as recorder:
        CaptureLoop(
            session=again,
            connected=Connected(
                link=recorded,  # type: ignore[arg-type]
                protocol=protocol,
                driver="stim300",
                model="",
                baud=None,
                chunks=[],
                identity={},
            ),
            intake=Intake(recorder=recorder, chain=chain, stream=stream),
            view=View(),
            keyboard=_Keyboard(recorded),  # type: ignore[arg-type]
            clock=SystemClock(),
            check=lambda: None,
        ).run()
    return again


@dataclass
class _Keyboard:
    recorded: Recorded

    def read(self) -> str:
        return self.recorded.keys()


def parameters_of(program: Program, folder: Path) -> list[str]:
    """Solve a session and return its parameter file, but for the lines that say when, and from which folder."""
    solved = program.run("solve", folder)
    assert solved.returncode == 0, solved.stderr
    other = ("created = ", "sha256 = ", f'name = "{folder.name}"')
    return [line for line in (folder / "parameters.toml").read_text().splitlines() if not line.startswith(other)]
