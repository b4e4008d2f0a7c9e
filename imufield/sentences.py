"""The sentences people read: those of a room stand together in its ``sentences.toml``, the code names them by key.

``sentence = Sentences(__package__)`` at the top of a module, ``sentence("module.key", value=...)`` where one is needed. A text
is a format with named values, its line breaks mean nothing. Beside the formats of Python, ``{found:#position}`` counts
("1 position", "2 positions"), and the values of a list are joined by commas.
"""

from __future__ import annotations

import string
from functools import cache
from pathlib import Path
from typing import Any

_LONGEST_SHOWN = 40


def counted(number: int, noun: str) -> str:
    """Return "1 position", "2 positions": a number with its noun, for sentences."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def shortened(text: str) -> str:
    """Return the beginning of a long text out of somebody's file, for sentences."""
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


class Sentence(str):
    """A sentence with what it was made of: its ``key``, for tests, and the ``values`` it names."""

    __slots__ = ("key", "values")

    key: str
    values: dict[str, Any]


class _Format(string.Formatter):
    def format_field(self, value: object, format_spec: str) -> str:
        if isinstance(value, list | tuple):
            return ", ".join(self.format_field(entry, format_spec) for entry in value)
        if format_spec.startswith("#") and isinstance(value, int):
            return counted(value, format_spec[1:])
        return format(value, format_spec)


class Sentences:
    """The sentences of one room.

    Parameters
    ----------
    package : str
        The folder of the room, as ``__package__`` names it.
    """

    def __init__(self, package: str | None) -> None:
        self._package = package or ""

    def __call__(self, key: str, /, **values: object) -> Sentence:
        """Return the sentence of a key, with its values filled in."""
        section, _, name = key.partition(".")
        # Read when the first sentence is needed: most runs of most rooms need none.
        text = _table(self._package)[section][name]
        made = Sentence(_Format().vformat(" ".join(text.split()), (), values))
        made.key, made.values = key, values
        return made


@cache
def _table(package: str) -> dict[str, dict[str, str]]:
    import tomllib  # Here, as most runs of the program need no sentence.

    folder = Path(__file__).parent.joinpath(*package.split(".")[1:])
    return tomllib.loads((folder / "sentences.toml").read_text(encoding="utf-8"))
