"""Tables of other programs -> rows of samples -> a recording.

CSV and whitespace text, one file or several joined by time. The numbers stay as they are (only units that protocol
``rows_f64`` does not know are converted); a mid-scale is kept beside them, not taken off. Whatever the files do not say
themselves is assumed aloud: ``Table.assumptions`` are sentences for the user.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from imufield.acquire.link import Chunk
from imufield.acquire.table_columns import (
    FIELDS,
    TEMPERATURE,
    TIME,
    Meaning,
    columns_by_count,
    columns_by_header,
    columns_by_user,
)
from imufield.acquire.table_join import join_by_row, join_by_time
from imufield.acquire.table_text import TextTable, open_table
from imufield.acquire.table_units import choose_time_scale, choose_unit
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, FloatArray, Samples

ROWS_PROTOCOL = "rows_f64"
ROW_BYTES = 8 * len(FIELDS)
LATEST_NS = 2**63 - 1
"""What a recording's time stamps hold: 292 years. Times beyond are kept in the rows themselves."""
_ROWS_A_CHUNK = 4096
"""256 KiB: few messages, and well below what one damaged byte may cost."""
_COLUMN = {field: place for place, field in enumerate(FIELDS)}


@dataclass(frozen=True, slots=True)
class Table:
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
    """

    rows: FloatArray
    settings: dict[str, str | float]
    raw_zero: tuple[float, float, float]
    assumptions: tuple[str, ...]

    @property
    def rate_hz(self) -> float:
        """Median sample rate."""
        return float(1.0 / np.median(np.diff(self.rows[:, 0])))


class ChunkWriter(Protocol):
    """What rows are written to: a ``Recorder``."""

    def write_chunk(self, chunk: Chunk, /) -> None:
        """Record a chunk."""
        ...


@dataclass(frozen=True, slots=True)
class _File:
    """Columns of one file by field, in the units that were found or assumed."""

    path: Path
    fields: dict[str, FloatArray]
    units: dict[str, str]
    assumptions: tuple[str, ...]


def read_tables(
    paths: Sequence[str | Path],
    *,
    columns: str | None = None,
    rate_hz: float | None = None,
    zero: str | float | Sequence[float] | None = None,
    settings: Mapping[str, object] | None = None,
) -> Table:
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
        ``accelerometer_unit`` and ``gyroscope_unit`` where the user knows better.

    Raises
    ------
    RecordingError
        A file cannot be read or holds something that is no number: ``BAD_DATA`` with file, line and text.
    UsageError
        The meaning of the columns, the unit of time or the rate is not known, or the files do not belong together.
    """
    if not paths:
        raise UsageError("no file to import: name at least one.")
    raw_zero = _parse_zero(zero)
    given = dict(settings or {})
    names = _columns_of_files(columns, len(paths))
    files = [_read_file(Path(path), names[i], i, len(paths)) for i, path in enumerate(paths)]
    said = [sentence for file in files for sentence in file.assumptions]
    joined, units, joining = _join(files, rate_hz)
    said += joining
    rows = _rows(joined)
    _check_values(rows, [file.path for file in files])
    found: dict[str, str | float] = {}
    for quantity in ("accelerometer", "gyroscope"):
        place = 1 if quantity == "accelerometer" else 4
        unit, factor, sentence = choose_unit(quantity, rows[:, place : place + 3], units, given, has_zero=zero is not None)
        if factor != 1.0:
            rows[:, place : place + 3] *= factor
        found[f"{quantity}_unit"] = unit
        said += [sentence] if sentence else []
    if rate_hz is not None:
        found["rate_hz"] = float(rate_hz)
    return Table(rows, found, raw_zero, tuple(said))


def write_rows(recorder: ChunkWriter, rows: FloatArray | Samples) -> None:
    """Write samples as chunks of whole rows of protocol ``rows_f64``; a chunk "arrives" at the time of its last sample.

    Parameters
    ----------
    recorder : Recorder
    rows : ndarray, shape (n, 8), or Samples
    """
    table = rows_of(rows) if isinstance(rows, Samples) else rows
    start_s = float(table[0, 0]) if len(table) else 0.0
    for start in range(0, len(table), _ROWS_A_CHUNK):
        part = table[start : start + _ROWS_A_CHUNK]
        last_s = float(part[-1, 0])
        recorder.write_chunk(
            Chunk(part.astype("<f8").tobytes(), last_s, min(max(0, round((last_s - start_s) * 1e9)), LATEST_NS))
        )


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
        raise UsageError(
            f"--zero {zero} is not one number or three: write e.g. --zero 32768 or --zero 32768,32770,32766.", zero=zero
        )
    return (numbers[0], numbers[1], numbers[2])


