"""The page in each state of a session, in a real browser: fits every screen, and is for everybody (axe-core)."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np
import pytest

pytest.importorskip("websockets", reason="the page needs websockets")

from imufield.guide.events import LinkLost, Marked
from imufield.guide.positions import angle_deg
from tests.web.browser import Screens
from tests.web.guide_stages import ENDED, STAND_STILL, StagedSession

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

AXE = Path(__file__).parent / "scripts" / "node_modules" / "axe-core" / "axe.min.js"
SIZES = ((390, 844), (320, 568), (844, 390), (768, 1024), (1280, 800))
STAGES = 15
# Beside what a page of its own scrolls by, nothing may stick out.
WIDER = """() => [...document.querySelectorAll("body *")]
    .filter((element) => element.getBoundingClientRect().right > innerWidth + 1 && element.checkVisibility())
    .map((element) => element.id || element.tagName)"""
CUT = """() => [...document.querySelectorAll("#headline, #side, #details, #marks button")]
    .filter((element) => element.scrollWidth > element.clientWidth + 1 && element.checkVisibility())
    .map((element) => element.textContent)"""
# Of the terminal, or a mark that was not named.
NOT_OURS = re.compile(r"\bpress\b|\bkey\b|\[[a-z ]+\]|\bundefined\b|\bNaN\b")
# All words and all points of lines that the pages' canvases get: the box of each, the place of each.
WATCH_PLOTS = """
const plots = window.plots = {forecast: {words: [], points: []}, trace: {words: [], points: []}};
const canvas = CanvasRenderingContext2D.prototype;
const {clearRect, fillText, lineTo, moveTo} = canvas;
canvas.clearRect = function (...given) {
    if (plots[this.canvas.id]) plots[this.canvas.id] = {words: [], points: []};
    return clearRect.apply(this, given);
};
canvas.fillText = function (words, x, y) {
    const wide = this.measureText(words).width;
    const left = this.textAlign === "right" ? x - wide : x;
    if (words) plots[this.canvas.id]?.words.push([left, left + wide, y - 5, y + 5]);
    return fillText.apply(this, [words, x, y]);
};
for (const [name, draw] of Object.entries({lineTo, moveTo}))
    canvas[name] = function (x, y) {
        plots[this.canvas.id]?.points.push([x, y]);
        return draw.apply(this, [x, y]);
    };"""
CROSSED = """() => Object.values(plots).map(({words, points}) => [words.length, points.length,
    words.filter(([left, right, top, bottom]) =>
        points.some(([x, y]) => x > left - 4 && x < right + 4 && y > top && y < bottom)).length])"""
RUN_AXE = """async () => (await axe.run()).violations
    .filter(({impact}) => ["serious", "critical"].includes(impact))
    .map(({id, nodes}) => `${id}: ${nodes.map(({target, failureSummary}) => `${target} ${failureSummary}`).join("; ")}`)"""


@dataclass
class Findings:
    """What was found, each with its state and size."""

    stages: list[str] = field(default_factory=list)
    too_wide: list[str] = field(default_factory=list)
    barriers: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    angles: list[tuple[str, float]] = field(default_factory=list)
    """As the page shows it, and by the guide's own directions, both in degrees."""
    headlines: dict[str, str] = field(default_factory=dict)
    console: list[str] = field(default_factory=list)


def find(page: Page, stage: str, found: Findings) -> None:
    """Note what is wrong with a state."""
    found.stages.append(stage)
    found.headlines[stage] = page.locator("#headline").inner_text()
    shown = page.locator("body").inner_text()
    found.words += [f"{stage}: {line}" for line in shown.splitlines() if NOT_OURS.search(line)]
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
def visitor(browser: Browser) -> Iterator[Page]:
    """Open a page that goes from one address to the next."""
    screens = Screens(browser)
    yield screens.open("about:blank")
    screens.close()


@pytest.fixture(scope="module")
def findings(browser: Browser) -> Iterator[Findings]:
    """Go once through all states of a session with one page."""
    found, screens, staged = Findings(), Screens(browser), StagedSession()
    with staged.served() as (server, url):
        page = screens.open(f"{url}&back=http://127.0.0.1:8778/")
        page.evaluate(STAND_STILL)
        if AXE.exists():
            page.evaluate(AXE.read_text(encoding="utf-8"))
        for stage in staged.stages():
            staged.wait_for(page, stage)
            find(page, stage, found)
            if stage == "settling":
                assert staged.turning is not None
                goal = staged.guide.snapshot().target_direction
                to_goal_deg = angle_deg(np.array(staged.turning.direction), np.array(goal))
                found.angles.append((page.locator("#ring text").text_content() or "", to_goal_deg))
        found.console = list(screens.console)
        server.end(ENDED)
    page.locator("#headline", has_text="FINISHED").wait_for()
    assert page.locator("#positions :is(.next, .here)").count() == 0
    assert not [shown for shown in page.locator("#positions .off").all_inner_texts() if shown in ("+0.00", "\u22120.00")]
    find(page, "ended", found)
    yield found
    screens.close()


# A browser, and a session of four minutes of samples: nothing less shows all states.
def test_every_state_fits_every_screen(findings: Findings) -> None:
    assert len(findings.stages) == STAGES
    assert not findings.too_wide, "\n".join(findings.too_wide)
    assert findings.console == []


def test_sentences_name_what_the_page_has(findings: Findings) -> None:
    assert not findings.words, "\n".join(findings.words)


def test_the_repeat_of_the_first_position_is_announced(findings: Findings) -> None:
    assert findings.headlines["drift check"] == "DRIFT CHECK: TURN"


