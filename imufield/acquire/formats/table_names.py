"""Understand the names that other programs give the columns of their tables, and choose among columns of one meaning."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path

import tomli

from imufield.acquire.protocol.units import plain_signs, unit_name
from imufield.dataclass import dataclass, replace
from imufield.errors import UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

TIME = "time"
TEMPERATURE = "temperature"
SAMPLE_TIME_FINE = "SampleTimeFine"
"""Unit of the times that instruments of Xsens send: 0.1 ms, or 1 us for the DOT."""
TRIADS = {"accelerometer": ACCELEROMETER_COLUMNS, "gyroscope": GYROSCOPE_COLUMNS}

_WORDS = tomli.loads(Path(__file__).with_name("table_words.toml").read_text(encoding="utf-8"))
_NAMES = {quantity: frozenset(names.split()) for quantity, names in _WORDS["names"].items()}
_FIRST, _LAST = (frozenset(_WORDS["order"][place].split()) for place in ("first", "last"))
_NUMBERED = _NAMES["noise"].union(name for triad in TRIADS for name in _NAMES[triad] if len(name) > 1)
_AXES = {"x": "x", "y": "y", "z": "z", "0": "x", "1": "y", "2": "z"}
# Others stand behind names, too: "Acc X (forward)", "temp (IMU)".
_LOOKS_LIKE_A_UNIT = re.compile(r"[/°˚·^*\d]|^[^\W\d_]$")
_MOST_PARTS = 6  # Of a name that is a path, e.g. /camera/imu/linear_acceleration/x.


@dataclass(frozen=True, slots=True)
class TableColumn:
    """One column that is used: where it stands, what it is, and the unit its header names (None if it names none)."""

    index: int
    field: str
    unit: str | None = None  # As it stands there if it looks like one and is not known.
    word: str = ""  # What stands in the place of a unit and does not look like one.
    source: str = ""  # What its name says beside the quantity: a topic, "raw", the number of a sensor.
    name: str = ""  # Of the quantity, as it stands there.

    @property
    def quantity(self) -> str:
        """``time``, ``accelerometer``, ``gyroscope``, ``temperature``, ``status`` or ``counter``."""
        return quantity_of(self.field)


def quantity_of(field: str) -> str:
    """Return what a field measures."""
    return next((quantity for quantity, triad in TRIADS.items() if field in triad), field)


def named_column(text: str, index: int, unit_below: str | None = None, of_axes: str = "") -> TableColumn | None:
    """Understand one column name such as ``Acc X (m/s^2)``, ``gyro_z_dps``, ``/imu/linear_acceleration/x`` or ``time_ms``.

    Parameters
    ----------
    text : str
    index : int
    unit_below : str, optional
        What a line of units has for it.
    of_axes : str, optional
        What columns measure whose names are ``x``, ``y`` and ``z`` and have no unit: ``accelerometer`` or ``gyroscope``.

    Returns
    -------
    TableColumn or None
        None for a name that is none of ours.
    """
    parts = re.split(r"(?<=[/:])", text, maxsplit=_MOST_PARTS)
    for start in range(len(parts)):
        column = _understood("".join(parts[start:]), index, unit_below or "", of_axes)
        if column is not None:
            return replace(column, source="".join(parts[:start]) + column.source)
    return None


def _understood(text: str, index: int, unit_below: str, of_axes: str) -> TableColumn | None:
    name, stated = _without_unit(text)
    stated = stated or unit_below
    words: list[str] = []
    source: list[str] = []
    for word in _split(name):
        # "acc1 x", "imu0 gyro x", "shimmer 8665 accel x".
        numbered = re.fullmatch(r"([a-z]*)(\d+)", word)
        if numbered and (numbered[1] in _NUMBERED or not (numbered[1] or words)):
            known, number = numbered.groups()
            source.append(number)
        else:
            known = word
        if known in _NAMES["source"]:
            source.append(known)
        elif known and known not in _NAMES["noise"]:
            words.append(known)
    found = _field_of(words) or _axis_of(words, stated, of_axes)
    if found is None:
        return None
    field, known, tail = found
    # T is time or temperature.
    if field == TIME and unit_name(stated, TEMPERATURE):
        field = TEMPERATURE
    unit = unit_name(stated or "".join(tail), quantity_of(field))
    if field == TIME and unit is None:
        unit = SAMPLE_TIME_FINE if known == SAMPLE_TIME_FINE.lower() else unit_name(known, TIME)
    text = shortened(stated.strip())
    if unit is None and field != TIME and _LOOKS_LIKE_A_UNIT.search(text):
        unit = text
    return TableColumn(index, field, unit, "" if unit else text, " ".join(source), known)


def _without_unit(text: str) -> tuple[str, str]:
    """Return a name without its unit in brackets, and that; an axis may be in brackets, too."""
    # From the first bracket on, and from no other: a heading of brackets alone would take hours.
    bracket = re.match(r"([^\[(]*+)[\[(]([^\])]*+)[\])]", text)
    if bracket is None:
        return text, ""
    before, inside, behind = bracket[1], bracket[2].strip().lower(), text[bracket.end() :]
    if inside in _AXES and re.match(r"\s*+(?:$|[\[(])", behind):
        unit = re.match(r"\s*+[\[(]([^\])]*+)[\])]", behind)
        return f"{before} {_AXES[inside]}", unit[1] if unit else ""
    return before + behind, bracket[2]


def _split(text: str) -> list[str]:
    """Split at anything but letters and digits, and between small and capital letters."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", plain_signs(text))
    return [word for word in re.split(r"[^0-9a-z°µ]+", parted.lower()) if word]


