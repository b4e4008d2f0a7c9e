"""Read tables of other programs as rows of samples, and write rows into a recording.

CSV and whitespace text, files of arrays, recordings of ROS; one file or several joined by time. The numbers stay as they are
(only units that protocol ``rows_f64`` does not know are converted); a mid-scale is kept beside them and not subtracted.
Whatever the files do not state is assumed aloud: ``ImportedTable.assumptions`` are sentences for the user.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.formats.ros_bags import is_bag, read_bag
from imufield.acquire.formats.table_arrays import ArrayTable, array_kind, read_arrays
from imufield.acquire.formats.table_columns import (
    COUNTER,
    FIELDS,
    STATUS,
    TEMPERATURE,
    TIME,
    TIME_SCALE,
    TIME_UNIT,
    Meaning,
    choose_time_scale,
    choose_unit,
    columns_by_count,
    columns_by_header,
    columns_by_user,
    given_time_unit,
)
from imufield.acquire.formats.table_text import TextTable, open_table
from imufield.acquire.link.serial import Chunk
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, NO_COUNTER, FloatArray, IntArray, Samples, Status
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_Fields = Mapping[str, FloatArray]

ROWS_PROTOCOL = "rows_f64"
# A row of the same protocol with ``status = true``.
_FLAGGED_ROW = np.dtype([("numbers", "<f8", (len(FIELDS),)), ("status", "<u4")])
# The same with ``status = counted``.
_COUNTED_ROW = np.dtype([*((name, _FLAGGED_ROW[name]) for name in ("numbers", "status")), ("counter", "<i8")])
LATEST_NS = 2**63 - 1
"""What a recording's time stamps hold: 292 years. Times beyond are kept in the rows themselves."""
_ROWS_A_CHUNK = 4096  # 256 KiB: few messages, and well below what one damaged byte may cost.
_ROWS_TO_GUESS_BY = 1 << 18  # 20 MiB of numbers; at 2000 Hz two minutes, in which nobody's unit looks like another's.
_TRIADS = {"accelerometer": ACCELEROMETER_COLUMNS, "gyroscope": GYROSCOPE_COLUMNS}
# The flag of a gap, by column.
_MAY_LACK = dict.fromkeys(ACCELEROMETER_COLUMNS, Status.ACCELEROMETER_INVALID) | dict.fromkeys(
    GYROSCOPE_COLUMNS, Status.GYROSCOPE_INVALID
)
_LIMITS = {STATUS: (0, 2**32 - 1), COUNTER: (-(2**63), 2**63 - 1)}  # Of what is kept in whole numbers.
_GAP_STEPS = 1.5  # Between two samples further apart than this, in median steps, nothing is interpolated.

