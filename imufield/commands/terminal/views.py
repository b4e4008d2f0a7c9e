"""Which front end draws the events of a capture: terminal, plain lines or JSON lines."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import typer

from imufield.commands.options.acquire import ViewName, ViewOptions
from imufield.commands.terminal.output import say
from imufield.deliver.parameters.numbers import beside
from imufield.guide.events import EVENT_VERSION, Event
from imufield.guide.lead.guide import Snapshot
from imufield.guide.positions import Scheme
from imufield.guide.view.plain import JsonLinesView, PlainView

if TYPE_CHECKING:
    from imufield.guide.view.sound import SoundView
    from imufield.guide.view.terminal import TerminalView

PLAIN_INDENT = 13
"""Of the words of a plain line, behind the time."""
LinkState = Literal["ok", "silent", "lost"]


@dataclass(frozen=True, slots=True)
class LiveStatus:
    """What a live view shows beside the events."""

    snapshot: Snapshot
    port: str
    link: LinkState
    samples_lost: int


class View(Protocol):
    """A front end."""

    def show(self, events: list[Event]) -> None:
        """Render events."""
        ...

    def refresh(self, status: LiveStatus) -> None:
        """Draw the state between events."""
        ...

    def toggle_big(self) -> None:
        """Change between big letters and pictures."""
        ...


class _Lines:
    """A view that has nothing to draw between events, but says when the wire falls silent."""

    def __init__(self, inner: PlainView | JsonLinesView, *, says_silence: bool) -> None:
        self._inner = inner
        self._says_silence = says_silence
        self._link: LinkState = "ok"

    def toggle_big(self) -> None:
        """Lines have one size."""

    def show(self, events: list[Event]) -> None:
        self._inner.show(events)

    def refresh(self, status: LiveStatus) -> None:
        # Once for each silence: a line ten times a second would push away what was said before.
        if self._says_silence and status.link != self._link and status.link == "silent":
            say(f"nothing arrives on {status.port}: check power and cable; waiting")
        self._link = status.link


class _Pictures:
    """The terminal view: events are kept until the next frame."""

    def __init__(self, inner: TerminalView) -> None:
        self._inner = inner
        self._events: list[Event] = []

    def toggle_big(self) -> None:
        self._inner.big = not self._inner.big

    def show(self, events: list[Event]) -> None:
        self._events += events

    def refresh(self, status: LiveStatus) -> None:
        events, self._events = self._events, []
        self._inner.show(events, status.snapshot, status.samples_lost, silent=status.link == "silent")


@contextmanager
def make_view(
    name: ViewName,
    session: Path,
    positions: Scheme,
    options: ViewOptions | None = None,
    *,
    origin_s: Callable[[], float] = lambda: 0.0,
) -> Iterator[View]:
    """Yield the view asked for; "auto" is the terminal view where there is a terminal, else plain lines.

    Sound goes with every view that a person reads; ``origin_s`` is what plain lines count their time from.
    """
    options = options or ViewOptions()
    # A program that reads JSON may run where nobody wants a beep.
    if name == "json" or options.quiet:
        with _silent_view(name, session, positions, options, origin_s=origin_s) as view:
            yield view
        return
    from imufield.guide.view.sound import open_sound

    with _silent_view(name, session, positions, options, origin_s=origin_s) as view, open_sound(speak=options.speak) as sound:
        yield _WithSound(view, sound)


class _WithSound:
    """A view and the sound that goes with it."""

    def __init__(self, view: View, sound: SoundView) -> None:
        self._view, self._sound = view, sound

    def show(self, events: list[Event]) -> None:
        self._sound.show(events)
        self._view.show(events)

    def refresh(self, status: LiveStatus) -> None:
        self._view.refresh(status)

    def toggle_big(self) -> None:
        self._view.toggle_big()


@contextmanager
def _silent_view(
    name: ViewName, session: Path, positions: Scheme, options: ViewOptions, *, origin_s: Callable[[], float]
) -> Iterator[View]:
    if name == "json":
        # The version first: a reader must know it before it reads anything else.
        typer.echo(json.dumps({"version": EVENT_VERSION, "event": "session", "session": str(session)}))
        yield _Lines(JsonLinesView(typer.echo), says_silence=False)
    elif name == "plain" or not sys.stdout.isatty():
        typer.echo(beside("session", session))
        yield _Lines(PlainView(lambda line: say(line, indent=PLAIN_INDENT), origin_s=origin_s), says_silence=True)
    else:
        from imufield.guide.view.terminal import TerminalView

        with TerminalView(positions, big=options.big, cable=options.cable) as view:
            yield _Pictures(view)
