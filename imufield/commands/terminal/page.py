"""The page of a capture: where it is served, what the terminal says of it, and its marks as keys."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from imufield.acquire.recording.session import Session
from imufield.commands.options.samples import CaptureOptions
from imufield.commands.terminal.output import say
from imufield.errors import Reason, UsageError
from imufield.guide.lead.guide import Snapshot
from imufield.guide.positions import Scheme
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.web.address import Place
    from imufield.web.guide_page import GuidePage
    from imufield.web.server import PageServer

sentence = Sentences(__package__)


def open_page(options: CaptureOptions, stack: ExitStack) -> Place | None:
    """Bind the socket of the page before anything else begins; None where no page is wanted.

    Raises
    ------
    UsageError
        If the packages are missing, or the address or port cannot be had.
    """
    if not options.web and options.web_lan is None:
        if options.web_port is not None:
            raise UsageError(sentence("page.port_alone"))
        return None
    return bind_page(options.web_lan, options.web_port, stack)


def bind_page(lan: str | None, port: int | None, stack: ExitStack) -> Place:
    """Bind the socket of a page; raises as ``open_page``."""
    try:
        from imufield.web.address import open_place
    except ImportError as error:
        raise UsageError(sentence("page.missing", package=error.name), Reason.MISSING_PACKAGE) from error
    place = open_place(lan, port)
    stack.callback(place.listening.close)
    return place


def show_in_browser(url: str) -> None:
    """Open a page where there is a display: without one the module falls back to browsers of the terminal."""
    if sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        webbrowser.open(url)


class ServedPage:
    """The page while it is served.

    Attributes
    ----------
    notice : str
        What the terminal shows in place of the guide until the first page is there or a key is pressed: the address, and its
        picture for a phone's camera.
    """

    def __init__(self, page: GuidePage, server: PageServer, notice: str) -> None:
        self.show, self.tell = page.show, page.tell
        self.notice = notice
        self._page, self._server = page, server

    def refresh(self, snapshot: Snapshot, *, silent: bool, samples_lost: int) -> None:
        """Show the state between events."""
        if self._server.pages:
            self.notice = ""
        self._page.refresh(snapshot, silent=silent, samples_lost=samples_lost)

    def read(self) -> str:
        """Return the keys that pages have sent since the last call."""
        return self._page.read()


@contextmanager
def serve_page(
    place: Place, positions: Scheme, session: Session, instrument: str, options: CaptureOptions
) -> Iterator[ServedPage]:
    """Serve the page while entered; say where it is, and open it where there is a browser."""
    from imufield.web.access import Access
    from imufield.web.address import qr_code
    from imufield.web.guide_page import GuidePage
    from imufield.web.server import PageServer

    access = Access(place.hosts)
    page = GuidePage(positions, session=session.name, instrument=instrument, cable=options.cable)
    url = f"{place.url}#token={access.mark}"
    lines = [sentence("page.at", url=url), sentence("page.watching", url=f"{place.url}#token={access.watch}")]
    if place.others:
        lines.append(sentence("page.others", others=list(place.others)))
    with PageServer(place.listening, access, page.board, page.mark) as server:
        for line in lines:
            say(line, err=True)
        notice = "" if options.web_lan is None else "\n".join([*lines, sentence("page.any_key"), "", qr_code(url)])
        if options.web_lan is None:
            show_in_browser(url)
        yield ServedPage(page, server, notice)