Source = TextTable | ArrayTable
"""A file whose columns are known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedTable:
    """What was imported.

    Attributes
    ----------
    rows : ndarray, shape (n, 8)
        time_s, ax, ay, az, gx, gy, gz, temperature; NaN where not available.
    settings : dict
        Settings of protocol ``rows_f64`` that the files or the user determine: ``accelerometer_unit``, ``gyroscope_unit``,
        ``rate_hz``.
    raw_zero : tuple of 3 floats
        Raw accelerometer output at no input; zeros unless given.
    assumptions : tuple of str
        Sentences.
    status : ndarray of uint32, shape (n,), or None
        ``Status`` flags, where the file is an export of our own or a recording that tells.
    counter : ndarray of int64, shape (n,), or None
        Where the file is an export of our own, ``NO_COUNTER`` where the instrument sent none.
    """

    rows: FloatArray
    settings: dict[str, str | float]
    raw_zero: tuple[float, float, float]
    assumptions: tuple[str, ...]
    status: NDArray[np.uint32] | None = None
    counter: IntArray | None = None

    def __getitem__(self, rows: slice) -> ImportedTable:
        status, counter = self.status, self.counter
        return replace(
            self,
            rows=self.rows[rows],
            status=None if status is None else status[rows],
            counter=None if counter is None else counter[rows],
        )

    @property
    def rate_hz(self) -> float:
        """Median sample rate."""
        return float(1.0 / np.median(np.diff(self.rows[:, 0])))


class ChunkWriter(Protocol):
    """What rows are written to: a ``Recorder``."""

    def write_chunk(self, chunk: Chunk, /) -> None:
        """Record a chunk."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """Columns of one file by field, in the units that were found or assumed."""

    path: Path
    fields: dict[str, FloatArray]
    units: dict[str, str]
    assumptions: tuple[str, ...]
    settings: dict[str, str | float] = field(default_factory=dict)
    raw_zero: tuple[float, float, float] | None = None


def read_tables(
    paths: Sequence[str | Path],
    *,
    columns: str | None = None,
    rate_hz: float | None = None,
    zero: str | float | Sequence[float] | None = None,
    settings: Mapping[str, object] | None = None,
    topic: str | None = None,
) -> ImportedTable:
    """Read one table, or several that belong together.

    Parameters
    ----------
    paths : sequence of Path
        A second file without header is taken as the gyroscope of the first.
    columns : str, optional
        Names of the columns, e.g. ``time,ax,ay,az,gx,gy,gz,temperature``; ``-`` skips one, ``;`` parts files.
    rate_hz : float, optional
        Needed where there is no time column; otherwise decides the unit of time where that is open.
    zero : str, float or three floats, optional
        Mid-scale of the accelerometer, raw unit. Not taken off.
    settings : mapping, optional
        ``accelerometer_unit``, ``gyroscope_unit`` and ``time_unit`` where the user knows better.
    topic : str, optional
        Of a recording of ROS, where it holds several.

    Raises
    ------
    RecordingError
        A file cannot be read or holds something that is no number: ``BAD_DATA`` with file, line and text.
    UsageError
        The meaning of the columns, the unit of time or the rate is not known, or the files do not belong together.
    """
    if not paths:
        raise UsageError(sentence("tables.no_file"))
    parts = [None] if columns is None else columns.split(";")
    # One description holds for every file.
    if len(parts) == 1:
        parts *= len(paths)
    if len(parts) != len(paths):
        raise UsageError(sentence("tables.other_number", found=len(parts), files=len(paths), columns=columns))
    files = []
    for number, (path, names) in enumerate(zip(paths, parts, strict=True)):
        source = _open(Path(path), topic)
        meaning = _meaning(source, names, number, len(paths))
        files.append(_file_of(source, meaning, source.read(meaning.places)))
    _check_values([file.path for file in files], {name for file in files for name in file.fields})
    return _table(files, rate_hz, zero, settings)


def stream_table(path: str | Path, *, rate_hz: float | None = None) -> Iterator[ImportedTable]:
    """Yield one table piece by piece, so that memory is bounded by a piece; settings are those of the first.

    Units that no header states are guessed from the first quarter of a million rows. Other files than text come whole.

    Raises
    ------
    RecordingError, UsageError
        As ``read_tables``.
    """
    source = _open(Path(path), None)
    # Arrays are in memory already, however they are handed on.
    if isinstance(source, ArrayTable):
        yield read_tables([path], rate_hz=rate_hz)
        return
    meaning = _meaning(source, None, 0, 1)
    pieces = _pieces(source, meaning)
    values = next(pieces)
    late = _late(source, meaning, values)
    file = _file_of(source, meaning, values, known=late.keys())
    known = file.fields.keys() | late.keys()
    _check_values([file.path], known)
    head = _table([file], rate_hz, settings=_late_units(late, file.units))
    # What the first piece decided holds for all, even where another would be guessed from a later one.
    decided = {f"{quantity}_unit": head.settings[f"{quantity}_unit"] for quantity in _TRIADS if quantity not in file.units}
    if TIME in file.fields and TIME not in file.units:
        scale, _ = choose_time_scale(file.path, file.fields[TIME], None, rate_hz)
        decided[TIME_UNIT] = next(name for name, value in TIME_SCALE.items() if value == scale)
    yield head
    done, last = len(values), values[-1:]
    for values in pieces:
        # The row before stands in front, so that what must not change between two rows is seen here, too.
        file = _file_of(source, meaning, np.concatenate([last, values]), done - 1, known=known)
        table = _table([file], rate_hz, settings=decided)
        # Each piece would count its time from 0.
        if rate_hz is not None and TIME not in file.fields:
            table.rows[:, 0] = (done - 1 + np.arange(len(table.rows))) / rate_hz
        yield table[1:]
        done, last = done + len(values), values[-1:]


def _pieces(source: TextTable, meaning: Meaning) -> Iterator[FloatArray]:
    """Yield the rows of a text: enough to guess units by, then block by block."""
    blocks = source.blocks(meaning.places)
    head: list[FloatArray] = []
    for block in blocks:
        head.append(block)
        if sum(map(len, head)) >= _ROWS_TO_GUESS_BY:
            break
    yield np.concatenate(head) if head else source.read(meaning.places)
    yield from blocks


def _late(source: TextTable, meaning: Meaning, head: FloatArray) -> dict[str, FloatArray]:
    """Return the first numbers, enough to guess a unit by, of each column that has none in the head and some behind it."""
    late: dict[str, FloatArray] = {}
    # Then the head is the whole file.
    if len(head) < _ROWS_TO_GUESS_BY:
        return late
    for group in (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, (STATUS,)):
        columns = [column for place, column in enumerate(meaning.columns) if column.field in group and is_empty(head[:, place])]
        found: list[FloatArray] = []
        for block in source.blocks([column.index for column in columns]) if columns else ():
            found.append(block[~np.isnan(block).all(axis=1)])
            if sum(map(len, found)) >= _ROWS_TO_GUESS_BY:
                break
        numbers = np.concatenate(found) if found else np.empty((0, len(columns)))
        late |= {column.field: each for column, each in zip(columns, numbers.T, strict=True) if np.isfinite(each).any()}
    return late


def _late_units(late: Mapping[str, FloatArray], stated: Mapping[str, str]) -> dict[str, str]:
    """Return the units of triads that begin behind the head, as settings, where no header states them."""
    units: dict[str, str] = {}
    for quantity, names in _TRIADS.items():
        if quantity not in stated and late.keys() >= set(names):
            values = np.column_stack([late[name] for name in names])
            units[f"{quantity}_unit"], _, _ = choose_unit(quantity, values, stated, {}, has_zero=False)
    return units


def _table(
    files: Sequence[_File],
    rate_hz: float | None,
    zero: str | float | Sequence[float] | None = None,
    settings: Mapping[str, object] | None = None,
) -> ImportedTable:
    """Join files and bring them to known units."""
    known = {name: value for file in files for name, value in file.settings.items()}
    given = {**known, **(settings or {})}
    joined, units, joining = _join(files, rate_hz, given_time_unit(settings or {}))
    said = [*(assumption for file in files for assumption in file.assumptions), *joining]
    rows = np.full((len(joined[TIME]), len(FIELDS)), np.nan)
    for place, name in enumerate(FIELDS):
        if name in joined:
            rows[:, place] = joined[name]
    found = dict(known)
    for quantity, columns in (("accelerometer", slice(1, 4)), ("gyroscope", slice(4, 7))):
        unit, factor, assumption = choose_unit(quantity, rows[:, columns], units, given, has_zero=zero is not None)
        if factor != 1.0:
            rows[:, columns] *= factor
        found[f"{quantity}_unit"] = unit
        said += [assumption] if assumption else []
    if rate_hz is not None:
        found["rate_hz"] = float(rate_hz)
    # The user knows better than the file.
    stated_zero = next((file.raw_zero for file in files if file.raw_zero is not None), None)
    raw_zero = stated_zero if zero is None and stated_zero is not None else _parse_zero(zero)
    status = joined[STATUS].astype(np.uint32) if STATUS in joined else None
    if status is not None:
        found["status"] = "true"
    counter = None
    # A recording of ROS states its flags itself: the counter of a file beside it would be interpolated to other times.
    if status is not None and COUNTER in joined and "status" not in known:
        counter = np.nan_to_num(joined[COUNTER], nan=NO_COUNTER).astype(np.int64)
        found["status"] = "counted"
    return ImportedTable(rows=rows, settings=found, raw_zero=raw_zero, assumptions=tuple(said), status=status, counter=counter)


def write_rows(
    recorder: ChunkWriter,
    rows: FloatArray | Samples,
    status: NDArray[np.uint32] | None = None,
    counter: IntArray | None = None,
) -> None:
    """Write samples as chunks of whole rows of protocol ``rows_f64``; a chunk "arrives" at the time of its last sample.

    Parameters
    ----------
    recorder : Recorder
    rows : ndarray, shape (n, 8), or Samples
    status : ndarray of uint32, shape (n,), optional
        Makes rows for the setting ``status = true``.
    counter : ndarray of int64, shape (n,), optional
        Beside ``status``; for the setting ``status = counted``.
    """
    table = rows_of(rows) if isinstance(rows, Samples) else rows
    start_s = float(table[0, 0]) if len(table) else 0.0
    for start in range(0, len(table), _ROWS_A_CHUNK):
        here = slice(start, start + _ROWS_A_CHUNK)
        part = table[here]
        content: NDArray[np.float64] | NDArray[np.void] = part.astype("<f8")
        if status is not None:
            flagged: NDArray[np.void] = np.empty(len(part), dtype=_FLAGGED_ROW if counter is None else _COUNTED_ROW)
            flagged["numbers"], flagged["status"] = part, status[here]
            if counter is not None:
                flagged["counter"] = counter[here]
            content = flagged
        last_s = float(part[-1, 0])
        recorder.write_chunk(Chunk(content.tobytes(), last_s, min(max(0, round((last_s - start_s) * 1e9)), LATEST_NS)))


def rows_of(samples: Samples) -> FloatArray:
    """Return samples as rows, shape (n, 8)."""
    return np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope, samples.temperature_degc])


def _parse_zero(zero: str | float | Sequence[float] | None) -> tuple[float, float, float]:
    """Read a mid-scale: one number for all axes, or three."""
    if zero is None:
        return (0.0, 0.0, 0.0)
    try:
        numbers = [float(part) for part in zero.split(",")] if isinstance(zero, str) else np.ravel(zero).astype(float).tolist()
    except ValueError:
        numbers = []
    if len(numbers) == 1:
        numbers *= 3
    if len(numbers) != 3 or not np.all(np.isfinite(numbers)):
        raise UsageError(sentence("tables.zero", zero=zero))
    return (numbers[0], numbers[1], numbers[2])


def _open(path: Path, topic: str | None) -> Source:
    """Open a file by what it starts with; raises as ``read_tables``."""
    if is_bag(path):
        return read_bag(path, topic)
    kind = array_kind(path)
    return open_table(path) if kind is None else read_arrays(kind, path)


def _meaning(source: Source, columns: str | None, number: int, files: int) -> Meaning:
    if columns is not None:
        return columns_by_user(source.path, columns, source.width)
    if source.header is not None:
        return columns_by_header(source.path, source.header, source.units)
    return columns_by_count(source.path, source.width, number, files)


def _file_of(source: Source, meaning: Meaning, values: FloatArray, first_row: int = 0, *, known: Collection[str] = ()) -> _File:
    """Return the columns of rows that were read, the first of which is row ``first_row`` of the file, checked.

    Columns that are ``known`` have numbers in other rows of the file, if not in these.
    """
    path = source.path
    # One row has no rate.
    if len(values) < 2:
        raise RecordingError(sentence("tables.one_row", path=str(path)), Reason.BAD_DATA)
    fields = {column.field: values[:, place] for place, column in enumerate(meaning.columns)}
    kept = {name: column for name, column in fields.items() if name == COUNTER or name in known or not is_empty(column)}
    if not kept.keys() - {COUNTER}:
        raise RecordingError(sentence("tables.no_number", path=str(path)), Reason.BAD_DATA)
    # A column without a number may be left out; half a triad may not.
    _check_whole_triads(path, fields, kept)
    _check_whole_numbers(source, kept, first_row)
    for name, column in kept.items():
        if name not in (TEMPERATURE, COUNTER, STATUS):
            _check_finite(source, name, column, kept.get(STATUS), first_row=first_row)
    _check_no_step_back(source, kept.get(TIME), first_row, is_guess=meaning.is_guess)
    file = _File(path=path, fields=kept, units=meaning.units, assumptions=meaning.assumptions)
    if isinstance(source, TextTable):
        return file
    said = (*source.assumptions, *meaning.assumptions)
    return replace(file, assumptions=said, settings=source.settings, raw_zero=source.raw_zero)


def _join(
    files: Sequence[_File], rate_hz: float | None, time_unit: str | None = None
) -> tuple[dict[str, FloatArray], dict[str, str], list[str]]:
    """Bring the columns of all files onto one time in seconds; return them, their units and sentences."""
    units: dict[str, str] = {}
    timed: list[dict[str, FloatArray]] = []
    said: list[str] = []
    for file in files:
        doubled = sorted(field for field in file.fields for other in timed if field in other and field != TIME)
        if doubled:
            raise UsageError(sentence("tables.doubled", path=str(file.path), fields=doubled))
        units = file.units | units
        timed.append(dict(file.fields))
    for file, fields in zip(files, timed, strict=True):
        if TIME in fields:
            scale, assumption = choose_time_scale(file.path, fields[TIME], time_unit or file.units.get(TIME), rate_hz)
            said += [assumption] if assumption else []
            # Seconds stay as they are, to the last bit.
            if scale != 1.0:
                fields[TIME] = fields[TIME] * scale
    names = [file.path for file in files]
    if all(TIME in fields for fields in timed):
        joined, joining = _join_by_time(names, timed)
    else:
        joined, joining = _join_by_row(names, timed, rate_hz)
    return joined, units, said + joining


def _join_by_time(paths: Sequence[Path], files: Sequence[_Fields]) -> tuple[dict[str, FloatArray], list[str]]:
    """Join files that have a time column each, in seconds; equal times as they are, others by linear interpolation."""
    time = files[0][TIME]
    joined = dict(files[0])
    said: list[str] = []
    usable = np.ones(len(time), dtype=bool)
    for path, file in zip(paths[1:], files[1:], strict=True):
        if np.array_equal(file[TIME], time):
            joined |= {name: column for name, column in file.items() if name != TIME}
            continue
        covered = _covered(time, file[TIME])
        if not covered.any():
            spans = [f"{each[0]:.6g} to {each[-1]:.6g} s" for each in (file[TIME], time)]
            raise UsageError(sentence("tables.no_common_time", path=str(path), first=paths[0], spans=spans))
        joined |= {name: np.interp(time, file[TIME], column) for name, column in file.items() if name != TIME}
        usable &= covered
        said.append(sentence("tables.interpolated", name=path.name, first=paths[0].name))
    if not usable.all():
        said.append(sentence("tables.left_out", rows=int((~usable).sum()), of=len(time), first=paths[0].name))
        joined = {name: column[usable] for name, column in joined.items()}
    return joined, said


def _covered(time: FloatArray, other: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Mark the times between two neighbouring samples of the other file, or within half a sample of one."""
    if len(other) < 2:
        return np.zeros(len(time), dtype=bool)
    # A file with gaps still has its usual step.
    step = float(np.median(np.diff(other)))
    after = np.clip(np.searchsorted(other, time), 1, len(other) - 1)
    before = after - 1
    is_between = (time >= other[before]) & (time <= other[after]) & (other[after] - other[before] <= _GAP_STEPS * step)
    is_near = np.minimum(np.abs(time - other[before]), np.abs(time - other[after])) <= 0.5 * step
    covered: np.ndarray[tuple[int], np.dtype[np.bool_]] = is_between | is_near
    return covered


