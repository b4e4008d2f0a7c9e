"""The page in each state of a session, in a real browser: fits every screen, and is for everybody (axe-core)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import pytest

pytest.importorskip("websockets", reason="the page needs websockets")

from tests.web.browser import Screens
from tests.web.guide_stages import StagedSession

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

AXE = Path(__file__).parent / "scripts" / "node_modules" / "axe-core" / "axe.min.js"
SIZES = ((390, 844), (844, 390), (768, 1024), (1280, 800))
STAGES = 14
ENDED: dict[str, object] = {"headline": "FINISHED", "details": "24 of 24 positions measured; imufield solve my-session"}
# Beside what a page of its own scrolls by, nothing may stick out.
WIDER = """() => [...document.querySelectorAll("body *")]
    .filter((element) => element.getBoundingClientRect().right > innerWidth + 1 && element.checkVisibility())
    .map((element) => element.id || element.tagName)"""
CUT = """() => [...document.querySelectorAll("#headline, #side, #details, #marks button")]
    .filter((element) => element.scrollWidth > element.clientWidth + 1 && element.checkVisibility())
    .map((element) => element.textContent)"""
RUN_AXE = """async () => (await axe.run()).violations
    .filter(({impact}) => ["serious", "critical"].includes(impact))
    .map(({id, nodes}) => `${id}: ${nodes.map(({target, failureSummary}) => `${target} ${failureSummary}`).join("; ")}`)"""


@dataclass
class Findings:
    """What was found, each with its state and size."""

    stages: list[str] = field(default_factory=list)
    too_wide: list[str] = field(default_factory=list)
    barriers: list[str] = field(default_factory=list)
    console: list[str] = field(default_factory=list)


def find(page: Page, stage: str, found: Findings) -> None:
    """Note what is wrong with a state."""
    found.stages.append(stage)
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        found.too_wide += [f"{stage} at {width} x {height}: {what}" for what in page.evaluate(WIDER) + page.evaluate(CUT)]
    if AXE.exists():
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            found.barriers += [f"{stage}, {scheme}: {what}" for what in page.evaluate(RUN_AXE)]


@pytest.fixture(scope="module")
def idle() -> Iterator[str]:
    """Serve the page of a session that stands still; yield its address."""
    staged = StagedSession()
    next(staged.stages())
    with staged.served() as (_, url):
        yield url


@pytest.fixture(scope="module")
def findings(browser: Browser) -> Iterator[Findings]:
    """Go once through all states of a session with one page."""
    found, screens, staged = Findings(), Screens(browser), StagedSession()
    with staged.served() as (server, url):
        page = screens.open(f"{url}&back=http://127.0.0.1:8778/")
        if AXE.exists():
            page.evaluate(AXE.read_text(encoding="utf-8"))
        for stage in staged.stages():
            staged.wait_for(page, stage)
            find(page, stage, found)
        found.console = list(screens.console)
        server.end(ENDED)
    page.locator("#headline", has_text="FINISHED").wait_for()
    find(page, "ended", found)
    yield found
    screens.close()


# A browser, and a session of four minutes of samples: nothing less shows all states.
def test_every_state_fits_every_screen(findings: Findings) -> None:
    assert len(findings.stages) == STAGES
    assert not findings.too_wide, "\n".join(findings.too_wide)
    assert findings.console == []


def test_no_barrier_in_any_state(findings: Findings) -> None:
    if not AXE.exists():
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)("no axe-core, which npm installs: make scripts")
    assert not findings.barriers, "\n".join(findings.barriers)


def test_keyboard_alone(screens: Screens) -> None:
    staged = StagedSession()
    next(staged.stages())
    with staged.served() as (_, url):
        page = screens.open(url)
        page.locator("#marks").wait_for()
        reached = []
        for _ in range(9):
            page.keyboard.press("Tab")
            # What has the focus shows it.
            reached.append(
                page.evaluate(
                    "[document.activeElement.dataset.key ?? document.activeElement.id, "
                    "getComputedStyle(document.activeElement).outlineStyle]"
                )
            )
            page.keyboard.press("Enter")
        assert [name for name, _ in reached] == ["r", "s", "u", "p", "f", "sound", "voice", "night", "log"]
        assert {outline for _, outline in reached} == {"solid"}
        page.keyboard.press("r")
        page.keyboard.press("Control+r")
        page.keyboard.press("q")
        # A last mark: what came before it has been heard.
        page.locator("[data-key=p]").click()
        heard = ""
        while not heard.endswith("rp"):
            heard += staged.page.read()
        assert heard == "rsupfrp"
        assert screens.console == []


def test_text_of_others_stays_text(screens: Screens) -> None:
    hostile = "<img src=x onerror=alert(1)><script>alert(2)</script>"
    staged = StagedSession(instrument=hostile)
    staged.page.tell(hostile)
    next(staged.stages())
    with staged.served() as (_, url):
        page = screens.open(url)
        page.locator("#about", has_text=hostile).wait_for()
        page.locator("#log li", has_text=hostile).wait_for()
        assert page.locator("img, iframe").count() == 0
        assert page.locator("script").count() == 1
        assert screens.console == []
        # And if a script of the page made HTML of it, the browser would refuse.
        assert (
            page.evaluate("() => { try { document.body.innerHTML = '<b>x</b>'; } catch (error) { return error.name; } }")
            == "TypeError"
        )


@pytest.mark.parametrize(
    ("back", "is_shown"),
    [
        ("http://127.0.0.1:8778/", True),
        ("http://localhost:8778/#token=abc", True),
        ("http://[::1]:8778/", True),
        ("http://example.org:80/", False),
        ("http://127.0.0.1:80@example.org/", False),
        ("http://localhost.example.org:80/", False),
        ("https://127.0.0.1:8778/", False),
        ("javascript:alert(1)//http://127.0.0.1:1/", False),
        ("//example.org/", False),
    ],
)
def test_the_way_back_leads_to_this_machine_alone(screens: Screens, idle: str, back: str, *, is_shown: bool) -> None:
    page = screens.open(f"{idle}&back={quote(back, safe='')}")
    page.locator("#marks").wait_for()
    assert page.locator("#back").is_visible() == is_shown
    assert page.locator("#back").get_attribute("href") == (back if is_shown else None)
