"""Settings: what the wire does not tell, declared in the protocol with a default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, cast

from imufield.acquire.protocol.toml import Source, Table, near, spell
from imufield.errors import ProtocolError, Reason, SettingError

Origin = Literal["assumed", "read", "given"]
Value = str | int | float | bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingRule:
    """What a setting may be. The type of the default is the type of the setting."""

    name: str
    default: Value
    choices: tuple[Value, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    help: str = ""

    def convert(self, given: object) -> Value:
        """Return ``given`` (a value, or text as typed on the command line) as a value of this setting.

        Raises
        ------
        ValueError
            With what is allowed, if it is of another type, out of range or not among the choices.
        """
        value = self._typed(given)
        if value is None:
            raise ValueError(self.allowed)
        if self.choices and value not in self.choices:
            raise ValueError(self.allowed)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and not self._in_range(value):
            raise ValueError(self.allowed)
        return value

    @property
    def allowed(self) -> str:
        """What may be given, in words."""
        if self.choices:
            return "one of " + ", ".join(spell(choice) for choice in self.choices)
        if isinstance(self.default, bool):
            return "true or false"
        if isinstance(self.default, str):
            return "a text"
        kind = "a whole number" if isinstance(self.default, int) else "a number"
        low = "" if self.minimum is None else f" from {self.minimum:g}"
        return kind + low + ("" if self.maximum is None else f" to {self.maximum:g}")

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
        except ValueError:
            return None
        if isinstance(self.default, float):
            return number
        return int(number) if number.is_integer() else None

    def _in_range(self, value: float) -> bool:
        low = float("-inf") if self.minimum is None else self.minimum
        high = 1e300 if self.maximum is None else self.maximum  # Infinity and NaN are no setting.
        return low <= value <= high


@dataclass(frozen=True, slots=True)
class Setting:
    """Value of a setting and where it comes from."""

    value: Value
    origin: Origin


def read_rules(table: Table) -> dict[str, SettingRule]:
    """Read ``[settings.*]`` of a protocol."""
    rules: dict[str, SettingRule] = {}
    for name in table.values:
        rules[name] = _read_rule(name, table.table(name))
    return rules


def _read_rule(name: str, table: Table) -> SettingRule:
    default = table.plain("default")
    if not isinstance(default, (str, int, float, bool)):
        raise table.error("default", "needs a default: a text, a number, or true or false")
    choices = cast("tuple[Value, ...]", tuple(table.items("choices", [])))
    rule = SettingRule(
        name=name,
        default=default,
        choices=choices,
        minimum=table.number("minimum") if table.has("minimum") else None,
        maximum=table.number("maximum") if table.has("maximum") else None,
        help=table.text("help", ""),
    )
    table.finish()
    if any(type(choice) is not type(default) for choice in choices):
        raise table.error("choices", "every choice must be of the type of the default")
    try:
        rule.convert(default)
    except ValueError as error:
        raise table.error("default", f"must itself be allowed: {error}") from None
    return rule


def choose_settings(
    rules: Mapping[str, SettingRule],
    given: Mapping[str, object],
    read: Mapping[str, object],
    source: Source,
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
            raise (SettingError if name in given else ProtocolError)(
                f"{source.label} has no setting {name!r}{near(name, rules)}; it has: {known}",
                Reason.UNKNOWN_KEY,
                name=name,
            )
    chosen: dict[str, Setting] = {}
    for name, rule in rules.items():
        origin: Origin = "given" if name in given else "read" if name in read else "assumed"
        wanted = given.get(name, read.get(name, rule.default))
        try:
            chosen[name] = Setting(rule.convert(wanted), origin)
        except ValueError as error:
            raise (SettingError if name in given else ProtocolError)(
                f"setting {name} of {source.label} is {wanted!r}, but must be {error}", name=name, value=wanted
            ) from None
    return chosen
