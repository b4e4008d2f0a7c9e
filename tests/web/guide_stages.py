"""A guided session without a wire or a clock, stopped where its page shows something of its own: for pictures and checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imufield.guide.events import Event, Move, Turning
from imufield.guide.lead.guide import Guide, Snapshot
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import State
from imufield.guide.positions import scheme
from imufield.samples import Samples
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.operator import NO_POSITION, OperatorSettings, Visit
from imufield.web.guide_page import GuidePage
from imufield.web.server import PageServer
from tests.web.served import Served

if TYPE_CHECKING:
    from playwright.sync_api import Page

RATE_HZ = 100.0
BLOCK = 10  # Samples: a cell.
LONG_BLOCK = 50  # Where nothing is stopped at.
LONGEST_S = 600.0  # Of the session, between two stages.
WRONG = 1.03  # Factor of a hold that the others contradict.
SHOCK_M_S2 = 2.0
WARMTH_DEGC = 31.4
ENDED: dict[str, object] = {
    "outcome": "finished",
    "accepted": 24,
    "planned": 24,
    "lacking": "",
    "command": "imufield solve my-session",
    "reason": "",
}
"""What pages are told last."""
STAND_STILL = "Date.now = () => 0"
"""For a page: a session that stands still is silent, and a page that hears nothing for three seconds opens a new connection."""


class StagedSession:
    """A session of 24 positions; ``stages`` runs it and stops."""

    def __init__(self, *, instrument: str = "STIM300 N25581846020021", replay_speed: float | None = None) -> None:
        positions = scheme("paper24")
        habits = OperatorSettings(initial_still_s=8.0, hold_s=6.0, waits=True, turn_s=(2.5, 3.0))
        options = Emulation(
            device="text", rate_hz=RATE_HZ, grade="tactical", seed=4, directions=positions.directions()[:1], operator=habits
        )
        self._directions = {position.name: np.array(position.direction) for position in positions.positions}
        self._source = make_virtual_imu(options)
        settings = GuideSettings(hold_s=4.0, revisit_first=True)
        self.guide = Guide(positions, self._source.imu.instrument.grade.units, settings=settings)
        self.page = GuidePage(
            positions, session="2026-03-14-workshop", instrument=instrument, cable="-x", replay_speed=replay_speed
        )
        self._events: list[Event] = []
        self.turning: Turning | None = None
        """The newest, a few of which are told a second."""

    def stages(self) -> Iterator[str]:
        """Run the session; yield the name of each stage while the page's board holds it."""
        self._run(lambda _: self.guide.time_s > 1.5)
        yield self._shown("waiting")
        self._run(lambda now: now.state is State.TURNING and len(now.accepted) == 2 and _moves(now))
        yield self._shown("turning early")
        self._run(lambda now: len(now.accepted) == 7, block=LONG_BLOCK)
        self._run(lambda now: now.state is State.HOLDING and now.fraction > 0.3)
        self._run(lambda _: any(event.kind == "rejected" for event in self._events), self._knocked)
        yield self._shown("rejected")
        self._events += self.guide.mark("pause", self.guide.time_s)
        self._run(lambda now: now.state is State.PAUSED)
        yield self._shown("paused")
        self._events += self.guide.mark("pause", self.guide.time_s)
        self._run(lambda now: now.state is State.HOLDING and now.fraction > 0.5)
        yield self._shown("silent", silent=True)
        self._events += self.guide.link_lost()
        yield self._shown("link lost")
        self._run(lambda now: len(now.accepted) == 11, block=LONG_BLOCK)
        self._run(lambda now: len(now.accepted) == 12, self._wrong)
        yield self._shown("suspect")
        self._run(lambda now: len(now.accepted) == 15, block=LONG_BLOCK)
        self._run(lambda now: now.state is State.HOLDING and now.fraction > 0.6)
        yield self._shown("holding")
        self._run(lambda now: now.state is State.RESTING)
        yield self._shown("accepted")
        self._run(lambda now: now.state is State.TURNING and _moves(now) and _far(now))
        yield self._shown("turning")
        self._run(lambda now: now.state is State.TURNING and not _moves(now))
        yield self._shown("settling")
        self._run(lambda now: now.state is State.TURNING and len(now.accepted) == 18)
        self._events += [self.guide.asked_to_finish()]
        yield self._shown("finish asked")
        self._run(lambda now: len(now.accepted) == 23, block=LONG_BLOCK)
        self._run(lambda now: now.revisiting is not None and now.state is State.TURNING and _moves(now))
        yield self._shown("drift check")
        self._run(lambda now: now.state is State.DONE)
        yield self._shown("done")

    def hold_another(self) -> str:
        """Hold the last of the positions, whichever is asked for; show it, and return its name."""
        *_, name = self._directions
        self._directions = dict.fromkeys(self._directions, self._directions[name])
        self._run(lambda now: now.position == name and now.target != name)
        self._shown("")
        return name

    def mark(self, action: str) -> None:
        """Make a mark, and show what came of it."""
        self._events += self.guide.mark(action, self.guide.time_s)
        self._run(lambda _: True)
        self._shown("")

    @contextmanager
    def served(self) -> Iterator[tuple[PageServer, str]]:
        """Serve the page; yield the server and the address."""
        served = Served(self.page.board, self.page.mark)
        with served.server as server:
            yield server, served.url

    def wait_for(self, page: Page, stage: str) -> None:
        """Wait until a page shows what the board holds; ask to finish from it where the stage says so."""
        page.locator(f"body[data-version='{self.page.board._version}']").wait_for()
        if stage == "finish asked":
            page.locator("[data-key=f]").click()

    def _run(
        self,
        until: Callable[[Snapshot], bool],
        change: Callable[[Samples], Samples] = lambda samples: samples,
        block: int = BLOCK,
    ) -> None:
        """Feed the guide until something is so; the operator goes where the guide asks."""
        end_s = self._source.time_s + LONGEST_S
        while True:
            samples = self._source.next_block(block)
            samples = replace(samples, temperature_degc=0 * samples.temperature_degc + WARMTH_DEGC)
            events = self.guide.feed(change(samples))
            self._events += events
            for event in events:
                if isinstance(event, Turning):
                    self.turning = event
                if isinstance(event, Move):
                    self._source.operator.show(Visit(NO_POSITION, self._directions[event.position]))
                    self._shown("")
            if until(self.guide.snapshot()):
                return
            if self._source.time_s > end_s:
                raise TimeoutError(f"at {self._source.time_s} s: {self.guide.state}")

    def _shown(self, name: str, *, silent: bool = False) -> str:
        self.page.show(self._events)
        self._events = []
        self.page.refresh(self.guide.snapshot(), silent=silent, samples_lost=0)
        return name

    def _knocked(self, samples: Samples) -> Samples:
        shock = samples.accelerometer.copy()
        shock[::2] += SHOCK_M_S2
        return replace(samples, accelerometer=shock)

    def _wrong(self, samples: Samples) -> Samples:
        return replace(samples, accelerometer=samples.accelerometer * WRONG)


def _moves(now: Snapshot) -> bool:
    return now.activity is not None and now.activity.ratio > 1


def _far(now: Snapshot) -> bool:
    """Whether the goal is far enough for an arrow to be seen."""
    return now.direction is not None and now.target_direction is not None and _dot(now) < 0.5


def _dot(now: Snapshot) -> float:
    return sum(a * b for a, b in zip(now.direction or (), now.target_direction or (), strict=True))
