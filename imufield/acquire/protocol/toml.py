"""Read a protocol's TOML with errors that name file, line and key, and with settings put in place.

A value may be written out, or taken from a setting::

    fraction_bits = 14
    unit = { setting = "accelerometer_unit" }                                    the value of the setting
    fraction_bits = { setting = "accelerometer_range_g", 10 = 19, 30 = 18 }      looked up by the value of the setting
"""

from __future__ import annotations

import copy
import difflib
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Self

from imufield.errors import ProtocolError, Reason

FILE_LIMIT_BYTES = 1 << 20
"""The largest shipped protocol is below 20 kB; 1 MiB leaves room and keeps a wrong file from filling memory."""

OTHER = "other"
"""In a look-up by a setting: for every value that is not listed."""

Path = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Source:
    """Text of a protocol file and what to call it in messages."""

    label: str
    text: str

    def error(self, path: Path, problem: str, reason: Reason | None = None) -> ProtocolError:
        """Return the error for the value at ``path``."""
        key = ".".join(str(part) for part in path) or "(whole file)"
        return ProtocolError(f"{self.label} line {self.line_of(path)}, key `{key}`: {problem}", reason, key=key)

    def line_of(self, path: Path) -> int:
        """Return the number of the line, from 1, where the value at ``path`` is written, as near as it can be found."""
        lines = self.text.splitlines()
        at, column = 0, 0
        for part in path:
            found = _find(lines, at, column, part)
            if found is None:
                break
            at, column = found
        return at + 1

    def parse(self) -> dict[str, object]:
        """Parse the text as TOML.

        Raises
        ------
        ProtocolError
            If it is no TOML; the message has the line.
        """
        try:
            return copy.deepcopy(_loaded(self.text))
        except tomllib.TOMLDecodeError as error:
            raise ProtocolError(f"{self.label} is not a readable TOML file: {error}") from error
        except RecursionError as error:
            raise ProtocolError(f"{self.label} nests its tables too deeply; a protocol needs three levels") from error


# Recognising an instrument reads each protocol several times, and reading the text is most of the work.
@lru_cache(maxsize=64)
def _loaded(text: str) -> dict[str, object]:
    return tomllib.loads(text)


def _find(lines: list[str], at: int, column: int, part: str | int) -> tuple[int, int] | None:
    if isinstance(part, int):
        return _find_element(lines, at, column, part)
    key = re.compile(rf"(?<![\w-])[\"']?{re.escape(part)}[\"']?\s*[=.\]]")
    for number in range(at, len(lines)):
        found = key.search(lines[number], column if number == at else 0)
        if found and not lines[number].lstrip().startswith("#"):
            return number, found.end()
    return None


def _find_element(lines: list[str], at: int, column: int, index: int) -> tuple[int, int] | None:
    """Find the element ``index`` of an array: by its opening brace, nested ones passed over."""
    depth, seen = 0, -1
    for number in range(at, len(lines)):
        for place in range(column if number == at else 0, len(lines[number])):
            character = lines[number][place]
            depth += {"{": 1, "}": -1}.get(character, 0)
            seen += character == "{" and depth == 1
            if character == "{" and depth == 1 and seen == index:
                return number, place + 1
    return None


