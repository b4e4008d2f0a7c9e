"""Which front end draws the events of a capture: terminal, plain lines or JSON lines."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

import typer

from imufield.guide.events import EVENT_VERSION, Event
from imufield.guide.guide import Snapshot
from imufield.guide.jsonlines import JsonLinesView
from imufield.guide.plain import PlainView
from imufield.guide.positions import Scheme

if TYPE_CHECKING:
    from imufield.guide.terminal import TerminalView

ViewName = Literal["auto", "plain", "json"]
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


class _Lines:
    """A view that has nothing to draw between events, but says when the wire falls silent."""

    def __init__(self, inner: PlainView | JsonLinesView, *, says_silence: bool) -> None:
        self._inner = inner
        self._says_silence = says_silence
        self._link: LinkState = "ok"

    def show(self, events: list[Event]) -> None:
        self._inner.show(events)

    def refresh(self, status: LiveStatus) -> None:
        if self._says_silence and status.link != self._link and status.link == "silent":
            typer.echo(f"nothing arrives on {status.port}: check power and cable; waiting")
        self._link = status.link


class _Pictures:
    """The terminal view: events are kept until the next frame."""

    def __init__(self, inner: TerminalView) -> None:
        self._inner = inner
        self._events: list[Event] = []

    def show(self, events: list[Event]) -> None:
        self._events += events

    def refresh(self, status: LiveStatus) -> None:
        events, self._events = self._events, []
        self._inner.show(events, status.snapshot, status.samples_lost, silent=status.link == "silent")


@contextmanager
def make_view(name: ViewName, session: Path, positions: Scheme) -> Iterator[View]:
    """Yield the view asked for; "auto" is the terminal view where there is a terminal, else plain lines."""
    if name == "json":
        typer.echo(json.dumps({"version": EVENT_VERSION, "event": "session", "session": str(session)}))
        yield _Lines(JsonLinesView(typer.echo), says_silence=False)
    elif name == "plain" or not sys.stdout.isatty():
        typer.echo(f"session {session}")
        yield _Lines(PlainView(typer.echo), says_silence=True)
    else:
        from imufield.guide.terminal import TerminalView

        with TerminalView(positions) as view:
            yield _Pictures(view)
