"""Read tables of other programs as rows of samples, and write rows into a recording.

CSV and whitespace text, files of arrays, recordings of ROS; one file or several joined by time. The numbers stay as they are
(only units that protocol ``rows_f64`` does not know are converted); a mid-scale is kept beside them and not subtracted.
Whatever the files do not state is assumed aloud: ``ImportedTable.assumptions`` are sentences for the user.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imufield.acquire.background_work import BackgroundWork
from imufield.acquire.formats.table_arrays import ArrayTable
from imufield.acquire.formats.table_columns import (
    COUNTER,
    FIELDS,
    STATUS,
    TIME_UNIT,
    Meaning,
    choose_time_scale,
    choose_unit,
    given_time_unit,
    refuse_bursts,
    refuse_coarse_times,
    refuse_unsigned,
    spread_times,
)
from imufield.acquire.formats.table_file import File, file_of, files_of, is_empty, meaning_of, open_source, unrolled
from imufield.acquire.formats.table_join import join
from imufield.acquire.formats.table_names import TIME
from imufield.acquire.formats.table_text import TextTable
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.protocol.units import SECONDS, TO_SI, unit_name
from imufield.dataclass import dataclass, field, replace
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.samples import (
    ACCELEROMETER_COLUMNS,
    GYROSCOPE_COLUMNS,
    NO_COUNTER,
    TRIADS,
    FloatArray,
    IntArray,
    Samples,
    median,
    sound_rows,
)
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

ROWS_PROTOCOL = "rows_f64"
# A row of the same protocol with ``status = true``.
_FLAGGED_ROW = np.dtype([("numbers", "<f8", (len(FIELDS),)), ("status", "<u4")])
# The same with ``status = counted``.
_COUNTED_ROW = np.dtype([*((name, _FLAGGED_ROW[name]) for name in ("numbers", "status")), ("counter", "<i8")])
LATEST_NS = 2**63 - 1
"""What a recording's time stamps hold: 292 years. Times beyond are kept in the rows themselves."""
NO_POSITIONS = frozenset({"tables.no_accelerometer", "tables.no_gravity"})
"""Sentences about a table in which there will be no positions."""
# Of 1 g, which an accelerometer shows that is mostly at rest; without gravity it shows bias and noise. Counts are whole.
_LEAST_GRAVITY = 0.05
# Median magnitude of outputs that are in no known unit and no counts: less is motion, unless stills agree on gravity.
_LEAST_FRACTION = 0.25
_INCREMENTS = {"m/s", "rad"}  # Units that say so themselves.
_ROWS_A_CHUNK = 4096  # 256 KiB: few messages, and well below what one damaged byte may cost.
_ROWS_TO_GUESS_BY = 1 << 18  # 20 MiB of numbers; at 2000 Hz two minutes, in which nobody's unit looks like another's.


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
    raw_zero : tuple of 3 or 6 floats
        Raw accelerometer output at no input; zeros unless given.
    assumptions : tuple of str
        Sentences.
    guessed : mapping
        Triads whose unit is taken from the size of their numbers alone, with the sentence that says so.
    stated : mapping
        Unit of a triad as file or user state it, where its numbers were converted to another.
    status : ndarray of uint32, shape (n,), or None
        ``Status`` flags, where the file is an export of our own or a recording that tells.
    counter : ndarray of int64, shape (n,), or None
        Where the file is an export of our own, ``NO_COUNTER`` where the instrument sent none.
    begin_s : float
        Time of the first row, from 1970 where the files count from there.
    """

    rows: FloatArray
    settings: dict[str, str | float]
    raw_zero: tuple[float, ...]
    assumptions: tuple[str, ...]
    guessed: Mapping[str, str] = field(default_factory=dict)
    stated: Mapping[str, str] = field(default_factory=dict)
    status: NDArray[np.uint32] | None = None
    counter: IntArray | None = None
    begin_s: float = 0.0

    def __getitem__(self, rows: slice) -> ImportedTable:
        status, counter = self.status, self.counter
        return replace(
            self,
            rows=self.rows[rows],
            status=None if status is None else status[rows],
            counter=None if counter is None else counter[rows],
        )


class ChunkWriter(Protocol):
    """What rows are written to: a ``Recorder``."""

    def write_chunk(self, chunk: Chunk, /) -> None:
        """Record a chunk."""


def read_tables(
    paths: Sequence[str | Path],
    *,
    columns: str | None = None,
    rate_hz: float | None = None,
    zero: Sequence[float] | None = None,
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
    zero : three or six floats, optional
        Raw zero, raw unit; by default that of the file, else 0. Not subtracted.
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
    files = _files(paths, columns, topic)
    # Row by row, nothing of one file alone may go.
    if all(TIME in file.fields for file in files):
        files = [_with_own_times(file) for file in files]
        for file in files:
            unit = given_time_unit(settings or {}) or file.units.get(TIME)
            scale, _ = choose_time_scale(file.path, file.fields[TIME], unit, rate_hz)
            refuse_bursts(file.path, file.fields[TIME] * scale)
    table = _table(files, rate_hz, zero, settings)
    _refuse_unsigned(files, table)
    table = _with_rate_of_increments(table, settings or {})
    faults = _no_positions(table.rows[:, 1:4], str(table.settings["accelerometer_unit"]))
    return replace(table, assumptions=(*table.assumptions, *faults))


def _with_rate_of_increments(table: ImportedTable, settings: Mapping[str, object]) -> ImportedTable:
    """Return a table of increments with their rate, that of its times where none is stated."""
    known, steps_s = {**table.settings, **settings}, np.diff(table.rows[:, 0])
    si_units = {TO_SI.get(str(known[f"{triad}_unit"]), ("",))[0] for triad in TRIADS}
    are_increments = known.get("increments") == "true" or _INCREMENTS & si_units
    if not are_increments or "rate_hz" in known or not (steps_s > 0).any():
        return table
    rate_hz = 1 / float(median(steps_s[steps_s > 0]))
    words = sentence("tables.rate_of_increments", rate_hz=rate_hz)
    return replace(table, settings={**table.settings, "rate_hz": rate_hz}, assumptions=(*table.assumptions, words))


def _files(paths: Sequence[str | Path], columns: str | None = None, topic: str | None = None) -> list[File]:
    """Read the files of ``read_tables``; raises as it."""
    if not paths:
        raise UsageError(sentence("tables.no_file"))
    parts = [None] if columns is None else columns.split(";")
    # One description holds for every file.
    if len(parts) == 1:
        parts *= len(paths)
    if len(parts) != len(paths):
        raise UsageError(sentence("tables.other_number", found=len(parts), files=len(paths), columns=columns))
    sources = [open_source(Path(path), topic) for path in paths]
    # With headings, a quantity given twice is refused later.
    headless = [source.path.resolve() for source in sources if source.header is None and columns is None]
    if twice := [path for path in headless if headless.count(path) > 1]:
        raise UsageError(sentence("tables.same_file", path=twice[0]))
    told = enumerate(zip(sources, parts, strict=True))
    meanings = [meaning_of(source, names, number, len(paths)) for number, (source, names) in told]
    known, at_once, files = [*zip(sources, meanings, strict=True)], os.cpu_count() or 1, list[File]()
    for group in (known[first : first + at_once] for first in range(0, len(known), at_once)):
        reads = [BackgroundWork(partial(source.read, meaning.places)) for source, meaning in group]
        for (source, meaning), read in zip(group, reads, strict=True):
            files += files_of(source, meaning, next(unrolled([read.result()], meaning)))
    _check_values([file.path for file in files], {name for file in files for name in file.fields})
    for file in files:
        refuse_coarse_times(file.path, file.fields.get(TIME, np.empty(0)))
    return files


def _with_own_times(file: File) -> File:
    """Return a file in which rows of one tick have times of their own, and no row is there twice."""
    time = file.fields[TIME]
    repeated = np.flatnonzero(np.diff(time) == 0) + 1
    if not len(repeated):
        return file
    told = {"name": file.name, "rows": len(repeated), "of": len(time)}
    # Where a row of the same time differs, equal ones are samples of an instrument that stood still.
    if all(np.array_equal(each[repeated], each[repeated - 1], equal_nan=True) for each in file.fields.values()):
        fields = {name: np.delete(each, repeated) for name, each in file.fields.items()}
        return replace(file, fields=fields, assumptions=(*file.assumptions, sentence("tables.copies", **told)))
    spread = spread_times(time)
    if spread is None:
        return file
    fields = {**file.fields, TIME: spread}
    return replace(file, fields=fields, assumptions=(*file.assumptions, sentence("tables.spread", **told)))


def stream_table(path: str | Path, *, rate_hz: float | None = None) -> Iterator[ImportedTable]:
    """Yield one table piece by piece, so that memory is bounded by a piece; settings are those of the first.

    Units that no header states are guessed from the first quarter of a million rows. Other files than text come whole.

    Raises
    ------
    RecordingError, UsageError
        As ``read_tables``.
    """
    source = open_source(Path(path), None)
    # Arrays are in memory already, however they are handed on.
    if isinstance(source, ArrayTable):
        yield _table(_files([path]), rate_hz)
        return
    meaning = meaning_of(source, None, 0, 1)
    pieces = unrolled(_pieces(source, meaning), meaning)
    values = next(pieces)
    late = _late(source, meaning, values)
    file = file_of(source, meaning, values, range(len(values)), known=late.keys())
    known = file.fields.keys() | late.keys()
    _check_values([file.path], known)
    refuse_coarse_times(file.path, file.fields.get(TIME, np.empty(0)))
    head = _table([file], rate_hz, settings=_late_units(late, file.units))
    _refuse_unsigned([file], head)
    # What the first piece decided holds for all, even where another would be guessed from a later one.
    decided = {f"{quantity}_unit": head.settings[f"{quantity}_unit"] for quantity in TRIADS if quantity not in file.units}
    if TIME in file.fields and TIME not in file.units:
        scale, _ = choose_time_scale(file.path, file.fields[TIME], None, rate_hz)
        decided[TIME_UNIT] = next(name for name, value in SECONDS.items() if value == scale)
    yield head
    done, last = len(values), values[-1:]
    for values in pieces:
        # The row before stands in front, so that what must not change between two rows is seen here, too.
        rows = range(done - 1, done + len(values))
        file = file_of(source, meaning, np.concatenate([last, values]), rows, known=known)
        table = _table([file], rate_hz, settings=decided)
        # Each piece would count its time from 0.
        if rate_hz is not None and TIME not in file.fields:
            table.rows[:, 0] = (done - 1 + np.arange(len(table.rows))) / rate_hz
        yield table[1:]
        done, last = done + len(values), values[-1:]


def _pieces(source: TextTable, meaning: Meaning) -> Iterator[FloatArray]:
    """Yield the rows of a text: enough to guess units by, then block by block."""
    blocks = source.blocks(meaning.places)
    head = _enough_of(blocks)
    yield np.concatenate(head) if head else source.read(meaning.places)
    yield from blocks


def _enough_of(blocks: Iterable[FloatArray]) -> list[FloatArray]:
    """Return the first blocks, enough to guess a unit by."""
    found: list[FloatArray] = []
    for block in blocks:
        found.append(block)
        if sum(map(len, found)) >= _ROWS_TO_GUESS_BY:
            break
    return found


def _late(source: TextTable, meaning: Meaning, head: FloatArray) -> dict[str, FloatArray]:
    """Return the first numbers, enough to guess a unit by, of each column that has none in the head and some behind it."""
    late: dict[str, FloatArray] = {}
    # Then the head is the whole file.
    if len(head) < _ROWS_TO_GUESS_BY:
        return late
    for group in (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, (STATUS,)):
        columns = [column for place, column in enumerate(meaning.columns) if column.field in group and is_empty(head[:, place])]
        blocks = source.blocks([column.index for column in columns]) if columns else ()
        found = _enough_of(block[~np.isnan(block).all(axis=1)] for block in blocks)
        numbers = np.concatenate(found) if found else np.empty((0, len(columns)))
        late |= {column.field: each for column, each in zip(columns, numbers.T, strict=True) if np.isfinite(each).any()}
    return late


def _late_units(late: Mapping[str, FloatArray], stated: Mapping[str, str]) -> dict[str, str]:
    """Return the units of triads that begin behind the head, as settings, where no header states them."""
    units: dict[str, str] = {}
    for quantity, names in TRIADS.items():
        if quantity not in stated and late.keys() >= set(names):
            values = np.column_stack([late[name] for name in names])
            units[f"{quantity}_unit"], _, _ = choose_unit(quantity, values, stated, {}, has_zero=False)
    return units


def _table(
    files: Sequence[File],
    rate_hz: float | None,
    zero: Sequence[float] | None = None,
    settings: Mapping[str, object] | None = None,
) -> ImportedTable:
    """Join files and bring them to known units."""
    known = {name: value for file in files for name, value in file.settings.items()}
    given = {**known, **(settings or {})}
    joined, zero_s, units, assumptions = join(files, rate_hz, given_time_unit(settings or {}))
    said = [*(assumption for file in files for assumption in file.assumptions), *assumptions]
    rows = np.full((len(joined[TIME]), len(FIELDS)), np.nan)
    for place, name in enumerate(FIELDS):
        if name in joined:
            rows[:, place] = joined[name]
    # Rows have flags where a column of them is read, whatever a recording has.
    found, guessed, stated = {name: value for name, value in known.items() if name != STATUS}, {}, {}
    for quantity, columns in (("accelerometer", slice(1, 4)), ("gyroscope", slice(4, 7))):
        unit, factor, assumption = choose_unit(quantity, rows[:, columns], units, given, has_zero=zero is not None)
        if factor != 1.0:
            rows[:, columns] *= factor
            stated[quantity] = str(unit_name(str(given.get(f"{quantity}_unit", units.get(quantity))), quantity))
        elif assumption and quantity not in units:
            guessed[quantity] = assumption
        # Who writes g writes deg/s beside it; a turn shows it later, where there is one.
        units = {quantity: unit, **units}
        found[f"{quantity}_unit"] = unit
        said += [assumption] if assumption else []
    if rate_hz is not None:
        found["rate_hz"] = float(rate_hz)
    # The user knows better than the file.
    stated_zero = zero or next((file.raw_zero for file in files if file.raw_zero is not None), (0.0, 0.0, 0.0))
    status = joined[STATUS].astype(np.uint32) if STATUS in joined else None
    if status is not None:
        found["status"] = "true"
    counter = None
    # A recording of ROS states its flags itself: the counter of a file beside it would be interpolated to other times.
    if status is not None and COUNTER in joined and "status" not in known:
        counter = np.nan_to_num(joined[COUNTER], nan=NO_COUNTER).astype(np.int64)
        found["status"] = "counted"
    return ImportedTable(
        rows=rows,
        settings=found,
        raw_zero=(*stated_zero,),
        assumptions=tuple(said),
        guessed=guessed,
        stated=stated,
        status=status,
        counter=counter,
        begin_s=zero_s + float(rows[0, 0]),
    )


def _refuse_unsigned(files: Sequence[File], table: ImportedTable) -> None:
    paths = ", ".join(dict.fromkeys(str(file.path) for file in files))
    for quantity, columns in (("accelerometer", slice(1, 4)), ("gyroscope", slice(4, 7))):
        if table.settings[f"{quantity}_unit"] == "count":
            refuse_unsigned(paths, quantity, table.rows[:, columns])


def _no_positions(accelerometer: FloatArray, unit: str) -> list[Sentence]:
    """Return why no positions will be found in these outputs, shape (n, 3)."""
    known = sound_rows(accelerometer, np.isfinite(accelerometer))
    if not len(known):
        return [sentence("tables.no_accelerometer")]
    limit = _LEAST_GRAVITY * {"m/s^2": STANDARD_GRAVITY_M_S2, "g": 1.0, "count": 1.0}.get(unit, 0.0)
    if unit == "count" and not np.array_equal(known, np.rint(known)):
        limit = _LEAST_FRACTION
    with np.errstate(over="ignore"):  # in damaged files
        found = float(median(np.linalg.norm(known, axis=1)))
    return [sentence("tables.no_gravity", found=found, limit=limit, unit=unit)] if found < limit else []


def row_chunks(
    rows: FloatArray | Samples, status: NDArray[np.uint32] | None = None, counter: IntArray | None = None
) -> Iterator[Chunk]:
    """Yield samples as chunks of whole rows of protocol ``rows_f64``; a chunk "arrives" at the time of its last sample.

    Parameters
    ----------
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
        yield Chunk(content.tobytes(), last_s, min(max(0, round((last_s - start_s) * 1e9)), LATEST_NS))


def rows_of(samples: Samples) -> FloatArray:
    """Return samples as rows, shape (n, 8)."""
    return np.column_stack([samples.time_s, samples.accelerometer, samples.gyroscope, samples.temperature_degc])


def _check_values(paths: Sequence[Path], fields: Collection[str]) -> None:
    """Refuse files without a triad that has values."""
    if ACCELEROMETER_COLUMNS[0] not in fields and GYROSCOPE_COLUMNS[0] not in fields:
        raise UsageError(sentence("tables.no_values", paths=[*map(str, paths)]))
