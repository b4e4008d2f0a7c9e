"""Settings: what the wire does not tell, declared in the protocol with a default."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, cast

from imufield.acquire.protocol.toml import LARGEST, Source, Table, near, spell
from imufield.dataclass import dataclass
from imufield.errors import ProtocolError, Reason, SettingError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Origin = Literal["assumed", "read", "given"]
Value = str | int | float | bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingRule:
    """What a setting may be. The type of the default is the type of the setting."""

    name: str
    default: Value
    choices: tuple[Value, ...] = ()
    minimum: float = -LARGEST
    maximum: float = LARGEST
    help: str = ""

    def convert(self, given: object) -> Value:
        """Return ``given`` (a value, or text as typed on the command line) as a value of this setting.

        Raises
        ------
        ValueError
            With what is allowed, if it is of another type, out of range or not among the choices.
        """
        value = self._typed(given)
        in_range = not isinstance(value, (int, float)) or self.minimum <= value <= self.maximum
        if value is None or not in_range or (self.choices and value not in self.choices):
            raise ValueError(self.allowed)
        return value

    @property
    def allowed(self) -> str:
        """What may be given, in words."""
        if self.choices:
            return sentence("settings.choices", choices=[spell(choice) for choice in self.choices])
        words = {bool: "true or false", str: "a text", int: "a whole number", float: "a number"}[type(self.default)]
        low = "" if self.minimum == -LARGEST else f" from {self.minimum:g}"
        return words + low + ("" if self.maximum == LARGEST else f" to {self.maximum:g}")

    def _typed(self, given: object) -> Value | None:
        if isinstance(self.default, str):
            return given if isinstance(given, str) else None
        if isinstance(self.default, bool):
            return {"true": True, "false": False}.get(str(given).strip().lower())
        # True is the number 1 in Python, but no number that a person means.
        if isinstance(given, bool) or not isinstance(given, (int, float, str)):
            return None
        try:
            number = float(given)
        except (ValueError, OverflowError):
            return None
        if isinstance(self.default, float):
            return number
        return int(number) if number.is_integer() else None


@dataclass(frozen=True, slots=True)
class Setting:
    """Value of a setting and where it comes from."""

    value: Value
    origin: Origin


def read_rules(table: Table) -> dict[str, SettingRule]:
    """Read ``[settings.*]`` of a protocol."""
    return {name: _read_rule(name, table.table(name)) for name in table.values}


def _read_rule(name: str, table: Table) -> SettingRule:
    with table:
        default = table.plain("default")
        if not isinstance(default, (str, int, float, bool)):
            raise table.error("default", sentence("settings.no_default"))
        choices = cast("tuple[Value, ...]", tuple(table.items("choices", [])))
        low = table.number("minimum", -LARGEST)
        high = table.number("maximum", LARGEST, low=low)
        rule = SettingRule(name=name, default=default, choices=choices, minimum=low, maximum=high, help=table.text("help", ""))
    if any(type(choice) is not type(default) for choice in choices):
        raise table.error("choices", sentence("settings.mixed_choices"))
    try:
        rule.convert(default)
    except ValueError as error:
        raise table.error("default", sentence("settings.default", allowed=error)) from None
    return rule


def with_origin(settings: Mapping[str, Setting], origin: Origin) -> dict[str, Value]:
    """Return the values of the settings that come from there, by name."""
    return {name: setting.value for name, setting in settings.items() if setting.origin == origin}


def choose_settings(
    rules: Mapping[str, SettingRule], given: Mapping[str, object], read: Mapping[str, object], source: Source
) -> dict[str, Setting]:
    """Return every setting: as given, else as read from the instrument, else its default.

    Raises
    ------
    SettingError, ProtocolError
        If a setting is not known, or a value is not allowed: one that was given, or that was read.
    """
    for name in (*given, *read):
        if name not in rules:
            known = ", ".join(rules) or "none"
            unknown = sentence("settings.unknown", label=source.label, name=name, near=near(name, rules), known=known)
            raise (SettingError if name in given else ProtocolError)(unknown, Reason.UNKNOWN_KEY)
    chosen: dict[str, Setting] = {}
    for name, rule in rules.items():
        origin: Origin = "given" if name in given else "read" if name in read else "assumed"
        value = given.get(name, read.get(name, rule.default))
        try:
            chosen[name] = Setting(rule.convert(value), origin)
        except ValueError as error:
            key = "settings.value" if origin == "given" else "settings.read"
            refused = sentence(key, name=name, label=source.label, value=value, allowed=error)
            raise (SettingError if name in given else ProtocolError)(refused) from None
    return chosen
