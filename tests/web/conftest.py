"""The real program for the tests of its page, and a browser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from tests.commands.conftest import program, whole_session
from tests.web.browser import Screens, open_browser

if TYPE_CHECKING:
    from playwright.sync_api import Browser

__all__ = ["program", "whole_session"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Start one browser for the tests of a file."""
    with open_browser() as browser:
        yield browser


@pytest.fixture
def screens(browser: Browser) -> Iterator[Screens]:
    """Yield what opens pages; they are closed at the end."""
    screens = Screens(browser)
    yield screens
    screens.close()
