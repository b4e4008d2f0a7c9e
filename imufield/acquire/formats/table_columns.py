"""Find what the columns of a table mean: by their header, by the names the user gives, or by their number.

Every assumption that the header does not state is returned as a sentence.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from imufield.errors import UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, SAMPLE_COLUMNS
from imufield.sentences import shortened

TIME = "time"
TEMPERATURE = "temperature"
FIELDS = (TIME, *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS, TEMPERATURE)
"""The columns of a row of protocol ``rows_f64``, in its order."""
STATUS = "status"
"""Flags of imufield itself, beside the other columns; known in exports of its own only, since others' mean other things."""
COUNTER = "counter"
"""What the instrument numbered its samples by; known in exports of our own only, whose flags tell of every gap."""
SKIPPED = ("-", "_", "skip")


def _spellings(**names: str) -> dict[str, str]:
    """Return spelling -> unit; units that are no Python names are given as keys with words for their signs."""
    signs = {"m_s2": "m/s^2", "m_s": "m/s", "rad_s": "rad/s", "deg_s": "deg/s"}
    return {spelling: signs.get(unit, unit) for unit, spellings in names.items() for spelling in spellings.split()}


def _names(spellings: str) -> frozenset[str]:
    return frozenset(spellings.split())


# Spellings are compared in small letters without blanks, hats, stars, dots and minus signs.
_RAW_UNITS = _spellings(count="count counts lsb raw adc", pulse="pulse pulses")
_TIME_UNITS = _spellings(
    s="s sec secs second seconds", ms="ms msec millis", us="us µs usec micros", ns="ns nsec nanos nanosec nanoseconds"
)
_ACCELEROMETER_UNITS = _spellings(m_s2="m/s2 m/s/s ms2 mps2 mss", m_s="m/s ms", g="g", mg="mg")
_GYROSCOPE_UNITS = _spellings(rad_s="rad/s rads radps rps", deg_s="deg/s °/s dps degps degs", rad="rad", deg="deg")
_TEMPERATURE_UNITS = _spellings(degC="degc °c c celsius")

UNITS_OF = {
    TIME: _TIME_UNITS,
    "accelerometer": _ACCELEROMETER_UNITS | _RAW_UNITS,
    "gyroscope": _GYROSCOPE_UNITS | _RAW_UNITS,
    TEMPERATURE: _TEMPERATURE_UNITS,
}

_TIME_NAMES = _names("t time timestamp ts stamp epoch unixtime elapsed elapsedtime systemtime")
_TEMPERATURE_NAMES = _names("temp temperature")
_ACCELEROMETER_NAMES = _names("a acc accel accelerometer acceleration linearacceleration specificforce f")
_GYROSCOPE_NAMES = _names("g w gyr gyro gyroscope omega rate rot angularrate angularvelocity angvel turnrate")
_NOISE_WORDS = _names("imu sensor data field msg calibrated")  # They say nothing of which quantity it is.
_HEADERLESS = {
    3: ACCELEROMETER_COLUMNS,
    6: (*ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS),
    7: (TIME, *ACCELEROMETER_COLUMNS, *GYROSCOPE_COLUMNS),
    8: FIELDS,
}


@dataclass(frozen=True, slots=True)
class TableColumn:
    """One column that is used: where it stands, what it is, and the unit its header names (None if it names none)."""

    index: int
    field: str
    unit: str | None = None

    @property
    def quantity(self) -> str:
        """``time``, ``accelerometer``, ``gyroscope``, ``temperature``, ``status`` or ``counter``."""
        return quantity_of(self.field)


@dataclass(frozen=True, slots=True)
class Meaning:
    """The used columns of one file, and what was assumed about them, in sentences.

    Attributes
    ----------
    columns : tuple of TableColumn
    units : dict
        The stated unit of each quantity, where there is one.
    assumptions : tuple of str
    is_guess : bool
        Nothing but the number of columns tells what they are.
    """

    columns: tuple[TableColumn, ...]
    units: dict[str, str]
    assumptions: tuple[str, ...] = ()
    is_guess: bool = False

    @property
    def places(self) -> list[int]:
        """Where the columns stand in the file."""
        return [column.index for column in self.columns]


def quantity_of(field: str) -> str:
    """Return what a field measures."""
    if field in ACCELEROMETER_COLUMNS:
        return "accelerometer"
    return "gyroscope" if field in GYROSCOPE_COLUMNS else field


def named_column(text: str, index: int, unit_below: str | None = None) -> TableColumn | None:
    """Understand one column name such as ``Acc X (m/s^2)``, ``gyro_z_dps``, ``linear_acceleration.x`` or ``time_ms``.

    Returns
    -------
    TableColumn or None
        None for a name that is none of ours.
    """
    bracket = re.search(r"[\[(]([^\])]*)[\])]", text)
    words = _words(text[: bracket.start()] + text[bracket.end() :] if bracket else text)
    stated = bracket.group(1) if bracket else unit_below
    field, tail = _field_of(words)
    if field is None:
        return None
    return TableColumn(index, field, UNITS_OF[quantity_of(field)].get(_spelling(stated or "".join(tail))))


def _spelling(unit: str) -> str:
    return re.sub(r"[\s^*.()\[\]-]", "", unit.lower().replace("²", "2"))


