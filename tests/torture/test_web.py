"""Whole sessions from the page in a real browser, with faults of the cable, the network and the phone at random moments."""

from __future__ import annotations

import random
import re
import time
from collections.abc import Callable
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest

from tests.commands.conftest import recorded_events
from tests.torture.conftest import FULL, Campaign
from tests.web.browser import Screens, open_browser
from tests.web.network import ARGUMENT, Network
from tests.web.page_session import POSITIONS, WAIT_S, PageSession, finish, parameters_of, without_a_page

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from tests.commands.conftest import Program

pytest.importorskip("websockets", reason="the page needs websockets")

SESSIONS = 20
NO_NETWORK = "WebSocket connection to"
"""A browser says by itself where no connection can be made."""


def done(page: Page) -> int:
    return int(page.locator("#done").inner_text())


class Run:
    """A session with its pages, and the faults that come over them."""

    def __init__(self, session: PageSession, screens: Screens, network: Network, rng: random.Random) -> None:
        self.session, self.screens, self.network, self.rng = session, screens, network, rng
        # Through the network, as a phone; the others are on this machine.
        self.page = screens.open(session.url.replace("127.0.0.1", "localhost"))
        self.others: list[Page] = []
        self.faults: dict[str, Callable[[], None]] = {
            "cable": self.pull_cable,
            "reload": self.reload,
            "second": self.open_second,
            "network": self.cut_network,
            "sleep": self.sleep,
            "marks": self.mark,
        }

    def pull_cable(self) -> None:
        self.session.unplug()
        self.page.locator("#headline", has_text="NO LINK").wait_for()
        self.session.plug_in()
        # Without a link there is nothing that could be paused.
        self.page.locator("#headline", has_not_text="NO LINK").wait_for()

    def reload(self) -> None:
        for _ in range(self.rng.randrange(1, 6)):
            self.page.reload()

    def open_second(self) -> None:
        self.others.append(self.screens.open(self.rng.choice([self.session.url, self.session.watch_url])))

    def cut_network(self) -> None:
        self.network.cut()
        made = self.network.connections
        self.page.wait_for_timeout(self.rng.uniform(200, 4000))
        self.network.join()
        # The page comes back by itself: nothing else makes a connection now.
        deadline_s = time.monotonic() + WAIT_S
        while self.network.connections == made:
            assert time.monotonic() < deadline_s, "the page has not come back after a cut of the network"
            self.page.wait_for_timeout(50)

    def sleep(self) -> None:
        phone = self.page.context.new_cdp_session(self.page)
        phone.send("Page.setWebLifecycleState", {"state": "frozen"})
        self.page.wait_for_timeout(self.rng.uniform(200, 4000))
        phone.send("Page.setWebLifecycleState", {"state": "active"})

    def mark(self) -> None:
        self.page.locator("#marks [data-key=p]").click()
        self.page.locator("#headline", has_text="PAUSED").wait_for()
        for key in "rsu":
            self.page.locator(f"#marks [data-key={key}]").click()
        self.page.locator("#marks [data-key=p]").click()

    def accepted(self) -> int:
        """Return how many positions the program has told of."""
        return len({event["position"] for event in self.session.told if event["event"] == "accepted"})

    def is_true(self) -> None:
        """Wait until the page shows at least what was true when it was asked."""
        measured = self.accepted()
        while done(self.page) < measured:
            self.page.wait_for_timeout(50)


# Its short form is tests/web/test_guide_page.py.
@pytest.mark.parametrize("number", range(SESSIONS) if FULL else ())
def test_a_session_from_the_page_whatever_happens(program: Program, number: int, campaign: Campaign) -> None:
    rng = random.Random(1600 + number)
    session = PageSession.begin(program, seed=1 + number)
    with open_browser(ARGUMENT) as browser, Network(urlsplit(session.url).port or 0) as network:
        screens = Screens(browser)
        run = Run(session, screens, network, rng)
        kinds = [*rng.choices(sorted(run.faults), k=3), "cable", "network"]
        for kind, after in zip(rng.sample(kinds, len(kinds)), sorted(rng.sample(range(1, 22), len(kinds))), strict=True):
            while done(run.page) < after:
                run.page.wait_for_timeout(50)
            run.faults[kind]()
            run.is_true()
        pages = [run.page, *run.others]
        for page in pages:
            page.locator("#done", has_text=re.compile("^24$")).wait_for()
        finish(session, run.page)
        for page in pages:
            page.locator("#headline", has_text="FINISHED").wait_for()
        assert session.process.wait(300) == 0, session.process.communicate()[1]
        assert [line for line in screens.console if NO_NETWORK not in line] == []
        screens.close()

    # What a capture without a page makes of the same bytes and marks.
    recorded, folder = session.recorded, session.session.folder
    assert recorded_events(without_a_page(session.session, program.folder / "without")) == recorded
    assert {event["position"] for event in recorded if event["event"] == "accepted"} == set(POSITIONS)
    parameters = parameters_of(program, folder)
    assert parameters == parameters_of(program, program.folder / "without")
    assert parameters.count("[[position]]") == len(POSITIONS)
    campaign.tell(
        "whole session from the page; cable out, network cut, reloads, other pages, sleep, marks at random moments",
        1,
        "sessions",
        "{positions} positions of {planned} measured, {faults} faults; without a page the same bytes and marks give the same"
        " parameter file",
        positions=parameters.count("[[position]]"),
        planned=len(POSITIONS),
        faults=len(kinds),
    )