def _join_by_row(
    paths: Sequence[Path], files: Sequence[_Fields], rate_hz: float | None
) -> tuple[dict[str, FloatArray], list[str]]:
    """Join files row by row, because not all of them have a time column."""
    sizes = [len(next(iter(file.values()))) for file in files]
    if len(set(sizes)) > 1:
        listed = [f"{path}: {size}" for path, size in zip(paths, sizes, strict=True)]
        raise UsageError(sentence("tables.other_rows", listed=listed, rows=sizes))
    joined: dict[str, FloatArray] = {}
    # Of a time in several files the first counts.
    for file in files:
        joined = {**file, **joined}
    if TIME in joined:
        return joined, [sentence("tables.by_row")]
    if rate_hz is None:
        raise UsageError(sentence("tables.no_rate", path=str(paths[0])))
    joined[TIME] = np.arange(sizes[0]) / rate_hz
    return joined, [sentence("tables.by_rate", rate_hz=rate_hz)]


def is_empty(column: FloatArray) -> bool:
    """Tell whether a column is there by name only: our own export writes empty cells for what is not available."""
    return bool(np.isnan(column[0]) and np.isnan(column).all())


def _check_whole_triads(path: Path, fields: _Fields, kept: _Fields) -> None:
    """Refuse an axis without a number beside axes that have some, and a time without one."""
    for group in (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, (TIME,)):
        empty = [name for name in group if name in fields and name not in kept]
        if empty and (len(empty) < len(group) or group == (TIME,)):
            raise RecordingError(sentence("tables.empty", path=str(path), columns=empty), Reason.BAD_DATA)