def test_where_the_instrument_is_looks_other_than_what_comes_next(screens: Screens) -> None:
    staged = StagedSession()
    stages = staged.stages()
    next(stages)
    with staged.served() as (_, url):
        page = screens.open(url)
        page.evaluate(STAND_STILL)
        staged.wait_for(page, next(stages))
        other = staged.hold_another()
        target = staged.guide.snapshot().target
        staged.wait_for(page, "")
        rows = {kind: page.locator(f"#positions .{kind}") for kind in ("here", "next")}
        names = {kind: row.locator(".name").all_inner_texts() for kind, row in rows.items()}
        assert names == {"here": [other], "next": [target]}
        signs = {kind: row.locator(".sign").inner_text() for kind, row in rows.items()}
        assert signs["here"] != signs["next"]
        legend = page.locator("#legend").inner_text()
        assert all(f"{sign}\u00a0{kind}" in legend for kind, sign in signs.items())


def test_good_news_is_not_in_the_colour_of_an_error(screens: Screens) -> None:
    staged = StagedSession()
    staged.page.show([LinkLost(0.0, 1, 24, "reconnect the cable"), LinkLost(0.0, 1, 24, "all is saved", resumed=True)])
    next(staged.stages())
    with staged.served() as (_, url):
        page = screens.open(url)
        lines = page.locator("#log li")
        places = (lines.filter(has_text="cable"), lines.filter(has_text="saved"), page.locator("body"))
        error, good, plain = (place.evaluate("(shown) => getComputedStyle(shown).color") for place in places)
    assert error != good == plain


def test_no_words_of_a_plot_lie_on_its_lines_or_touch_its_axis(screens: Screens) -> None:
    staged = StagedSession()
    assert "rejected" in iter(staged.stages())
    with staged.served() as (_, url):
        page = screens.open("about:blank")
        page.add_init_script(WATCH_PLOTS)
        page.goto(url)
        page.evaluate(STAND_STILL)
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            staged.wait_for(page, "")
            for words, points, crossed in page.evaluate(CROSSED):
                assert words >= 10
                assert points > 5
                assert not crossed


def test_the_angle_to_the_goal_is_the_guide_s(findings: Findings) -> None:
    ((shown, to_goal_deg),) = findings.angles
    assert shown.endswith("°")
    assert abs(float(shown[:-1]) - to_goal_deg) <= 1.0


def test_no_barrier_in_any_state(findings: Findings) -> None:
    if not AXE.exists():
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)("no axe-core, which npm installs: make scripts")
    assert not findings.barriers, "\n".join(findings.barriers)


def test_keyboard_alone(screens: Screens) -> None:
    staged = StagedSession()
    stages = staged.stages()
    next(stages)
    with staged.served() as (_, url):
        page = screens.open(url)
        # What would do nothing is not offered: nothing is measured yet.
        page.locator("[data-key=r]:disabled").wait_for()
        assert page.locator("#marks button:enabled:visible").count() == 3
        page.keyboard.press("u")
        staged.wait_for(page, next(stages))
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


def test_a_recording_is_called_one(screens: Screens) -> None:
    staged = StagedSession(replay_speed=4)
    next(staged.stages())
    with staged.served() as (server, url):
        page = screens.open(url)
        page.locator("#recording", has_text="4").wait_for()
        server.end(ENDED | {"outcome": "replayed", "accepted": 4, "command": "imufield replay --web"})
    page.locator("#details", has_text="imufield replay --web").wait_for()


def test_few_positions_are_called_few(screens: Screens) -> None:
    staged = StagedSession()
    next(staged.stages())
    with staged.served() as (server, url):
        page = screens.open(f"{url}&back=http://127.0.0.1:8778/")
        page.locator("#marks").wait_for()
        assert not page.locator("#recording").is_visible()
        server.end(ENDED | {"outcome": "stopped", "accepted": 4, "lacking": "at least 6 more"})
    # Who came from the workbench goes on there.
    said = page.locator("#details", has_text="6 more")
    said.wait_for()
    assert "imufield" not in said.inner_text()


@pytest.mark.parametrize("fragment", ["", "#token=another"])
def test_who_has_no_token_is_told_what_to_open(screens: Screens, idle: str, fragment: str) -> None:
    page = screens.open(idle.partition("#")[0] + fragment)
    page.locator("#link", has_text="address").wait_for()
    assert not page.locator("#marks").is_visible()


def test_a_guide_that_tells_nothing_is_told_of_though_the_program_answers(screens: Screens, idle: str) -> None:
    page = screens.open(idle)
    page.locator("#marks").wait_for()
    assert page.locator("#link").inner_text() == ""
    page.evaluate("() => { const now = Date.now; Date.now = () => now() + 60000; }")
    page.locator("#link", has_text="10 s").wait_for()


def test_text_of_others_stays_text(screens: Screens) -> None:
    hostile = "<img src=x onerror=alert(1)><script>alert(2)</script>"
    staged = StagedSession(instrument=hostile)
    staged.page.show([Marked(0.0, "undo", None, hostile)])
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
def test_the_way_back_leads_to_this_machine_alone(visitor: Page, idle: str, back: str, *, is_shown: bool) -> None:
    # Another fragment alone would load nothing.
    visitor.goto("about:blank")
    visitor.goto(f"{idle}&back={quote(back, safe='')}")
    visitor.locator("#marks").wait_for()
    assert visitor.locator("#back").is_visible() == is_shown
    assert visitor.locator("#back").get_attribute("href") == (back if is_shown else None)