def _columns_of_files(columns: str | None, files: int) -> list[str | None]:
    if columns is None:
        return [None] * files
    parts: list[str | None] = list(columns.split(";"))
    if len(parts) == 1:
        return parts * files
    if len(parts) != files:
        raise UsageError(f"--columns describes {len(parts)} files, {files} are given: part the files by `;`.", columns=columns)
    return parts


def _read_file(path: Path, columns: str | None, number: int, files: int) -> _File:
    text = open_table(path)
    meaning = _meaning(text, columns, number, files)
    values = text.read([column.index for column in meaning.columns])
    if len(values) < 2:
        raise RecordingError(f"{path}: 1 row is no recording: check the file.", Reason.BAD_DATA, path=str(path))
    fields = {column.field: values[:, place] for place, column in enumerate(meaning.columns)}
    units = _units(path, meaning)
    kept = {field: column for field, column in fields.items() if not _is_empty(column)}
    for field, column in kept.items():
        if field != TEMPERATURE:
            _check_finite(text, field, column)
    _check_no_step_back(text, kept.get(TIME))
    return _File(path, kept, units, meaning.assumptions)


def _meaning(text: TextTable, columns: str | None, number: int, files: int) -> Meaning:
    if columns is not None:
        return columns_by_user(text.path, columns, text.width)
    if text.header is not None:
        return columns_by_header(text.path, text.header, text.units)
    return columns_by_count(text.path, text.width, number, files)


def _units(path: Path, meaning: Meaning) -> dict[str, str]:
    """Return the stated unit of each quantity; the columns of one triad must agree."""
    units: dict[str, str] = {}
    for column in meaning.columns:
        if column.unit is None:
            continue
        before = units.setdefault(column.quantity, column.unit)
        if before != column.unit:
            raise UsageError(
                f"{path} gives {column.quantity} in {before} and in {column.unit}: bring all its axes to one unit.",
                path=str(path),
            )
    return units


def _is_empty(column: FloatArray) -> bool:
    """Tell whether a column is there by name only: our own export writes empty cells for what is not available."""
    return bool(np.isnan(column[0]) and np.isnan(column).all())


def _check_finite(text: TextTable, field: str, column: FloatArray) -> None:
    wrong = ~np.isfinite(column)
    if wrong.any():
        row = int(np.argmax(wrong))
        line, content = text.line_of_row(row)
        raise RecordingError(
            f'{text.path} has {column[row]} for {field} in line {line}, "{content[:60]}": remove the line or fill the gap.',
            Reason.BAD_DATA,
            path=str(text.path),
            line=line,
        )


def _check_no_step_back(text: TextTable, time: FloatArray | None) -> None:
    if time is None or not (steps_back := np.diff(time) < 0.0).any():
        return
    row = int(np.argmax(steps_back)) + 1
    line, content = text.line_of_row(row)
    raise RecordingError(
        f'{text.path} steps back in time from {time[row - 1]:.9g} to {time[row]:.9g} in line {line}, "{content[:60]}": '
        "sort the file or cut it there.",
        Reason.BAD_DATA,
        path=str(text.path),
        line=line,
    )


def _join(files: Sequence[_File], rate_hz: float | None) -> tuple[dict[str, FloatArray], dict[str, str], list[str]]:
    """Bring the columns of all files onto one time in seconds."""
    units: dict[str, str] = {}
    for number, file in enumerate(files):
        doubled = sorted(field for field in file.fields for other in files[:number] if field in other.fields and field != TIME)
        if doubled:
            raise UsageError(f"{file.path} holds {', '.join(doubled)} again: give each quantity once.", path=str(file.path))
        units |= {quantity: unit for quantity, unit in file.units.items() if quantity not in units}
    timed, said = [], []
    for file in files:
        time = file.fields.get(TIME)
        if time is None:
            timed.append(file.fields)
            continue
        scale, sentence = choose_time_scale(file.path, time, file.units.get(TIME), rate_hz)
        said += [sentence] if sentence else []
        timed.append({**file.fields, TIME: time * scale if scale != 1.0 else time})
    names = [file.path for file in files]
    if all(TIME in fields for fields in timed):
        joined, joining = join_by_time(names, timed)
    else:
        joined, joining = join_by_row(names, timed, rate_hz)
    return joined, units, said + joining


def _rows(fields: Mapping[str, FloatArray]) -> FloatArray:
    rows = np.full((len(fields[TIME]), len(FIELDS)), np.nan)
    for field, column in fields.items():
        rows[:, _COLUMN[field]] = column
    return rows


def _check_values(rows: FloatArray, paths: Sequence[Path]) -> None:
    names = ", ".join(map(str, paths))
    if np.isnan(rows[0, _COLUMN[ACCELEROMETER_COLUMNS[0]]]) and np.isnan(rows[0, _COLUMN[GYROSCOPE_COLUMNS[0]]]):
        raise UsageError(f"{names}: neither accelerometer nor gyroscope has values: name the columns with --columns.")