@dataclass(slots=True, kw_only=True)
class Table:
    """One TOML table being read: every key is taken once, with its type checked; what is left over is refused.

    As a context manager it refuses at the end of the block.
    """

    values: dict[str, object]
    path: Path
    source: Source
    settings: Mapping[str, object] = field(default_factory=dict)
    _known: set[str] = field(default_factory=set)

    def error(self, key: str, problem: str, reason: Reason | None = None) -> ProtocolError:
        """Return the error for ``key`` of this table."""
        return self.source.error((*self.path, key) if key else self.path, problem, reason)

    def has(self, key: str) -> bool:
        """Whether the key is there."""
        self._known.add(key)
        return key in self.values

    def plain(self, key: str, default: object = None) -> object:
        """Return the value as written."""
        self._known.add(key)
        return self.values.get(key, default)

    def value(self, key: str, default: object = None) -> object:
        """Return the value, taken from a setting where it says so."""
        found = self.plain(key, default)
        if not (isinstance(found, dict) and "setting" in found):
            return found
        name = found["setting"]
        if not isinstance(name, str) or name not in self.settings:
            raise self.error(key, f"there is no setting {name!r}; declare it as [settings.{name}]")
        chosen = self.settings[name]
        lookup = {k: v for k, v in found.items() if k != "setting"}
        if not lookup:
            return chosen
        if spell(chosen) not in lookup and OTHER in lookup:
            return lookup[OTHER]
        if spell(chosen) not in lookup:
            raise self.error(key, f"nothing is given for setting {name} = {spell(chosen)}; add it")
        return lookup[spell(chosen)]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string."""
        found = self.value(key, default)
        if not isinstance(found, str):
            raise self.error(key, f"needs a text in quotes, not {_shown(found)}")
        return found

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number."""
        found = self.value(key, default)
        if isinstance(found, bool) or not isinstance(found, (int, float)) or not abs(found) < 1e300:
            raise self.error(key, f"needs a number, not {_shown(found)}")
        return float(found)

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return a whole number from ``low`` to ``high``."""
        found = self.value(key, default)
        if isinstance(found, bool) or not isinstance(found, int) or not low <= found <= high:
            raise self.error(key, f"needs a whole number from {low} to {high}, not {_shown(found)}")
        return found

    def flag(self, key: str, default: bool = False) -> bool:
        """Return true or false."""
        found = self.value(key, default)
        if not isinstance(found, bool):
            raise self.error(key, f"needs true or false, not {_shown(found)}")
        return found

    def choice(self, key: str, allowed: Iterable[str], default: str | None = None) -> str:
        """Return one of the allowed strings."""
        found = self.value(key, default)
        options = tuple(allowed)
        if not isinstance(found, str) or found not in options:
            raise self.error(key, f"needs one of {', '.join(options)}, not {_shown(found)}{near(found, options)}")
        return found

    def items(self, key: str, default: list[object] | None = None) -> list[object]:
        """Return an array."""
        found = self.value(key, default)
        if not isinstance(found, list):
            raise self.error(key, f"needs an array in brackets, not {_shown(found)}")
        return found

    def hexadecimal(self, key: str, default: str = "") -> bytes:
        """Return bytes written as "0D 0A"."""
        found = self.text(key, default)
        try:
            return bytes.fromhex(found)
        except ValueError:
            raise self.error(key, f'needs bytes in hexadecimal such as "0D 0A", not {_shown(found)}') from None

    def optional_text(self, key: str) -> str | None:
        """Return a string, None where the key is absent."""
        return self.text(key) if self.has(key) else None

    def optional_number(self, key: str) -> float | None:
        """Return a finite number, None where the key is absent."""
        return self.number(key) if self.has(key) else None

    def optional_integer(self, key: str, low: int, high: int) -> int | None:
        """Return a whole number from ``low`` to ``high``, None where the key is absent."""
        return self.integer(key, low, high) if self.has(key) else None

    def table(self, key: str) -> Table:
        """Return a table below this one, empty where the key is absent."""
        return self.below(self.plain(key, {}), key)

    def tables(self, key: str) -> Iterator[Table]:
        """Return the tables of an array."""
        for index, found in enumerate(self.items(key, [])):
            yield self.below(found, key, index)

    def below(self, found: object, *path: str | int) -> Table:
        """Return a table from a value that must be one."""
        if not isinstance(found, dict):
            raise self.source.error((*self.path, *path), f"needs a table in braces, not {_shown(found)}")
        return Table(values=found, path=(*self.path, *path), source=self.source, settings=self.settings)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.finish()

    def finish(self) -> None:
        """Refuse keys that nobody took."""
        for key in self.values:
            if key not in self._known:
                raise self.error(key, f"this key is not known here{near(key, self._known)}; remove it")


def near(word: object, known: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the nearest known word, or nothing."""
    found = difflib.get_close_matches(str(word), sorted(known), n=1)
    return f" (did you mean {found[0]!r}?)" if found else ""


def spell(value: object) -> str:
    """Return a value as one types it: true, 10, rate."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _shown(value: object) -> str:
    if value is None:
        return "nothing"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
