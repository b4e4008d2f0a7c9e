"""Units of what instruments send, and what each is in SI."""

from __future__ import annotations

import re
from pathlib import Path

import tomli

_TABLES = tomli.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
TO_SI: dict[str, tuple[str, float]] = {name: (si, factor) for name, (si, factor) in _TABLES["to_si"].items()}
"""Units a protocol may name: what a sample holds, and by what the number is multiplied."""
UNITS_OF: dict[str, tuple[str, ...]] = {part: tuple(units) for part, units in _TABLES["units_of"].items()}
"""What each part of a sample may be in; the first where nothing else is known."""
_SPELLED: dict[str, str] = {text: name for name, texts in _TABLES["spellings"].items() for text in texts}
_SPELLED |= {name.lower(): name for name in TO_SI}
SI_UNITS = ("m/s^2", "m/s", "rad/s", "rad")


def nominal_scale(unit: str) -> float | None:
    """Return the scale of an instrument that sends this unit and is perfect; None where only the maker knows it."""
    si, factor = TO_SI.get(unit, ("", 1.0))
    return 1 / factor if si in SI_UNITS else None


def unit_name(text: str) -> str | None:
    """Return our name of a unit as DBC files write it; None where it is not known."""
    return _SPELLED.get(re.sub(r"\s+", " ", text.strip().lower()).replace("[", "").replace("]", ""))
