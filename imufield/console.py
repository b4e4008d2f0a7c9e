"""The terminal as rich draws on it: tables, summaries and the live view."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import IO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from imufield.progress import hidden
from imufield.sentences import printable_lines

_SIZES = ("COLUMNS", "LINES")


class PlainTextConsole(Console):
    """A console on which text is text: it has no markup, and what controls a terminal in it is shown.

    Parameters
    ----------
    width : int, optional
        Characters of a line where this is no terminal: without colour then.
    file : file of text, optional
        Where it goes instead of standard output.
    """

    def __init__(self, *, width: int | None = None, file: IO[str] | None = None) -> None:
        if width is None:
            # rich believes a size of 0, and shows nothing.
            environment = {name: value for name, value in os.environ.items() if name not in _SIZES or value != "0"}
            super().__init__(file=file, markup=False, emoji=False, _environ=environment)
        else:
            super().__init__(width=width, file=file, color_system=None, legacy_windows=False, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the pieces of a renderable; the sequences for colour and cursor are rich's own, added behind this."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable_lines(segment.text))

    def _check_buffer(self) -> None:
        with hidden():
            super()._check_buffer()
