"""Which front end draws the events of a capture: terminal, plain lines or JSON lines."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from imufield.commands.options.acquire_commands import CaptureOptions
from imufield.commands.terminal.output import echo, say
from imufield.deliver.parameters.printed_numbers import beside
from imufield.guide.events import EVENT_VERSION, Event
from imufield.guide.lead.guide import Snapshot
from imufield.guide.positions import Scheme
from imufield.guide.view.plain import JsonLinesView, PlainView
from imufield.progress import can_draw
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from imufield.commands.terminal.page import ServedPage
    from imufield.guide.view.sound import SoundView
    from imufield.guide.view.terminal import TerminalView

sentence = Sentences(__package__)

PLAIN_INDENT = 13
"""Of the words of a plain line, behind the time."""


class View:
    """The front end of a capture: lines or pictures, and the sound that goes with them."""

    def __init__(self, *, lines: PlainView | JsonLinesView | None = None, pictures: TerminalView | None = None) -> None:
        self.sound: SoundView | None = None
        self.page: ServedPage | None = None
        self._lines = lines
        self._pictures = pictures
        self._events: list[Event] = []  # Kept until the next picture.
        self._was_silent = False

    def show(self, events: list[Event]) -> None:
        """Render events."""
        if self.sound is not None:
            self.sound.show(events)
        if self.page is not None:
            self.page.show(events)
        if self._lines is not None:
            self._lines.show(events)
        else:
            self._events += events

    def refresh(self, snapshot: Callable[[], Snapshot], port: str, *, silent: bool, samples_lost: int) -> None:
        """Draw the state between events, asked for only then; lines draw nothing, but say when the wire falls silent."""
        if self._pictures is not None:
            events, self._events = self._events, []
            if self.page is not None:
                self._pictures.notice = self.page.notice
                self._pictures.page = self.page.url
            self._pictures.show(events, snapshot(), samples_lost, silent=silent)
        # Once for each silence: a line ten times a second would push away what was said before.
        elif isinstance(self._lines, PlainView) and silent and not self._was_silent:
            say(sentence("views.silent", port=port))
        self._was_silent = silent

    def tell(self, text: str) -> None:
        """Answer a key that is no mark; lines are answered as lines."""
        if self._pictures is not None:
            self._pictures.tell(text)
        elif isinstance(self._lines, PlainView):
            say(text, indent=PLAIN_INDENT)

    def toggle_big(self) -> None:
        """Change between big letters and pictures; lines have one size."""
        if self._pictures is not None:
            self._pictures.big = not self._pictures.big


@contextmanager
def make_view(options: CaptureOptions, session: Path, positions: Scheme, origin_s: Callable[[], float]) -> Iterator[View]:
    """Yield the view asked for; "auto" is the terminal view where there is a terminal that can draw, else plain lines.

    Sound goes with every view that a person reads; ``origin_s`` is what plain lines count their time from.
    """
    with ExitStack() as stack:
        if options.view == "json":
            # The version first: a reader must know it before it reads anything else.
            echo(json.dumps({"version": EVENT_VERSION, "event": "session", "session": str(session)}))
            view = View(lines=JsonLinesView(echo))
        elif options.view == "plain" or not can_draw(sys.stdout):
            echo(beside("session", session))
            view = View(lines=PlainView(lambda line: say(line, indent=PLAIN_INDENT), origin_s=origin_s))
        else:
            from imufield.guide.view.terminal import TerminalView

            view = View(pictures=stack.enter_context(TerminalView(positions, big=options.big, cable=options.cable)))
        # A program that reads JSON may run where nobody wants a beep.
        if options.view != "json" and not options.quiet:
            from imufield.guide.view.sound import open_sound

            view.sound = stack.enter_context(open_sound(speak=options.speak))
        yield view
