"""Understand the names that other programs give the columns of their tables, and choose among columns of one meaning."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import tomli

from imufield.acquire.protocol.units import TO_SI, plain_signs, unit_name
from imufield.dataclass import dataclass, replace
from imufield.errors import UsageError
from imufield.samples import TRIADS
from imufield.sentences import Sentences, shortened

sentence = Sentences(__package__)

TIME = "time"
TEMPERATURE = "temperature"
SAMPLE_TIME_FINE = "SampleTimeFine"
"""Unit of the times that instruments of Xsens send: 0.1 ms, or 1 us for the DOT."""

_WORDS = tomli.loads(Path(__file__).with_name("table_words.toml").read_text(encoding="utf-8"))
_NAMES = {quantity: frozenset(names.split()) for quantity, names in _WORDS["names"].items()}
_FIRST = frozenset(_WORDS["order"]["first"].split())
_LAST = frozenset(_WORDS["order"]["last"].split())
_STAMPS = frozenset(_WORDS["order"]["stamp"].split())
# What may end in the number of a sensor; one letter may not: "a1" is no acceleration.
_NUMBERED = _NAMES["noise"].union(name for triad in TRIADS for name in _NAMES[triad] if len(name) > 1)
_AXES = {"x": "x", "y": "y", "z": "z", "0": "x", "1": "y", "2": "z"}
_RATES = ("m/s^2", "rad/s")
_FRACTION_DIGITS = {"ns": 9, "us": 6}
# Others stand behind names, too: "Acc X (forward)", "temp (IMU)".
_LOOKS_LIKE_A_UNIT = re.compile(r"[/°˚·^*\d]|^[^\W\d_]$")
_MOST_INSTRUMENTS = 16
_MOST_WORDS = 12  # Of a name: the time that it takes grows with their square.
_MOST_PARTS = 6  # Of a path, e.g. /camera/imu/linear_acceleration/x; it bounds the time that a hostile name takes.


@dataclass(frozen=True, slots=True, kw_only=True)
class TableColumn:
    """One column that is used: where it stands, what it is, and the unit its header names (None if it names none)."""

    index: int
    field: str
    unit: str | None = None  # As it stands there if it looks like one and is not known.
    word: str = ""  # What stands in the place of a unit and does not look like one.
    qualifier: str = ""  # What tells columns of one quantity apart: a topic, "raw", the number of a sensor.
    name: str = ""  # Of the quantity, in small letters and without signs; empty where the unit tells the quantity.

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
        None if the name is not known.
    """
    parts = re.split(r"(?<=[/:])", text, maxsplit=_MOST_PARTS)
    for start in range(len(parts)):
        topic = "".join(parts[:start])
        if not _NAMES["of_others"].isdisjoint(_split(topic)):
            return None
        column = _understood("".join(parts[start:]), index, unit_below or "", "" if topic else of_axes)
        # The time or temperature of another topic is another one.
        if column is not None and (column.quantity in TRIADS or _NAMES["noise"].issuperset(_split(topic))):
            return replace(column, qualifier=topic + column.qualifier)
    return None


def _understood(text: str, index: int, unit_below: str, of_axes: str) -> TableColumn | None:
    """Return what a name without the topic before it means."""
    name, stated = _without_unit(text)
    stated = stated or unit_below
    words, qualifiers = _words_of(name)
    if len(words) > _MOST_WORDS:
        return None
    found = _field_of(words) or _axis_of(words, stated, of_axes)
    if found is None:
        return None
    field, known, tail = found
    # T is time or temperature.
    if field == TIME and unit_name(stated, TEMPERATURE):
        field = TEMPERATURE
    unit = unit_name(stated or "".join(tail), quantity_of(field))
    if field == TIME and unit is None:
        unit = SAMPLE_TIME_FINE if known == SAMPLE_TIME_FINE.lower() else unit_name(known.removeprefix(TIME), TIME)
    text = shortened(stated.strip())
    if unit is None and field != TIME and _LOOKS_LIKE_A_UNIT.search(text):
        unit = text
    return TableColumn(
        index=index, field=field, unit=unit, word="" if unit else text, qualifier=" ".join(qualifiers), name=known
    )


