"""Units of what instruments send, and what each is in SI."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import tomli

_TABLES = tomli.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
TO_SI: dict[str, tuple[str, float]] = {name: (si, factor) for name, (si, factor) in _TABLES["to_si"].items()}
"""Units a protocol may name: what a sample holds, and by what the number is multiplied."""
UNITS_OF: dict[str, tuple[str, ...]] = {part: tuple(units) for part, units in _TABLES["units_of"].items()}
"""What each part of a sample may be in; the first where nothing else is known."""
TO_DEGC: dict[str, tuple[float, float]] = {name: (factor, offset) for name, (factor, offset) in _TABLES["to_degc"].items()}
"""Units of temperature: value * factor + offset is in degC."""
SECONDS: dict[str, float] = _TABLES["seconds"]
"""Seconds in a unit of time."""
SI_UNITS = ("m/s^2", "m/s", "rad/s", "rad")
_ALIKE = str.maketrans({"²": "2", "¹": "1", "⁻": "-", "º": "°", "˚": "°", "℃": "°C", "℉": "°F", "μ": "µ"})


def plain_signs(text: str) -> str:
    """Return a text with one sign for those that look alike."""
    return text.translate(_ALIKE)


def _plain(text: str) -> str:
    """Return a spelling without capitals, blanks and signs, and with one word for the second."""
    return re.sub(r"(?<=/)sec(ond)?s?(?=2|$)", "s", re.sub(r"[\s^.*·()\[\]-]", "", plain_signs(text).lower()))


_KNOWN: dict[str, Iterable[str]] = {
    **{quantity: [name for name, (si, _) in TO_SI.items() if si in units] for quantity, units in UNITS_OF.items()},
    "temperature": TO_DEGC,
    "time": SECONDS,
}
_SPELLED = {
    # Without its star a product reads as a plural, g.
    quantity: {_plain(name): name for name in _KNOWN[quantity] if "*" not in name}
    | {text: name for name, texts in spellings.items() for text in texts.split()}
    for quantity, spellings in _TABLES["spellings"].items()
}


def nominal_scale(unit: str) -> float | None:
    """Return the scale of an instrument that sends this unit and is perfect; None where only the maker knows it."""
    si, factor = TO_SI.get(unit, ("", 1.0))
    return 1 / factor if si in SI_UNITS else None


def unit_name(text: str, quantity: str) -> str | None:
    """Return our name of a unit as DBC files and tables write it; None where the quantity has none of that name.

    Parameters
    ----------
    text : str
    quantity : str
        ``accelerometer``, ``gyroscope``, ``temperature`` or ``time``.
    """
    return text if text in _KNOWN[quantity] else _SPELLED[quantity].get(_plain(text))


def known_units(quantity: str) -> list[str]:
    """Return our names of the units of a quantity."""
    return list(_KNOWN[quantity])
