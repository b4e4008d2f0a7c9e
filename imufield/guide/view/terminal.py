"""The live view in a terminal, and single keys from it without Enter and without blocking.

The view only hands the pictures of ``screen`` to rich.
"""

from __future__ import annotations

import atexit
import importlib
import os
import sys
from contextlib import ExitStack, suppress
from types import ModuleType, TracebackType
from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from imufield.console import PlainTextConsole
from imufield.guide.events import Event
from imufield.guide.lead.guide import Snapshot
from imufield.guide.positions import Scheme
from imufield.guide.view.instruction import Screen
from imufield.guide.view.screen import HEIGHT, WIDTH, LinkState, draw, draw_big, draw_small, has_room_for_big


class Keyboard(ExitStack):
    """Keys typed since the last read; none where standard input is no terminal.

    Use as a context manager: the terminal is restored, whatever happens. Ctrl-C keeps its meaning.
    """

    def __init__(self) -> None:
        super().__init__()
        self._descriptor: int | None = None

    def __enter__(self) -> Self:
        if os.name == "posix" and sys.stdin is not None and sys.stdin.isatty():
            import termios
            import tty

            descriptor = self._descriptor = sys.stdin.fileno()
            before = termios.tcgetattr(descriptor)

            def restore() -> None:
                # The terminal may be closed already; then there is nothing to put back.
                with suppress(termios.error):
                    termios.tcsetattr(descriptor, termios.TCSADRAIN, before)

            self.callback(setattr, self, "_descriptor", None)
            self.callback(atexit.unregister, restore)
            self.callback(restore)
            # An interrupt that comes before the ``with`` has begun, or while it ends, passes by these or breaks them off.
            atexit.register(restore)
            tty.setcbreak(descriptor)
        return self

    def read(self) -> str:
        """Return the characters typed since the last call, lower case, "" when there are none."""
        typed = ""
        if os.name == "nt":
            msvcrt: ModuleType = importlib.import_module("msvcrt")
            while msvcrt.kbhit():
                typed += msvcrt.getwch()
            return typed.lower()
        if self._descriptor is None:
            return ""
        import select

        while select.select([self._descriptor], [], [], 0)[0]:
            data = os.read(self._descriptor, 64)
            if not data:
                self._descriptor = None  # End of file: the terminal went away.
                break
            typed += data.decode("ascii", "ignore")
        return typed.lower()


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

    def __init__(self, scheme: Scheme, console: Console | None = None, *, big: bool = False, cable: str | None = None) -> None:
        self._cable = cable
        self.big = big  # Big letters instead of pictures.
        self.notice = ""  # Shown instead of either, as long as there is one.
        self.page = ""  # Address of the page, as ``LinkState`` has it.
        self._scheme = scheme
        self._screen = Screen()
        self._live = Live(
            Text(), console=console or PlainTextConsole(), auto_refresh=False, screen=True, vertical_overflow="crop"
        )

    def tell(self, text: str) -> None:
        """Show a message with the next picture."""
        self._screen.tell(text)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._live.stop()

    def show(self, events: list[Event], snapshot: Snapshot, lost_samples: int | None = None, *, silent: bool = False) -> None:
        """Draw the state after these events; at most 10 times a second.

        ``silent`` says that the port is there, but nothing arrives.
        """
        self._screen.follow(events)
        link = LinkState(lost_samples, silent, self._cable, self.page)
        width, height = self._live.console.size
        ascii_only = self._live.console.options.ascii_only
        picture: RenderableType
        if self.notice:
            picture = Text(self.notice, no_wrap=True, overflow="crop")
        elif self.big and has_room_for_big(self._screen, snapshot, link, (width, height)):
            picture = draw_big(self._screen, snapshot, link, (width, height))
        elif width < WIDTH or height < HEIGHT:
            picture = draw_small(self._screen, snapshot, link, width=width, height=height, ascii_only=ascii_only)
        else:
            picture = draw(self._screen, snapshot, self._scheme, link, ascii_only=ascii_only, size=(width, height))
        self._live.update(picture, refresh=True)