def _field_of(words: Sequence[str]) -> tuple[str, str, Sequence[str]] | None:
    """Find the field, its name, and the words behind it, which may be a unit: "time s" is a time in seconds, not "times"."""
    field, name = _field_of_name("".join(words))
    # "gyro rad" is a name of its own.
    if quantity_of(field) in TRIADS:
        return field, name, ()
    # The shortest name first: what follows it may be a unit.
    for end in range(1, len(words) + 1):
        field, name = _field_of_name("".join(words[:end]))
        tail = words[end:]
        if field and (not tail or unit_name("".join(tail), quantity_of(field))):
            return field, name, tail
    return None


def _field_of_name(name: str) -> tuple[str, str]:
    for field in (TIME, TEMPERATURE):
        if name in _NAMES[field]:
            return field, name
    # Both "acc x" and "x acc" are in use.
    for axis, rest in ((name[-1:], name[:-1]), (name[:1], name[1:])):
        for quantity, triad in TRIADS.items():
            if axis in ("x", "y", "z") and rest in _NAMES[quantity]:
                return triad["xyz".index(axis)], rest
    return "", ""


def _axis_of(words: Sequence[str], stated: str, of_axes: str) -> tuple[str, str, Sequence[str]] | None:
    """Find the field of a name that is an axis alone, by its unit."""
    if len(words) != 1 or words[0] not in ("x", "y", "z"):
        return None
    quantities = [quantity for quantity in TRIADS if unit_name(stated, quantity)] or [of_axes]
    if len(quantities) != 1 or quantities[0] not in TRIADS:
        return None
    return TRIADS[quantities[0]]["xyz".index(words[0])], "", ()


def quantity_of_file(path: Path) -> str:
    """Return the quantity that the name of a file tells, e.g. ``Gyroscope.csv``; empty where it tells none or two."""
    words = _split(path.name.split(".")[0])
    parts = {"".join(words[start:end]) for start in range(len(words)) for end in range(start + 1, len(words) + 1)}
    # One letter is no name here.
    told = [quantity for quantity in TRIADS if any(len(name) > 1 and name in _NAMES[quantity] for name in parts)]
    return told[0] if len(told) == 1 else ""


def one_of_each(columns: Sequence[TableColumn], header: Sequence[str], texts: Collection[int]) -> list[TableColumn]:
    """Return one column of each meaning: raw outputs before computed ones, numbers before text, then the first.

    Parameters
    ----------
    columns : sequence of TableColumn
    header : sequence of str
    texts : collection of int
        The columns that hold no numbers.
    """
    # Four of them are a quaternion.
    of_four = {tuple(_split(name)[:-1]) for name in header if _split(name)[-1:] == ["w"]}
    columns = [column for column in columns if tuple(_split(header[column.index])[:-1]) not in of_four]
    times = sorted((column for column in columns if column.field == TIME), key=lambda column: column.index in texts)
    kelvins = [column for column in columns if column.field == TEMPERATURE]
    # Beside a time it is the other thing the letter stands for.
    kelvins += [
        replace(column, field=TEMPERATURE) for column in times[1:] if header[column.index].strip() == "T" and not kelvins
    ]
    chosen = times[:1] + kelvins[:1] + [column for column in columns if column.quantity not in (TIME, TEMPERATURE, *TRIADS)]
    source = None
    for quantity in TRIADS:
        triads: dict[tuple[str, str], list[TableColumn]] = {}
        for column in columns:
            if column.quantity == quantity:
                triads.setdefault((column.source, column.name), []).append(column)
        whole = [key for key, triad in triads.items() if len({column.field for column in triad}) == len(triad) == len("xyz")]
        # Axes that go by several names, or do not make a triad, are looked at later.
        best = min(whole, key=lambda key: (source not in (None, key[0]), _rank(key)), default=None)
        chosen += triads[best] if best else [column for triad in triads.values() for column in triad]
        source = best[0] if best else None
    return sorted(chosen, key=lambda column: column.index)


def _rank(key: tuple[str, str]) -> int:
    source, name = key
    is_first = name in _FIRST or not _FIRST.isdisjoint(_split(source))
    return 0 if is_first else 1 + (name in _LAST)


def refuse_several_instruments(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Raise ``UsageError`` where a column says that rows are in turns of several instruments."""
    for index, name in enumerate(header):
        if "".join(_split(name)) in _NAMES["instrument"]:
            found = sorted({row[index] for row in rows if index < len(row)})
            # A number of its own for each row is none of an instrument.
            if 1 < len(found) < len(rows) / 2:
                told = {"name": shortened(name), "found": [*map(shortened, found[:4])]}
                raise UsageError(sentence("table_names.several_instruments", path=str(path), **told))
