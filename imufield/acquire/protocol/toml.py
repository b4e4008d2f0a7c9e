"""Read a protocol's TOML with errors that name file, line and key, and with settings put in place.

A value may be written out, or taken from a setting::

    fraction_bits = 14
    unit = { setting = "accelerometer_unit" }                                    the value of the setting
    fraction_bits = { setting = "accelerometer_range_g", 10 = 19, 30 = 18 }      looked up by the value of the setting
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Self, TypeVar

from imufield.dataclass import dataclass, field
from imufield.errors import ProtocolError, Reason, SettingError
from imufield.sentences import Sentence, Sentences, shortened
from imufield.toml_and_json import Place, line_of, parse_toml

sentence = Sentences(__package__)

FILE_LIMIT_BYTES = 1 << 20
"""The largest shipped protocol is below 20 kB; 1 MiB leaves room and keeps a wrong file from filling memory."""

OTHER = "other"
"""In a look-up by a setting: for every value that is not listed."""

LARGEST = 1e30
"""Of numbers: nobody means more, and squares and products of what is smaller are numbers."""

LEAST_SCALE = 1e-30
"""Of factors, whatever their sign: nothing can be told from what is multiplied by 0."""

_Kind = TypeVar("_Kind")


@dataclass(frozen=True, slots=True)
class Source:
    """Text of a protocol file and what to call it in messages."""

    label: str
    text: str
    options: Mapping[str, str] = field(default_factory=dict)
    """The option that states each key, where the text was made from options."""

    def error(self, path: Place, problem: str, reason: Reason | None = None) -> ProtocolError:
        """Return the error for the value at ``path``; its key and values are those of the problem."""
        key = ".".join(map(str, path)) or "(whole file)"
        if key in self.options:
            stated = sentence("toml.option", option=self.options[key], problem=problem)
            return SettingError(_about(stated, problem, key), reason)
        message = sentence("toml.place", label=self.label, line=line_of(self.text, path), key=key, problem=problem)
        return ProtocolError(_about(message, problem, key), reason)

    def parse(self) -> dict[str, object]:
        """Parse the text as TOML; raises ProtocolError as ``parse_toml``."""
        return {key: _copy(value) for key, value in _parsed(self.text, self.label, ProtocolError).items()}


def _about(message: Sentence, problem: str, key: str) -> Sentence:
    """Return a message with the key and the values of the problem that it names."""
    if isinstance(problem, Sentence):
        message.key, message.values = problem.key, {**problem.values, "key": key}
    return message


def _copy(value: object) -> object:
    """Return a copy of tables and lists; what else TOML has cannot be changed."""
    if isinstance(value, dict):
        return {key: _copy(inner) for key, inner in value.items()}
    return [_copy(inner) for inner in value] if isinstance(value, list) else value


# Recognising an instrument reads each protocol several times, and reading the text is most of the work.
_parsed = lru_cache(maxsize=64)(parse_toml)


@dataclass(slots=True, kw_only=True)
class Table:
    """One TOML table being read: every key is taken once, with its type checked; what is left over is refused.

    As a context manager it refuses at the end of the block.
    """

    values: dict[str, object]
    path: Place
    source: Source
    settings: Mapping[str, object] = field(default_factory=dict)
    given: Collection[str] = ()
    """The settings that the user gave."""
    _known: set[str] = field(default_factory=set)

    def error(self, key: str, problem: str, reason: Reason | None = None) -> ProtocolError:
        """Return the error for ``key`` of this table: a SettingError where its value is a setting that the user gave."""
        found = self.values.get(key)
        name = found.get("setting") if isinstance(found, dict) else None
        if isinstance(name, str) and name in self.given:
            value = spell(self.settings[name])
            message = sentence("toml.given", name=name, label=self.source.label, value=value, problem=problem)
            return SettingError(_about(message, problem, name), reason)
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
            raise self.error(key, sentence("toml.setting", setting=name))
        chosen = self.settings[name]
        lookup = {spelled: value for spelled, value in found.items() if spelled != "setting"}
        if not lookup:
            return chosen
        listed = spell(chosen) if spell(chosen) in lookup else OTHER
        if listed not in lookup:
            raise self.error(key, sentence("toml.not_listed", setting=name, value=spell(chosen)))
        return lookup[listed]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string."""
        return self._of_kind(key, default, str, "toml.text")

    def number(self, key: str, default: float | None = None, *, low: float = -LARGEST, high: float = LARGEST) -> float:
        """Return a finite number from ``low`` to ``high``."""
        found = self.value(key, default)
        if isinstance(found, bool) or not isinstance(found, (int, float)):
            raise self.error(key, sentence("toml.number", found=_shown(found)))
        # Written so that nan is outside.
        if not low <= found <= high:
            raise self.error(key, sentence("toml.range", low=low, high=high, found=_shown(found)))
        return float(found)

    def known_number(self, key: str, *, low: float, high: float) -> float:
        """Return a number from ``low`` to ``high``, 0 where it is not known: by no key, or by a setting that is 0."""
        return 0.0 if self._is_unknown(key) else self.number(key, low=low, high=high)

    def scale(self, key: str, default: float | None = None) -> float:
        """Return a factor, which is not 0."""
        found = self.number(key, default)
        if abs(found) < LEAST_SCALE:
            raise self.error(key, sentence("toml.scale", least=LEAST_SCALE, found=_shown(found)))
        return found

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return a whole number from ``low`` to ``high``."""
        return self._integer(key, self.value(key, default), low, high)

    def integers(self, key: str, low: int, high: int, default: tuple[int, ...]) -> tuple[int, ...]:
        """Return an array of at least one whole number from ``low`` to ``high``."""
        return tuple(self._integer(key, found, low, high) for found in self.items(key, [*default]) or [None])

    def known_integer(self, key: str, *, low: int, high: int) -> int:
        """Return a whole number from ``low`` to ``high``, 0 where it is not known: by no key, or by a setting that is 0."""
        return 0 if self._is_unknown(key) else self.integer(key, low, high)

    def _integer(self, key: str, found: object, low: int, high: int) -> int:
        if isinstance(found, bool) or not isinstance(found, int) or not low <= found <= high:
            raise self.error(key, sentence("toml.integer", low=low, high=high, found=_shown(found)))
        return found

    def _is_unknown(self, key: str) -> bool:
        # What the file itself states must make sense: who does not know a number leaves its key out.
        return not self.has(key) or (isinstance(self.plain(key), dict) and self.value(key) == 0)

    def flag(self, key: str, default: bool = False) -> bool:
        """Return true or false."""
        return self._of_kind(key, default, bool, "toml.flag")

    def choice(self, key: str, allowed: Iterable[str], default: str | None = None) -> str:
        """Return one of the allowed strings."""
        found = self.value(key, default)
        options = tuple(allowed)
        if not isinstance(found, str) or found not in options:
            raise self.error(key, sentence("toml.choice", options=options, found=_shown(found), near=near(found, options)))
        return found

    def items(self, key: str, default: list[object] | None = None) -> list[object]:
        """Return an array."""
        return self._of_kind(key, default, list, "toml.items")

    def texts(self, key: str) -> tuple[str, ...]:
        """Return an array of strings, empty where the key is absent; numbers as they are written."""
        return tuple(map(str, self.items(key, [])))

    def hexadecimal(self, key: str) -> bytes:
        """Return bytes written as "0D 0A"; none where the key is absent."""
        found = self.text(key, "")
        try:
            return bytes.fromhex(found)
        except ValueError:
            raise self.error(key, sentence("toml.hexadecimal", found=_shown(found))) from None

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
            raise self.source.error((*self.path, *path), sentence("toml.table", found=_shown(found)))
        return Table(values=found, path=(*self.path, *path), source=self.source, settings=self.settings, given=self.given)

    def _of_kind(self, key: str, default: object, kind: type[_Kind], needs: str) -> _Kind:
        found = self.value(key, default)
        if not isinstance(found, kind):
            raise self.error(key, sentence(needs, found=_shown(found)))
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.finish()

    def finish(self) -> None:
        """Refuse keys that nobody took."""
        for key in self.values:
            if key not in self._known:
                raise self.error(key, sentence("toml.unknown", near=near(key, self._known)))


def near(word: object, known: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the nearest known word, or nothing."""
    import difflib  # late: only for a misspelt word

    found = difflib.get_close_matches(str(word), sorted(known), n=1)
    return f" (did you mean {found[0]!r}?)" if found else ""


def spell(value: object) -> str:
    """Return a value as one types it: true, 10, rate."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _shown(value: object) -> str:
    return "nothing" if value is None else shortened(repr(value))
