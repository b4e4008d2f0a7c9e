"""One file of a table: opened by what it starts with, its columns named and checked."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.formats.ros_bags import is_bag, read_bag
from imufield.acquire.formats.table_arrays import ArrayTable, array_kind, read_arrays
from imufield.acquire.formats.table_columns import (
    COUNTER,
    FIELDS,
    FRACTION,
    STATUS,
    Meaning,
    columns_by_count,
    columns_by_header,
    columns_by_user,
    in_degc,
    median_step,
)
from imufield.acquire.formats.table_names import TEMPERATURE, TIME, refuse_several_instruments
from imufield.acquire.formats.table_text import ROWS_LOOKED_AT, TextTable, open_table
from imufield.acquire.protocol.units import SECONDS
from imufield.dataclass import dataclass, field, replace
from imufield.errors import Reason, RecordingError
from imufield.limits import TEMPERATURE_RANGE_DEGC
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, TRIADS, FloatArray, Status, is_possible_degc
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Fields = Mapping[str, FloatArray]
Source = TextTable | ArrayTable
"""A file whose columns are known."""

# The flag of a gap, by column.
_MAY_LACK = dict.fromkeys(ACCELEROMETER_COLUMNS, Status.ACCELEROMETER_INVALID) | dict.fromkeys(
    GYROSCOPE_COLUMNS, Status.GYROSCOPE_INVALID
)
_FEW_STEPS_BACK = 0.1  # Share of the rows.
_LEAST_ROOM = 1.5  # Usual steps between the neighbours of a wrong time; there are two where nothing else is wrong.
_ROLLED_AFTER = 2.0**32  # ``micros()`` of an Arduino begins anew every 71.6 minutes, ``millis()`` every 49.7 days.
_NEAR_ROLL = _ROLLED_AFTER / 1000  # Of microseconds 4 s: more than a sample takes.
_LIMITS = {STATUS: (0, 2**32 - 1), COUNTER: (-(2**63), 2**63 - 1)}  # Of what is kept in whole numbers.


@dataclass(frozen=True, slots=True, kw_only=True)
class File:
    """Columns of one file by field, in the units that were found or assumed; times count from ``zero_s`` seconds after 1970."""

    path: Path
    name: str
    """In sentences, e.g. ``gyroscope in log.csv``."""
    fields: dict[str, FloatArray]
    units: dict[str, str]
    assumptions: tuple[str, ...]
    settings: dict[str, str | float] = field(default_factory=dict)
    raw_zero: tuple[float, ...] | None = None
    zero_s: float = 0.0


def open_source(path: Path, topic: str | None) -> Source:
    """Open a file by what it starts with; raises as ``read_tables``."""
    if is_bag(path):
        return read_bag(path, topic)
    kind = array_kind(path)
    return open_table(path) if kind is None else read_arrays(kind, path)


def meaning_of(source: Source, columns: str | None, number: int, files: int) -> Meaning:
    """Return what the columns of a file are: by the user, else by its header, else by their number."""
    if columns is not None:
        meaning = columns_by_user(source.path, columns, source.width)
    elif source.header is not None:
        text_columns = source.text_columns if isinstance(source, TextTable) else ()
        numbers = [] if isinstance(source, TextTable) else source.values[:ROWS_LOOKED_AT].tolist()
        rows = source.head if isinstance(source, TextTable) else [[*map(str, row)] for row in numbers]
        meaning = columns_by_header(
            source.path, source.header, source.units, width=source.width, text_columns=text_columns, rows=rows
        )
        if isinstance(source, TextTable):
            refuse_several_instruments(source.path, source.header, source.head)
    else:
        meaning = columns_by_count(source.path, source.width, number, files)
    dated = isinstance(source, TextTable) and any(
        column.field == TIME and column.index in source.text_columns for column in meaning.columns
    )
    # Dates are read in seconds, whatever the heading says of them.
    return replace(meaning, units=meaning.units | {TIME: "s"}) if dated else meaning


def unrolled(pieces: Iterable[FloatArray], meaning: Meaning) -> Iterator[FloatArray]:
    """Yield consecutive rows with times that go on where a counter of 32 bits began anew; the same arrays where none did."""
    fields = [column.field for column in meaning.columns]
    place, last, rolled = fields.index(TIME) if TIME in fields else None, math.nan, 0.0
    for rows in pieces:
        if place is None or not len(rows):
            yield rows
            continue
        time, before = rows[:, place], np.append(last, rows[:-1, place])
        # A row that comes late goes back over the end.
        turns = (_is_begin(time) & _is_end(before)).astype(np.int64) - (_is_end(time) & _is_begin(before))
        last, shift = float(time[-1]), np.maximum(rolled + _ROLLED_AFTER * turns.cumsum(), 0.0)
        rolled = float(shift[-1])
        yield rows + np.where(np.arange(rows.shape[1]) == place, shift[:, None], 0.0) if rolled else rows


def _is_begin(time: FloatArray) -> NDArray[np.bool_]:
    return (time >= 0) & (time < _NEAR_ROLL)


def _is_end(time: FloatArray) -> NDArray[np.bool_]:
    return (time > _ROLLED_AFTER - _NEAR_ROLL) & (time < _ROLLED_AFTER)


def files_of(source: Source, meaning: Meaning, values: FloatArray) -> list[File]:
    """Return a file as it is, or each triad by itself where some rows lack it.

    Programs that log two instruments write each sample into a row of its own, or leave a lost one empty: a triad consists of
    the rows that have its values, and its times are its own. Raises as ``file_of``.
    """
    meaning, values = _with_whole_times(meaning, values)
    places = {column.field: place for place, column in enumerate(meaning.columns)}
    lacks = {}
    for quantity, triad in TRIADS.items():
        columns = values[:, [places[name] for name in triad if name in places]]
        if not all(map(is_empty, columns.T)):
            lacks[quantity] = np.isnan(columns).any(axis=1)
    is_timed = TIME in places and not is_empty(values[:, places[TIME]])
    # Without times nobody knows which rows belong together, and our own export flags its gaps. A triad that no row has whole is
    # refused below.
    if not is_timed or STATUS in places or not np.any([*lacks.values()]) or any(map(np.all, lacks.values())):
        return [file_of(source, meaning, values, range(len(values)))]
    if TEMPERATURE in places:
        values = _filled(values, places[TIME], places[TEMPERATURE])
    files: list[File] = []
    for quantity, lack in lacks.items():
        # What is of no triad comes with the first.
        of_none = {TIME} if files else places.keys() - {name for triad in TRIADS.values() for name in triad}
        fields = of_none.union(TRIADS[quantity])
        used = tuple(column for column in meaning.columns if column.field in fields)
        rows = np.flatnonzero(~lack)
        if len(rows) < 2:
            few = sentence("table_file.one_row_of_triad", path=str(source.path), quantity=quantity)
            raise RecordingError(few, Reason.BAD_DATA)
        part = values[rows][:, [places[column.field] for column in used]]
        file = file_of(source, replace(meaning, columns=used), part, rows.tolist())
        # What was assumed of the file is told once.
        assumptions = () if files else file.assumptions
        if lack.any():
            said = sentence("table_file.part", name=file.name, found=len(rows), of=len(values), quantity=quantity)
            assumptions = (*assumptions, said)
        files.append(replace(file, name=f"{quantity} in {file.name}", assumptions=assumptions))
    return files


def _filled(values: FloatArray, time: int, temperature: int) -> FloatArray:
    """Return rows with the temperature interpolated where it is missing; it changes slowly."""
    known = np.flatnonzero(np.isfinite(values[:, [time, temperature]]).all(axis=1))
    if not len(known):
        return values
    known = known[np.argsort(values[known, time])]
    filled = values.copy()
    filled[:, temperature] = np.interp(values[:, time], values[known, time], values[known, temperature])
    return filled


def file_of(source: Source, meaning: Meaning, values: FloatArray, rows: Sequence[int], *, known: Collection[str] = ()) -> File:
    """Return the columns of rows that were read, checked; ``rows`` says which of the file they are.

    Columns that are ``known`` have numbers in other rows of the file, if not in these.

    Raises
    ------
    RecordingError
        ``BAD_DATA`` with the line that is wrong.
    """
    path = source.path
    meaning, values = _with_whole_times(meaning, values)
    # One row has no rate.
    if len(values) < 2:
        raise RecordingError(sentence("table_file.one_row", path=str(path)), Reason.BAD_DATA)
    fields = {column.field: values[:, place] for place, column in enumerate(meaning.columns)}
    kept = {name: column for name, column in fields.items() if name == COUNTER or name in known or not is_empty(column)}
    if not kept.keys() - {COUNTER}:
        raise RecordingError(sentence("table_file.no_number", path=str(path)), Reason.BAD_DATA)
    # A column without a number may be left out; half a triad may not.
    _check_whole_triads(path, fields, kept)
    _check_whole_numbers(source, kept, rows)
    if TEMPERATURE in kept and TEMPERATURE in meaning.units:
        kept[TEMPERATURE] = in_degc(path, kept[TEMPERATURE], meaning.units[TEMPERATURE])
    _check_temperatures(source, kept, rows)
    for name, column in kept.items():
        if name not in (TEMPERATURE, COUNTER, STATUS):
            _check_finite(source, name, column, kept.get(STATUS), rows=rows)
    _check_no_step_back(source, kept.get(TIME), rows, is_guess=meaning.is_guess)
    file = File(path=path, name=path.name, fields=kept, units=meaning.units, assumptions=meaning.assumptions)
    said = (*source.assumptions, *meaning.assumptions)
    if isinstance(source, TextTable):
        return replace(file, assumptions=said)
    times = [column.index for column in meaning.columns if column.field == TIME]
    zero_s = source.zero_s[times[0]] if times and source.zero_s else 0.0
    return replace(file, assumptions=said, settings=source.settings, raw_zero=source.raw_zero, zero_s=zero_s)


def _with_whole_times(meaning: Meaning, values: FloatArray) -> tuple[Meaning, FloatArray]:
    """Return rows whose time is one column, where a second one has the fraction of its seconds."""
    fields = [column.field for column in meaning.columns]
    if FRACTION not in fields:
        return meaning, values
    time, part = fields.index(TIME), fields.index(FRACTION)
    rows, part_s = values.copy(), values[:, part] * SECONDS[meaning.units[FRACTION]]
    # What reaches a second is no part of one, but the time in another unit.
    rows[:, time] = part_s if (part_s >= 1.0).any() else rows[:, time] + part_s
    columns = tuple(column for column in meaning.columns if column.field != FRACTION)
    return replace(meaning, columns=columns), np.delete(rows, part, axis=1)


def is_empty(column: FloatArray) -> bool:
    """Tell whether a column is there by name only: our own export writes empty cells for what is not available."""
    return bool(np.isnan(column[0]) and np.isnan(column).all())


def _check_whole_triads(path: Path, fields: Fields, kept: Fields) -> None:
    """Refuse an axis without a number beside axes that have some."""
    for group in TRIADS.values():
        empty = [name for name in group if name in fields and name not in kept]
        if 0 < len(empty) < len(group):
            raise RecordingError(sentence("table_file.empty", path=str(path), columns=empty), Reason.BAD_DATA)


def _fault(key: str, source: Source, row: int, **values: object) -> RecordingError:
    """Return the error that a row is wrong, with its line."""
    line, where = source.where(row)
    return RecordingError(sentence(key, path=str(source.path), line=line, where=where, **values), Reason.BAD_DATA)


def _check_finite(source: Source, name: str, column: FloatArray, status: FloatArray | None, *, rows: Sequence[int]) -> None:
    """Refuse what is no number, but for the gaps that say of themselves that they are."""
    wrong = ~np.isfinite(column)
    if status is not None and name in _MAY_LACK:
        wrong &= (status.astype(np.int64) & int(_MAY_LACK[name])) == 0
    if wrong.any():
        row = int(np.argmax(wrong))
        raise _fault("table_file.not_finite", source, rows[row], value=column[row], name=name)


def _check_whole_numbers(source: Source, kept: Fields, rows: Sequence[int]) -> None:
    """Refuse flags and counters that are none; a counter may be missing."""
    for name, (low, high) in _LIMITS.items():
        if name not in kept:
            continue
        column = kept[name]
        # The upper limit itself is no float64: the next one is beyond it.
        is_sound = (column == np.rint(column)) & (column >= low) & (column < high + 1)
        if name == COUNTER:
            is_sound |= np.isnan(column)
        if not is_sound.all():
            row = int(np.argmin(is_sound))
            limits = {"low": low, "high": high}
            raise _fault("table_file.no_whole_number", source, rows[row], value=column[row], name=name, **limits)


def _check_temperatures(source: Source, kept: Fields, rows: Sequence[int]) -> None:
    """Refuse what no thermometer of an instrument shows, e.g. the -999 that stands for "none" in tables of others."""
    is_possible = is_possible_degc(kept.get(TEMPERATURE, np.empty(0)))
    if not is_possible.all():
        row = int(np.argmin(is_possible))
        low, high = TEMPERATURE_RANGE_DEGC
        raise _fault("table_file.impossible", source, rows[row], found=kept[TEMPERATURE][row], low=low, high=high)


def _check_no_step_back(source: Source, time: FloatArray | None, rows: Sequence[int], *, is_guess: bool) -> None:
    """Refuse a time that decreases; ``is_guess``: nobody said that the column is the time."""
    if time is None or not len(later := np.flatnonzero(np.diff(time) < 0.0) + 1):
        return
    row = int(later[0])
    # Where those around it rise without it one time alone is wrong, and it may be the one before.
    near = range(max(row - 2, 0), min(row + 2, len(time)))
    steps_without = {each: np.diff([time[other] for other in near if other != each]) for each in (row, row - 1)}
    # A clock that was set back by a step or two leaves less room between the others than one time takes.
    room = _LEAST_ROOM * median_step(time)
    has_room = {each: not 0 < each < len(time) - 1 or time[each + 1] - time[each - 1] > room for each in steps_without}
    rising = [each for each, steps in steps_without.items() if (steps >= 0.0).all() and has_room[each]]
    # Of rows in no order nearly every second one steps back.
    if len(later) <= _FEW_STEPS_BACK * len(time) and rising and len(near) > 2:
        alone = min(rising, key=lambda each: steps_without[each].max())
        raise _fault("table_file.wrong_time", source, rows[alone], value=time[alone])
    key = "table_file.guessed_time_back" if is_guess else "table_file.time_back"
    raise _fault(key, source, rows[row], before=time[row - 1], after=time[row], example=",".join(FIELDS[: source.width]))