def _words(text: str) -> list[str]:
    """Split at anything but letters and digits, and between small and capital letters."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [word for word in re.split(r"[^0-9a-z°µ]+", parted.lower()) if word and word not in _NOISE_WORDS]


def _field_of(words: Sequence[str]) -> tuple[str | None, Sequence[str]]:
    """Find the field, and the words behind it, which may be a unit: "time s" is a time in seconds and not "times"."""
    # The shortest name first: what follows it may be a unit.
    for end in range(1, len(words) + 1):
        field = _field_of_name("".join(words[:end]))
        tail = words[end:]
        if field is not None and (not tail or "".join(tail) in UNITS_OF[quantity_of(field)]):
            return field, tail
    return None, ()


def _field_of_name(name: str) -> str | None:
    if name in _TIME_NAMES:
        return TIME
    if name in _TEMPERATURE_NAMES:
        return TEMPERATURE
    # Both "acc x" and "x acc" are in use.
    for axis, rest in ((name[-1:], name[:-1]), (name[:1], name[1:])):
        if axis in ("x", "y", "z"):
            if rest in _ACCELEROMETER_NAMES:
                return f"a{axis}"
            if rest in _GYROSCOPE_NAMES:
                return f"g{axis}"
    return None


def columns_by_user(path: Path, columns: str, width: int) -> Meaning:
    """Take the user's word, e.g. ``time,ax,ay,az,gx,gy,gz,temperature``; ``-`` skips a column.

    Raises
    ------
    UsageError
        A name is unknown or used twice, or there are not as many names as columns.
    """
    names = [name.strip() for name in columns.split(",")]
    if len(names) != width:
        raise UsageError(
            f"--columns names {len(names)} columns, {path} has {width}: name each, `-` skips one.", path=str(path), width=width
        )
    found = []
    for index, name in enumerate(names):
        if name in SKIPPED:
            continue
        column = named_column(name, index)
        if column is None:
            raise UsageError(f"--columns names {name!r}: use {', '.join(FIELDS)}, or `-` to skip a column.", name=name)
        found.append(column)
    return _checked(path, found, ())


def columns_by_header(path: Path, header: Sequence[str], units: Sequence[str] | None) -> Meaning:
    """Understand a header line.

    Raises
    ------
    UsageError
        No accelerometer or gyroscope triad is found, or two columns mean the same.
    """
    below = units if units is not None and len(units) == len(header) else [None] * len(header)
    named = [named_column(name, index, unit) for index, (name, unit) in enumerate(zip(header, below, strict=True))]
    # Only an export of our own has all of these; columns of these names mean other things elsewhere.
    if set(SAMPLE_COLUMNS) <= set(header):
        for name in (STATUS, COUNTER):
            named[header.index(name)] = TableColumn(header.index(name), name)
    ignored = ", ".join(shortened(name) for name, column in zip(header, named, strict=True) if column is None and name)
    said = (f"{path.name}: ignored the columns {ignored}.",) if ignored else ()
    return _checked(path, [column for column in named if column is not None], said)


def columns_by_count(path: Path, width: int, number: int, files: int) -> Meaning:
    """Assume the usual order of a file without header; ``number`` is its place among ``files``, from 0.

    Raises
    ------
    UsageError
        That many columns have no usual order.
    """
    # Programs that write a file for each sensor write the accelerometer first.
    triad = (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS)[min(number, 1)]
    if number > 1:
        raise UsageError(f"{path} has no header and is file {number + 1}: name its columns with --columns.", path=str(path))
    if width == 4:
        fields: Sequence[str] | None = (TIME, *triad)
    elif width == 3 and files > 1:
        fields = triad
    else:
        fields = _HEADERLESS.get(width) if number == 0 else None
    if fields is None:
        raise UsageError(
            f"{path} has no header and {width} columns of unknown meaning: name them, e.g. --columns {','.join(FIELDS)}.",
            path=str(path),
            width=width,
        )
    said = f"{path.name}: no header, its {width} columns are taken as {', '.join(fields)}."
    return Meaning(tuple(TableColumn(index, field) for index, field in enumerate(fields)), {}, (said,), is_guess=True)


def _checked(path: Path, found: Sequence[TableColumn], assumptions: tuple[str, ...]) -> Meaning:
    """Refuse doubled columns and incomplete triads."""
    fields = [column.field for column in found]
    doubled = next((field for field in fields if fields.count(field) > 1), None)
    if doubled is not None:
        raise UsageError(
            f"{path} has two columns that mean {doubled}: say which with --columns.", path=str(path), field=doubled
        )
    for triad in (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS):
        missing = [field for field in triad if field not in fields]
        if 0 < len(missing) < 3:
            raise UsageError(
                f"{path} has no column for {', '.join(missing)}: name the columns with --columns.",
                path=str(path),
                missing=missing,
            )
    if not set(fields) - {TIME, TEMPERATURE, STATUS, COUNTER}:
        raise UsageError(
            f"no column of {path} is known as accelerometer or gyroscope: name them with --columns {','.join(FIELDS)}.",
            path=str(path),
        )
    units: dict[str, str] = {}
    for column in found:
        before = units.setdefault(column.quantity, column.unit) if column.unit is not None else None
        if before != column.unit:
            raise UsageError(
                f"{path} gives {column.quantity} in {before} and in {column.unit}: bring all its axes to one unit.",
                path=str(path),
            )
    return Meaning(tuple(found), units, assumptions)
