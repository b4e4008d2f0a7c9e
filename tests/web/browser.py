"""A real browser without a window: pages opened in it, and what they wrote to their consoles."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, ViewportSize

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
# A sandbox needs rights that a container lacks; updates and the like would take processor time and go to the network, and
# a graphics card is looked for in vain.
ARGUMENTS = (
    *("--no-sandbox", "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage"),
    *("--disable-gpu", "--disable-software-rasterizer"),
)
PHONE: ViewportSize = {"width": 390, "height": 844}
WAIT_MS = 120_000.0  # Only a page that hangs takes so long, however busy the machine.


@dataclass
class Screens:
    """Pages of one browser, each with a memory of its own as on devices of their own."""

    browser: Browser
    console: list[str] = field(default_factory=list)
    """What any page wrote to its console, errors included."""
    _contexts: list[BrowserContext] = field(default_factory=list)

    def open(self, url: str, *, calm: bool = True) -> Page:
        """Open an address as a new device does; ``calm`` is one whose owner wants no motion."""
        motion: Literal["reduce", "no-preference"] = "reduce" if calm else "no-preference"
        context = self.browser.new_context(viewport=PHONE, reduced_motion=motion)
        context.set_default_timeout(WAIT_MS)
        self._contexts.append(context)
        page = context.new_page()
        page.on("console", self._hear)
        page.on("pageerror", lambda error: self.console.append(f"error: {error}"))
        page.goto(url)
        return page

    def _hear(self, message: ConsoleMessage) -> None:
        self.console.append(f"{message.type}: {message.text}")

    def close(self) -> None:
        """Close all pages."""
        while self._contexts:
            self._contexts.pop().close()


@contextmanager
def open_browser(*arguments: str) -> Iterator[Browser]:
    """Yield a browser; skip where there is none, and fail where continuous integration has none."""
    absent = None
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        absent = "no Chromium: install it by the package manager, e.g. apt install chromium"
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        absent = "no Playwright: pip install playwright"
    if absent is not None:
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(f"the page is not tried in a browser: {absent}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=[*ARGUMENTS, *arguments])
        try:
            yield browser
        finally:
            browser.close()