def _words_of(name: str) -> tuple[list[str], list[str]]:
    """Return the words that tell the quantity, and those that tell which of several columns of it this is."""
    words: list[str] = []
    qualifiers: list[str] = []
    for word in _split(name):
        # "acc1 x", "imu0 gyro x", "shimmer 8665 accel x".
        numbered = re.fullmatch(r"([a-z]*)(\d+)", word)
        is_numbered = numbered is not None and (numbered[1] in _NUMBERED or not (numbered[1] or words))
        known, number = numbered.groups() if numbered is not None and is_numbered else (word, "")
        qualifiers += [number] if number else []
        if known in _NAMES["qualifier"]:
            qualifiers.append(known)
        elif known and known not in _NAMES["noise"]:
            words.append(known)
    return words, qualifiers


def _without_unit(text: str) -> tuple[str, str]:
    """Return a name without its unit in brackets, and that; an axis may be in brackets, too."""
    # From the first bracket on, and from no other: a heading of brackets alone would take hours.
    bracket = re.match(r"([^\[(]*+)[\[(]([^\])]*+)[\])]", text)
    if bracket is None:
        return text, ""
    before, inside, behind = bracket[1], bracket[2].strip().lower(), text[bracket.end() :]
    if inside in _AXES and re.match(r"\s*+(?:$|[\[(])", behind):
        unit = re.match(r"\s*+[\[(]([^\])]*+)[\])]", behind)
        # A number may be that of anything, so that a name with a letter is rather an axis.
        return f"{before} {_AXES[inside]}{' index' if inside.isdigit() else ''}", unit[1] if unit else ""
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
    if name in _NAMES[TIME] | _NAMES["other_time"]:
        return TIME, name
    if name in _NAMES[TEMPERATURE]:
        return TEMPERATURE, name
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
    # Increments are no output that is told by its unit: angles and velocities have the same.
    quantities = [quantity for quantity in TRIADS if TO_SI.get(unit_name(stated, quantity) or "", ("",))[0] in _RATES]
    quantities = quantities if stated else [of_axes]
    if len(quantities) != 1 or quantities[0] not in TRIADS:
        return None
    return TRIADS[quantities[0]]["xyz".index(words[0])], "", ()


def quantity_of_file(path: Path) -> str:
    """Return the quantity that the name of a file tells, e.g. ``Gyroscope.csv``; empty where it tells none or two."""
    words = _split(path.name.split(".")[0])
    pairs = map("".join, pairwise(words))
    told = {quantity for name in (*words, *pairs) for quantity in TRIADS if name in _NAMES["file"] & _NAMES[quantity]}
    return told.pop() if len(told) == 1 else ""


def columns_that_repeat(rows: Sequence[Sequence[str]], width: int, whole: TableColumn | None) -> set[int]:
    """Return which columns have the same, or nothing, in some of these rows; ``whole`` has its fraction in the next one."""

    def cell(row: Sequence[str], column: int) -> str:
        return " ".join(row[column : column + 2]) if whole is not None and column == whole.index else row[column].lower()

    cells = [[cell(row, column) for row in rows if column < len(row)] for column in range(width)]
    return {column for column, found in enumerate(cells) if len({*found, "", "nan"}) < len(found) + 2}


def time_in_parts(
    columns: Sequence[TableColumn | None], rows: Sequence[Sequence[str]]
) -> tuple[TableColumn, TableColumn] | None:
    """Return the column of whole seconds and that of their fraction, as ROS writes its stamps; None where there are none."""
    for whole, part in pairwise(columns):
        if whole is None or part is None or part.unit not in _FRACTION_DIGITS or (whole.field, whole.unit) != (TIME, "s"):
            continue
        digits = _FRACTION_DIGITS[part.unit]
        pairs = [[row[each].removesuffix(".0") for each in (whole.index, part.index)] for row in rows if part.index < len(row)]
        are_parts = all(seconds.isdecimal() and rest.isdecimal() and len(rest) <= digits for seconds, rest in pairs)
        if are_parts and (part.field, part.name, part.qualifier) == (TIME, whole.name, whole.qualifier):
            return whole, part
    return None


def stamp_of_measurement(columns: Sequence[TableColumn], no_clocks: Collection[int]) -> TableColumn | None:
    """Return the time at which samples were measured, if one column has it alone."""
    found = [column for column in columns if column.name in _STAMPS and column.index not in no_clocks]
    return found[0] if len(found) == 1 else None


