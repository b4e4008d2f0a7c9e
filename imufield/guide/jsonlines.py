"""JSON lines: one event, one line; for other programs as front ends."""

from __future__ import annotations

import json
from collections.abc import Callable

from imufield.guide.events import Event


class JsonLinesView:
    """Writes every event as one line of JSON.

    Parameters
    ----------
    write : callable
        Takes one line without its end.
    """

    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write

    def show(self, events: list[Event]) -> None:
        """Write events."""
        for event in events:
            self._write(json.dumps(event.to_dict(), allow_nan=False))
