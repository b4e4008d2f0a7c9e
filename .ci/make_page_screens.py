"""Make the pictures of the guide's page: all its states on every screen, by day and by night; ``make screens``.

A session without a wire or a clock goes through the states (``tests/web/guide_stages.py``), pages of one browser look on. And
two of the workbench, in which a simulated session is computed.
"""

from __future__ import annotations

import base64
import os
import sys
import tempfile
from collections import defaultdict
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from imufield.web.workbench import Workbench  # noqa: E402
from tests.commands.conftest import simulated_session  # noqa: E402
from tests.web.browser import open_browser  # noqa: E402
from tests.web.guide_stages import ENDED, STAND_STILL, StagedSession  # noqa: E402
from tests.web.served import Served  # noqa: E402

if TYPE_CHECKING:
    from playwright.sync_api import Page

Key = tuple[str, str]
"""Screen and scheme."""
FOLDER = ROOT / "docs" / "screens"
# Name, width and height of the screen, width of its pictures on the sheet.
SCREENS = (("phone", 390, 844, 180), ("tablet", 768, 1024, 240), ("laptop", 1280, 800, 320))
ALONE = {("turning", "laptop", "light"): "page", ("holding", "phone", "dark"): "page-hold"}
COLUMNS = {"phone": 8, "tablet": 5, "laptop": 5}
SLOW_MS = 120_000.0  # Commands on a busy machine, and a port that says nothing.
QUALITY = {"alone": 45, "once": 80, "sheet": 40}
STYLE = "body{margin:8px;background:#777;font:14px sans-serif;color:#fff;display:grid;gap:8px}figure{margin:0}img{width:100%}"


def take(page: Page, quality: int, *, whole: bool = False) -> bytes:
    """Return a picture of a page as WebP."""
    # Two frames: what came last is drawn.
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    options = {"format": "webp", "quality": quality, "captureBeyondViewport": whole}
    size = page.evaluate("[innerWidth, document.documentElement.scrollHeight]")
    if whole:
        options["clip"] = {"x": 0, "y": 0, "width": size[0], "height": size[1], "scale": 1}
    return base64.b64decode(page.context.new_cdp_session(page).send("Page.captureScreenshot", options)["data"])


def photograph(pages: dict[Key, Page], state: str, pictures: dict[Key, list[tuple[str, bytes]]]) -> None:
    """Take a picture of each page, and of some one that stands alone."""
    for key, page in pages.items():
        if (state, *key) in ALONE:
            (FOLDER / f"{ALONE[state, *key]}.webp").write_bytes(take(page, QUALITY["alone"]))
        pictures[key].append((state, take(page, QUALITY["once"])))


def visit(pages: dict[Key, Page], pictures: dict[Key, list[tuple[str, bytes]]]) -> None:
    """Go through all states, with all pages at once."""
    staged = StagedSession()
    with staged.served() as (server, url):
        for page in pages.values():
            page.goto(url)
        for state in staged.stages():
            for page in pages.values():
                staged.wait_for(page, state)
            photograph(pages, state, pictures)
        server.end(ENDED)
    for page in pages.values():
        page.locator("#headline", has_text="FINISHED").wait_for()
    photograph(pages, "ended", pictures)
    staged = StagedSession()
    state = next(staged.stages())
    with staged.served() as (_, url):
        for page in pages.values():
            page.goto(url)
            staged.wait_for(page, state)
    for page in pages.values():
        page.locator("body.away").wait_for()
    photograph(pages, "no connection", pictures)


def main() -> None:
    """Write single pictures, and a sheet of all states for each screen and scheme."""
    pictures: dict[Key, list[tuple[str, bytes]]] = defaultdict(list)
    pages: dict[Key, Page] = {}
    with open_browser() as browser:
        for (name, width, height, _), scheme in product(SCREENS, ("light", "dark")):
            page = browser.new_context(viewport={"width": width, "height": height}, reduced_motion="reduce").new_page()
            page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
            page.add_init_script(STAND_STILL)
            pages[name, scheme] = page
        visit(pages, pictures)
        for (name, scheme), taken in pictures.items():
            write_sheet(pages[name, scheme], name, scheme, taken)
        photograph_workbench(browser.new_page(viewport={"width": 1100, "height": 1000}))


def photograph_workbench(page: Page) -> None:
    """Take a picture of what begins a session, and of the result of one."""
    with tempfile.TemporaryDirectory() as folder:
        # The page shows the paths of its commands as they are typed.
        os.chdir(folder)
        root = Path("imufield-sessions")
        simulated_session(root / "2026-03-14-workshop", serial_number="N25581846020021")
        bench = Workbench(root)
        served = Served(bench.board, bench.take, bench.service)
        with served.server:
            bench.refresh()
            page.goto(served.url)
            page.locator("#virtual").click()
            # Ports of this machine are nobody's business.
            page.locator("#look:enabled").wait_for(timeout=SLOW_MS)
            page.evaluate("() => document.querySelectorAll('.port:not(:has(:checked))').forEach((port) => port.remove())")
            page.get_by_label("Bias wanted to").fill("100")
            page.get_by_label("Bias wanted to").blur()
            page.locator("#plan-says", has_text="100").wait_for(timeout=SLOW_MS)
            page.screenshot(path=FOLDER / "workbench.png")
            page.locator('header a[href="#sessions"]').click()
            page.locator("#list a").click(timeout=SLOW_MS)
            page.locator("#steps button.main").click(timeout=SLOW_MS)
            page.get_by_role("button", name="Show the signals").click(timeout=SLOW_MS)
            page.locator("#signals-of-session polyline").first.wait_for(timeout=SLOW_MS)
            page.set_viewport_size({"width": 1100, "height": 1240})
            page.screenshot(path=FOLDER / "workbench-result.png")
        bench.close()
        os.chdir(ROOT)


def write_sheet(page: Page, name: str, scheme: str, taken: list[tuple[str, bytes]]) -> None:
    """Write all states of one screen beside each other."""
    each = next(width for screen, _, _, width in SCREENS if screen == name)
    columns = COLUMNS[name]
    figures = "".join(
        f'<figure>{state}<img src="data:image/webp;base64,{base64.b64encode(picture).decode()}"></figure>'
        for state, picture in taken
    )
    page.goto("about:blank")
    page.set_viewport_size({"width": columns * (each + 8) + 8, "height": 400})
    page.set_content(f"<style>{STYLE}body{{grid-template-columns:repeat({columns},{each}px)}}</style>{figures}")
    (FOLDER / f"page-{name}-{scheme}.webp").write_bytes(take(page, QUALITY["sheet"], whole=True))


if __name__ == "__main__":
    main()
