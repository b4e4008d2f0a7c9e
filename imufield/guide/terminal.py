"""The live view in a terminal: thin, it only hands ``screen`` to rich."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from imufield.guide.events import Event
from imufield.guide.guide import Snapshot
from imufield.guide.positions import Scheme
from imufield.guide.screen import HEIGHT, WIDTH, LinkState, Screen, draw, draw_big, draw_small


class TerminalView:
    """Shows a session at up to 10 frames a second; use as a context manager.

    Parameters
    ----------
    scheme : Scheme
    console : rich.console.Console, optional
    big : bool
    cable : str, optional
        Face where the cable leaves, "-x".
    """

    FRAMES_PER_SECOND = 10

    def __init__(self, scheme: Scheme, console: Console | None = None, *, big: bool = False, cable: str | None = None) -> None:
        self._cable = cable
        self.big = big
        """Big letters instead of pictures."""
        self._scheme = scheme
        self._screen = Screen()
        self._live = Live(
            Text(),
            console=console,
            auto_refresh=False,
            screen=True,
            vertical_overflow="crop",
        )

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._live.stop()

    def show(self, events: list[Event], snapshot: Snapshot, lost_samples: int | None = None, *, silent: bool = False) -> None:
        """Draw the state after these events; call it at most ``FRAMES_PER_SECOND`` times a second.

        ``silent`` says that the port is there, but nothing arrives.
        """
        self._screen.follow(events)
        link = LinkState(lost_samples, silent, self._cable)
        width, height = self._live.console.size
        if width < WIDTH or height < HEIGHT:
            picture = draw_small(self._screen, snapshot, link, width=width, height=height)
        elif self.big:
            picture = draw_big(self._screen, snapshot, link)
        else:
            ascii_only = self._live.console.options.ascii_only
            picture = draw(self._screen, snapshot, self._scheme, link, ascii_only=ascii_only, size=(width, height))
        self._live.update(picture, refresh=True)
