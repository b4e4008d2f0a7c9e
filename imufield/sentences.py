"""The sentences people read: those of a room stand together in its ``sentences.toml``, the code names them by key.

``sentence = Sentences(__package__)`` at the top of a module, ``sentence("module.key", value=...)`` where one is needed. A text
is a format with named values, its line breaks mean nothing. Beside the formats of Python, ``{found:#position}`` counts ("1
position", "2 positions"), ``{size:#.3g}`` has three digits, zeros too ("0.120"), ``{folder!q}`` is quoted for a shell, as all
that a person is to type, and the values of a list are joined by commas.
Values come from wires and files of others: their control characters are shown and not sent to the terminal (``printable``).
"""

from __future__ import annotations

import re
import shlex
import string
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

_LONGEST_SHOWN = 40
_NEXT_TO_NOTHING = 0.0005  # Of micro-g, ppm and nautical miles: what rounding leaves of ideal outputs.
# C0 with the ends of lines, DEL and C1 move cursors and set titles; line and paragraph separators end lines; overrides,
# embeddings and isolates show text in another order than it has; a lone surrogate, of a file name that is no UTF-8, cannot be
# encoded. All other characters stay, the marks that Arabic and Hebrew need among them.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")

_MOST_NAMES = 8  # Of a line or two.
_FOLDED_FROM = 4  # Up to three are read one by one.
_VARIES = re.compile(r"\S*\d[^\s,;)]*|\b[xyz]\b")  # Numbers, names with a number ("y+45"), axes.
_SIZE = re.compile(r"(\S+) \(?([+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)(?=[\s,;)%]|$)")
_PLACES = ("at", "from", "to", "before")  # Behind these a number is a place or a time.


def folded(sentences: Iterable[str]) -> list[str]:
    """Return sentences for people to read: of many that differ in numbers, positions and axes alone, one.

    That is the worst with how many there are: the one with the largest number, of the first that differs between them and is no
    place. Where they differ in positions and axes alone, it is the first, with the positions of the others.
    """
    listed = list(dict.fromkeys(sentences))
    kinds: dict[str, list[str]] = {}
    for text in listed:
        kinds.setdefault(_VARIES.sub("\0", text), []).append(text)
    told = {alike[0]: _worst(alike) for alike in kinds.values() if len(alike) >= _FOLDED_FROM}
    hidden = {text for alike in kinds.values() if len(alike) >= _FOLDED_FROM for text in alike[1:]}
    return [told.get(text, text) for text in listed if text not in hidden]


def _worst(alike: list[str]) -> str:
    sizes = [[abs(float(size)) for word, size in _SIZE.findall(text) if word not in _PLACES] for text in alike]
    differing = next((column for column in zip(*sizes, strict=False) if len(set(column)) > 1), None)
    if differing is None:
        names = [column for column in zip(*map(_VARIES.findall, alike), strict=True) if len(set(column)) > 1]
        if all(name[0].isalpha() for column in names for name in column):
            # Whoever has to take positions again needs the names of all.
            others = [*dict.fromkeys(names[0][1:])]
            shown = ", ".join(others[:_MOST_NAMES]) + (" and others" if len(others) > _MOST_NAMES else "")
            return f"{alike[0].removesuffix('.')}; {len(alike) - 1} more like this: {shown}"
        return f"{len(alike)} sentences like this, the first: {alike[0]}"
    return f"{len(alike)} sentences like this, the largest: {alike[differing.index(max(differing))]}"


def counted(number: int, noun: str) -> str:
    """Return "1 position", "2 positions": a number with its noun, for sentences."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def three_digits(value: float) -> str:
    """Return a number for people in three digits, whole from 100 on: "1837", "0.0123", and "0" for what is next to nothing."""
    return f"{value:z.0f}" if abs(value) >= 100 or abs(value) < _NEXT_TO_NOTHING else f"{value:.3g}"


def shortened(text: str) -> str:
    """Return the beginning of a long text out of somebody's file, for sentences."""
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def printable(text: str) -> str:
    r"""Return a text of somebody else as one line that a terminal or a page shows as it is: ``\x1b`` for an escape."""
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def shell_word(value: object) -> str:
    r"""Return a file name, or another value, as a person types it: one word of a shell, and no option of a command.

    What is not ``printable`` is spelled as POSIX shells read it: ``$'new\nline'``.
    """
    text = str(value)
    text = f"./{text}" if text.startswith("-") else text
    if not _UNPRINTABLE.search(text):
        return shlex.quote(text)
    escaped = re.sub(r"[\\']", r"\\\g<0>", text)
    return f"$'{_UNPRINTABLE.sub(_spelled, escaped)}'"


def _spelled(found: re.Match[str]) -> str:
    character = found[0]
    if character < "\x80":
        return printable(character)
    # Of a file name that is no UTF-8 a surrogate stands for each byte; others are in no file name.
    is_byte = "\udc80" <= character <= "\udcff"
    return "".join(f"\\x{byte:02x}" for byte in character.encode(errors="surrogateescape" if is_byte else "replace"))


def printable_lines(text: str) -> str:
    """Return a text whose lines are ours in the form of ``printable``."""
    return "\n".join(map(printable, text.split("\n")))


def printable_values(value: object) -> object:
    """Return a value of a document with the texts in it in the form of ``printable``."""
    if isinstance(value, dict):
        return {key: printable_values(entry) for key, entry in value.items()}
    if isinstance(value, list):
        # Without a call for each number, of which a parameter file has a thousand.
        return [entry if isinstance(entry, float) else printable_values(entry) for entry in value]
    return printable(value) if isinstance(value, str) else value


class Sentence(str):
    """A sentence with what it was made of: its ``key``, for tests, and the ``values`` it names."""

    __slots__ = ("key", "values")

    key: str
    values: dict[str, Any]


class _Format(string.Formatter):
    def convert_field(self, value: object, conversion: str | None) -> object:
        return shell_word(value) if conversion == "q" else super().convert_field(value, conversion)

    def format_field(self, value: object, format_spec: str) -> str:
        if isinstance(value, list | tuple):
            return ", ".join(self.format_field(entry, format_spec) for entry in value)
        if format_spec.startswith("#"):
            return counted(value, format_spec[1:]) if isinstance(value, int) else format(value, format_spec).removesuffix(".")
        return printable(format(value, format_spec))


class Sentences:
    """The sentences of one room.

    Parameters
    ----------
    package : str
        The folder of the room, as ``__package__`` names it.
    """

    def __init__(self, package: str | None) -> None:
        self._package = package or ""

    def __contains__(self, key: str) -> bool:
        """Whether there is a sentence of a key, which may be a word out of somebody's file."""
        section, _, name = key.partition(".")
        return name in _table(self._package).get(section, {})

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
    import tomli  # Here, as most runs of the program need no sentence.

    folder = Path(__file__).parent.joinpath(*package.split(".")[1:])
    return tomli.loads((folder / "sentences.toml").read_text(encoding="utf-8"))