def _fault(key: str, source: Source, row: int, **values: object) -> RecordingError:
    """Return the error that a row is wrong, with its line."""
    line, where = source.where(row)
    return RecordingError(sentence(key, path=str(source.path), line=line, where=where, **values), Reason.BAD_DATA)


def _check_finite(source: Source, name: str, column: FloatArray, status: FloatArray | None, *, first_row: int) -> None:
    """Refuse what is no number, but for the gaps that say of themselves that they are."""
    wrong = ~np.isfinite(column)
    if status is not None and name in _MAY_LACK:
        wrong &= (status.astype(np.int64) & int(_MAY_LACK[name])) == 0
    if wrong.any():
        row = int(np.argmax(wrong))
        raise _fault("tables.not_finite", source, first_row + row, value=column[row], name=name)


def _check_whole_numbers(source: Source, kept: _Fields, first_row: int) -> None:
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
            raise _fault("tables.no_whole_number", source, first_row + row, value=column[row], name=name, **limits)


def _check_no_step_back(source: Source, time: FloatArray | None, first_row: int, *, is_guess: bool) -> None:
    """Refuse a time that decreases; ``is_guess``: nobody said that the column is the time."""
    if time is None or not (steps_back := np.diff(time) < 0.0).any():
        return
    row = int(np.argmax(steps_back)) + 1
    key = "tables.guessed_time_back" if is_guess else "tables.time_back"
    example = {"width": source.width, "example": ",".join(FIELDS[: source.width])}
    raise _fault(key, source, first_row + row, before=time[row - 1], after=time[row], **example)


def _check_values(paths: Sequence[Path], fields: Collection[str]) -> None:
    """Refuse files without a triad that has values."""
    if ACCELEROMETER_COLUMNS[0] not in fields and GYROSCOPE_COLUMNS[0] not in fields:
        raise UsageError(sentence("tables.no_values", paths=[*map(str, paths)]))
