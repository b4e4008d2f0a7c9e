"""The real program for the tests of its page, and a browser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

from tests.commands.conftest import program, solved_session, whole_session
from tests.web.browser import Screens, open_browser

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from tests.web.served import Served

__all__ = ["program", "solved_session", "whole_session"]


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


@pytest.fixture
def pages() -> Iterator[ExitStack]:
    """Yield what keeps pages open; their sockets are closed without a word at the end."""
    with ExitStack() as pages:
        yield pages


@pytest.fixture
def served() -> Iterator[Served]:
    """Serve a board that the test writes on."""
    # Here, as the package that it needs may be missing.
    from tests.web.served import Served

    served = Served()
    with served.server:
        yield served
