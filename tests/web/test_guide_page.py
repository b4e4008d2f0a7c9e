"""A whole session from the page in a real browser, with a cable out, a reload and other pages beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.commands.conftest import recorded_events
from tests.web.page_session import POSITIONS, PageSession, finish, parameters_of, wait_for, without_a_page

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from tests.commands.conftest import Program
    from tests.web.browser import Screens

pytest.importorskip("websockets", reason="the page needs websockets")


def tap(page: Page, key: str) -> None:
    page.locator(f"#marks [data-key={key}]").click()


def leave_one_out(page: Page) -> dict[str, str]:
    """Return the list of positions as a person reads it; which is the next one changes while it is read."""
    return {row.locator(".name").inner_text(): row.locator(".off").inner_text() for row in page.locator("#positions li").all()}


def oldest(page: Page, count: int) -> list[str]:
    """Return the first lines of the log, which stand last; new ones come while it is read."""
    return page.locator("#log li").all_inner_texts()[::-1][:count]


def marked(session: PageSession, page: Page, key: str, action: str) -> str:
    """Tap a mark and return the position that the program has marked."""
    before = len(session.told)
    tap(page, key)
    event = session.wait_for(lambda told: told["event"] == "marked" and told["action"] == action, after=before)
    # What the terminal is told stands on the page, too, with its own button.
    page.locator("#log li", has_text=event["words"].replace("[finish]", "tap “finish”")).first.wait_for()
    return str(event["position"])


# The browser, six programs and four minutes of samples take ten seconds of processor time: once, for all that a page does.
def test_a_whole_session_from_the_page(program: Program, screens: Screens) -> None:
    session = PageSession.begin(program)
    page, watching = screens.open(session.url), screens.open(session.watch_url)
    assert "token" not in page.url
    wait_for(page, "#done", r"^([2-9]|1\d|2\d)$")
    tap(page, "p")
    # While it is paused, no measurement comes between two marks.
    for each in (page, watching):
        wait_for(each, "#headline", "PAUSED")
    skipped = marked(session, page, "s", "skip")
    assert marked(session, page, "u", "undo") == skipped
    retaken = marked(session, page, "r", "retake")
    # Whoever may only watch finds no marks, and keys do nothing.
    assert not watching.locator("#marks").is_visible()
    watching.keyboard.press("s")
    watching.keyboard.press("p")
    before = session.told[-1]
    page.reload()
    wait_for(page, "#headline", "PAUSED")
    page.locator("#log li", has_text=retaken).first.wait_for()
    assert session.told[-1] == before
    tap(page, "p")
    wait_for(page, "#headline", "TURN|HOLD")
    session.unplug()
    wait_for(page, "#headline", "NO LINK")
    session.plug_in()
    page.locator("#log li.link_back").wait_for()
    second = screens.open(session.url)
    wait_for(page, "#done", "^24$")
    # The person goes on turning it while the pages are read, and may show what ends the session.
    tap(page, "p")
    for each in (page, second, watching):
        wait_for(each, "#headline", "PAUSED")
    found = leave_one_out(page)
    assert found == leave_one_out(second) == leave_one_out(watching)
    assert sorted(found) == sorted(POSITIONS)
    assert all(found.values())
    assert oldest(page, 30) == oldest(second, 30)
    # Who may only watch is told the name of a mark, and no button.
    assert oldest(watching, 30) == [line.replace("tap “", "“") for line in oldest(page, 30)]
    assert len(oldest(page, 30)) == 30
    # The end needs a second tap, as the first says; any page may make it.
    marked(session, second, "f", "finish")
    assert session.process.poll() is None
    finish(session, second)
    for each in (page, second, watching):
        wait_for(each, "#headline", "FINISHED")
        wait_for(each, "#details", r"24 of 24 [\s\S]* imufield solve")
    assert session.process.wait(300) == 0, session.process.communicate()[1]
    assert screens.console == []

    # What a capture without a page makes of the same bytes and marks.
    recorded = session.recorded
    marks = [event["action"] for event in recorded if event["event"] == "mark"]
    assert marks == ["pause", "skip", "undo", "retake", "pause", "pause", "finish"]
    assert recorded_events(without_a_page(session.session, program.folder / "without")) == recorded
    measured = [event["position"] for event in recorded if event["event"] == "accepted"]
    assert sorted(set(measured)) == sorted(POSITIONS)
    assert measured.count(retaken) == 2
    assert session.session.finished
    parameters = parameters_of(program, session.session.folder)
    assert parameters == parameters_of(program, program.folder / "without")
    assert parameters.count("[[position]]") == len(POSITIONS)