def one_of_each(
    columns: Sequence[TableColumn], header: Sequence[str], text_columns: Collection[int], no_clocks: Collection[int]
) -> list[TableColumn]:
    """Return one column for time and temperature, and one triad of each quantity, in the order of the file.

    Parameters
    ----------
    columns : sequence of TableColumn
    header : sequence of str
    text_columns : collection of int
        Those that hold no numbers, e.g. dates.
    no_clocks : collection of int
        Those that repeat a value or have gaps.
    """
    columns = _without_quaternions(columns, header)
    # Axes without a name are those of the file's sensor where it has no others.
    named = [column for column in columns if column.quantity not in TRIADS or column.name or column.unit]
    columns = named if any(column.quantity in TRIADS for column in named) else columns
    chosen = [*_time_and_temperature(columns, header, text_columns, no_clocks), *_triads(columns)]
    return sorted(chosen, key=lambda column: column.index)


def _without_quaternions(columns: Sequence[TableColumn], header: Sequence[str]) -> list[TableColumn]:
    """Leave out x, y and z, or 0, 1 and 2, where there is a fourth of the same name."""
    words = [_split(name) for name in header]
    of_four = {tuple(each[:-1]) for each in words if each[-1:] in (["w"], ["3"])}
    axes = {*"xyz012"}
    return [
        column
        for column in columns
        if not (words[column.index][-1:] and words[column.index][-1] in axes and tuple(words[column.index][:-1]) in of_four)
    ]


def _time_and_temperature(
    columns: Sequence[TableColumn], header: Sequence[str], text_columns: Collection[int], no_clocks: Collection[int]
) -> list[TableColumn]:
    """Return one of each: what goes on, a number before a date, the stamp of measurement, a usual name, then the first."""
    stamp = stamp_of_measurement(columns, no_clocks)
    # "T" beside another time is the temperature.
    is_letter = {column.index: header[column.index].strip() == "T" for column in columns if column.field == TIME}
    times = sorted(
        (column for column in columns if column.field == TIME),
        key=lambda column: (
            column.index in no_clocks,
            column.index in text_columns,
            column is not stamp,
            is_letter[column.index] or column.name not in _NAMES[TIME] or bool(column.qualifier),
        ),
    )
    temperatures = sorted((column for column in columns if column.field == TEMPERATURE), key=lambda each: bool(each.qualifier))
    temperatures += [replace(column, field=TEMPERATURE) for column in times[1:] if is_letter[column.index]]
    return times[:1] + temperatures[:1]


def _triads(columns: Sequence[TableColumn]) -> list[TableColumn]:
    """Return one triad of each quantity: both of one source where it has them, and plain names before others."""
    triads: dict[str, dict[tuple[str, str], list[TableColumn]]] = {quantity: {} for quantity in TRIADS}
    for column in columns:
        if column.quantity in TRIADS:
            triads[column.quantity].setdefault((column.qualifier, column.name), []).append(column)
    whole = {
        quantity: [key for key, triad in of.items() if len({column.field for column in triad}) == len(triad) == len("xyz")]
        for quantity, of in triads.items()
    }
    sources = [{qualifier for qualifier, _ in keys} for keys in whole.values()]
    both = set.intersection(*sources)
    chosen: list[TableColumn] = []
    for quantity, keys in whole.items():
        best = min(keys, key=lambda key: (bool(both) and key[0] not in both, _rank(*key)), default=None)
        both = both if best is None or best[0] not in both else {best[0]}
        of = triads[quantity]
        # Axes that go by several names, or do not make a triad, are looked at later.
        chosen += of[best] if best else [column for triad in of.values() for column in triad]
    return chosen


def _rank(qualifier: str, name: str) -> int:
    """Return a smaller number for what is rather taken."""
    if qualifier or not name:
        return 3
    return 0 if name in _FIRST else 1 + (name in _LAST)


def refuse_several_instruments(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Raise ``UsageError`` where a column names the instrument of each row, and there are several."""
    for index, name in enumerate(header):
        if "".join(_split(name)) in _NAMES["instrument"]:
            named = [row[index] for row in rows if index < len(row) and row[index]]
            found = sorted(set(named))
            changes = sum(before != after for before, after in pairwise(named))
            # Instruments take turns; positions and labels last, counters go on, and measured numbers are no names.
            if 1 < len(found) <= _MOST_INSTRUMENTS and 4 * changes > len(rows) and not any("." in each for each in found):
                told = {"name": shortened(name), "found": [*map(shortened, found[:4])]}
                raise UsageError(sentence("table_names.several_instruments", path=str(path), **told))
