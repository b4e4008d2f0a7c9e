"""The page of a capture or a replay: where it is served, what the terminal says of it, and its marks as keys."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from imufield.acquire.recording.session import Session
from imufield.commands.options.acquire_commands import CaptureOptions
from imufield.commands.options.configuration import instrument_stl
from imufield.commands.terminal.output import echo, say
from imufield.errors import UsageError, missing_package
from imufield.guide.events import EVENT_VERSION
from imufield.guide.lead.guide import Snapshot
from imufield.guide.positions import Scheme
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.web.address import PageAddress
    from imufield.web.guide_page import GuidePage
    from imufield.web.server import PageServer

sentence = Sentences(__package__)

SHOWN_EVERY_S = 0.05
"""On a page that looks: its box follows each state within two frames, so that a turn is seen while it is made."""


def open_page(options: CaptureOptions, stack: ExitStack) -> PageAddress | None:
    """Bind the socket of a capture's page before anything else begins; None where no page is wanted.

    Raises
    ------
    UsageError
        As ``bind_page``, or a port is given for no page.
    """
    if not options.web and options.web_lan is None:
        if options.web_port is not None:
            raise UsageError(sentence("page.port_alone"))
        return None
    return bind_page(stack, options.web_lan, options.web_port)


def bind_page(stack: ExitStack, lan: str | None = None, port: int | None = None) -> PageAddress:
    """Bind the socket of a page; address and port as ``open_place`` takes them.

    Raises
    ------
    UsageError
        If the packages are missing, the address or port cannot be had, or the drawing of the instrument is none.
    """
    try:
        import imufield.web.server  # noqa: F401  (what it needs is missed before anything else begins)
        from imufield.web.address import open_place
    except ImportError as error:
        raise missing_package(
            "the page", error.name or "websockets", "web", "" if isinstance(error, ModuleNotFoundError) else error
        ) from error
    _shape()
    place = open_place(lan, port)
    stack.callback(place.listening.close)
    return place


def show_in_browser(url: str) -> None:
    """Open a page where there is a display: without one the module falls back to browsers of the terminal."""
    if sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        import webbrowser  # late: it runs programs, and nothing else here does

        webbrowser.open(url)


def _shape() -> str | None:
    """Return the user's drawing of the instrument, None where there is none."""
    from imufield.web.stl_file import read_stl

    drawing = instrument_stl()
    return None if drawing is None else read_stl(drawing)


class ServedPage:
    """The page while it is served.

    Attributes
    ----------
    url : str
        Its address.
    notice : str
        What the terminal shows in place of the guide until the first page is there or a key is pressed: the address, and its
        picture for a phone's camera.
    """

    def __init__(self, page: GuidePage, server: PageServer, url: str, notice: str) -> None:
        self.show, self.read, self.end = page.show, page.read, server.end
        self.url, self.notice = url, notice
        self._page, self._server = page, server

    def refresh(self, snapshot: Snapshot, *, silent: bool = False, samples_lost: int) -> None:
        """Show the state between events."""
        if self.is_looked_at:
            self.notice = ""
        self._page.refresh(snapshot, silent=silent, samples_lost=samples_lost)

    @property
    def is_looked_at(self) -> bool:
        """Whether a page looks at the moment."""
        return self._server.pages > 0


@contextmanager
def serve_page(
    place: PageAddress,
    positions: Scheme,
    session: Session,
    *,
    cable: str | None = None,
    as_json: bool = False,
    replay_speed: float | None = None,
) -> Iterator[ServedPage]:
    """Serve the page while entered; say where it is, and open it where there is a browser.

    A program that reads JSON gets the addresses as a line of it, and opens the page itself. A replay, at times the speed of
    the recording, takes no marks; 0 is as fast as possible.
    """
    from imufield.web.access import Access, Role
    from imufield.web.address import qr_code
    from imufield.web.guide_page import GuidePage
    from imufield.web.server import PageServer

    access = Access(place.hosts)
    takes_marks = replay_speed is None
    page = GuidePage(
        positions,
        session=session.name,
        instrument=session.record.model,
        cable=cable,
        shape=_shape(),
        replay_speed=replay_speed,
    )
    watch_url = f"{place.url}#token={access.watch}"
    url = f"{place.url}#token={access.mark}" if takes_marks else watch_url
    lines = [sentence("page.at", url=url)]
    if takes_marks:
        lines.append(sentence("page.watching", url=watch_url))
    if place.others:
        lines.append(sentence("page.others", others=list(place.others)))
    with PageServer(place.listening, access, page.board, page.mark) as server:
        if as_json:
            echo(json.dumps({"version": EVENT_VERSION, "event": "page", "url": url, "watch_url": watch_url}))
        else:
            for line in lines:
                say(line, err=True)
            if not place.is_in_network:
                show_in_browser(f"{place.url}#token={access.once(Role.MARK if takes_marks else Role.WATCH)}")
        notice = "\n".join([*lines, sentence("page.any_key"), "", qr_code(url)]) if place.is_in_network else ""
        yield ServedPage(page, server, url, notice)
