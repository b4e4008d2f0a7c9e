"""Position means that somebody else averaged: one CSV row per position.

The header names the columns, in any order: ``ax,ay,az`` are needed; ``gx,gy,gz``, ``sigma_ax`` to ``sigma_gz`` (1 sigma of the
mean, raw unit), ``name`` and ``temperature_degc`` are optional, triads as a whole. Lines that start with ``#`` are comments.
An empty value in an optional column is "not available". Cells may be separated by semicolons or tabs instead, as spreadsheets
of many countries write them; numbers may have a decimal comma then.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.dataclass import dataclass
from imufield.errors import Reason, RecordingError
from imufield.files import read_small_file
from imufield.limits import TEMPERATURE_RANGE_DEGC
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, LARGEST_OUTPUT, FloatArray, SampleUnits, median
from imufield.sentences import Sentences, printable

sentence = Sentences(__package__)

NAME = "name"
TEMPERATURE = "temperature_degc"
_SIGMA_ACCELEROMETER = tuple(f"sigma_{column}" for column in ACCELEROMETER_COLUMNS)
_SIGMA_GYROSCOPE = tuple(f"sigma_{column}" for column in GYROSCOPE_COLUMNS)
_TRIADS = (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, _SIGMA_ACCELEROMETER, _SIGMA_GYROSCOPE)
_COLUMNS = (*(column for triad in _TRIADS for column in triad), NAME, TEMPERATURE)
_SEPARATORS = (",", ";", "\t")  # No name of a column has one of these: the header tells which it is.
_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")
_SMALLEST_SIGMA = 1e-30  # No mean is known so well in any unit, and its square would be zero.
_MOST_POSITIONS = 2000  # Memory grows with their square: 32 MB for each matrix of these.
_SHOWN = 40  # Characters of a cell that a sentence repeats.


@dataclass(frozen=True, slots=True)
class _Table:
    """The text cells of a file."""

    path: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]  # Line number of each row.


def read_content(path: str | Path) -> bytes:
    """Return the content of a file or pipe of position means; raises RecordingError."""
    try:
        return read_small_file(path)
    except OSError as error:
        unreadable = sentence("observation_files.unreadable", path=str(path), cause=error.strerror)
        raise RecordingError(unreadable, Reason.NOT_A_RECORDING) from error


def parse_observations(content: bytes, path: str | Path) -> Observations:
    """Return the position means that a CSV file holds.

    Parameters
    ----------
    content : bytes
    path : str or Path
        Where they come from, for sentences.

    Returns
    -------
    Observations
        Covariances are diagonal from the sigmas, NaN where there are none; directions are NaN. The raw unit is m/s^2 where the
        outputs span 2 g of that (rad/s with it), g where they span 2, else count.

    Raises
    ------
    RecordingError
        If a column is unknown, missing or twice there, or a value is not a number or not finite;
        names file, line and column.
    """
    table = _read_table(content, Path(path))
    mean = _triad(table, ACCELEROMETER_COLUMNS)
    m = len(table.rows)
    names = tuple(printable(row[table.header.index(NAME)].strip()) for row in table.rows) if NAME in table.header else ("",) * m
    unknown = np.full(m, np.nan)
    return Observations(
        name=tuple(name or f"p{row + 1:02d}" for row, name in enumerate(names)),
        mean_raw=mean,
        covariance_raw=_diagonal(_triad(table, _SIGMA_ACCELEROMETER)),
        gyroscope_mean_raw=_triad(table, GYROSCOPE_COLUMNS),
        gyroscope_covariance_raw=_diagonal(_triad(table, _SIGMA_GYROSCOPE)),
        gyroscope_rounding_raw=np.zeros((m, 3)),
        gyroscope_noise_raw=np.full((m, 3), np.nan),
        direction=np.full((m, 3), np.nan),
        start_s=unknown,
        duration_s=unknown.copy(),
        middle_s=unknown.copy(),
        middle_rad=np.zeros((m, 3)),
        temperature_degc=_column(table, TEMPERATURE),
        units=_guess_units(mean),
    )


def _read_table(content: bytes, path: Path) -> _Table:
    try:
        whole = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _refused("observation_files.not_utf8", path, byte=error.start) from error
    numbered = [(k, line) for k, line in enumerate(whole.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")]
    if not numbered:
        raise _refused("observation_files.empty", path)
    lines = [k for k, _ in numbered]
    separator = next((character for character in _SEPARATORS if character in numbered[0][1]), ",")
    if len(numbered) - 1 > _MOST_POSITIONS:
        raise _refused("observation_files.too_many", path, positions=len(numbered) - 1, limit=_MOST_POSITIONS)
    rows = []
    for number, text in numbered:
        try:
            rows.append(next(csv.reader([text], delimiter=separator, strict=True)))
        except csv.Error as error:
            raise _refused("observation_files.not_csv", path, number, cause=error) from error
    header = tuple(cell.strip() for cell in rows[0])
    _check_header(path, lines[0], header)
    for line, row in zip(lines[1:], rows[1:], strict=True):
        if len(row) != len(header):
            comma = separator == "," and len(row) == 2 * len(header)
            key = "observation_files.decimal_commas" if comma else "observation_files.row_length"
            raise _refused(key, path, line, values=len(row), columns=len(header))
    if separator != ",":
        rows = [
            [cell if name == NAME else _DECIMAL_COMMA.sub(".", cell) for name, cell in zip(header, row, strict=True)]
            for row in rows
        ]
    return _Table(path, header, rows[1:], lines[1:])


def _refused(key: str, path: Path, line: int | None = None, column: str | None = None, **values: object) -> RecordingError:
    where = str(path) + (f", line {line}" if line else "") + (f", column {column}" if column else "")
    return RecordingError(sentence(key, where=where, **values), Reason.BAD_DATA, path=str(path), line=line, column=column)


def _check_header(path: Path, line: int, header: tuple[str, ...]) -> None:
    for column in header:
        if column not in _COLUMNS:
            blanks = len(column.split()) > 1 and all(word in _COLUMNS for word in column.split())
            key = "observation_files.blanks" if blanks else "observation_files.unknown_column"
            raise _refused(key, path, line, name=column[:_SHOWN], columns=_COLUMNS)
        if header.count(column) > 1:
            raise _refused("observation_files.twice", path, line, name=column)
    for triad in _TRIADS:
        present = [column for column in triad if column in header]
        if len(present) < 3 and (present or triad is ACCELEROMETER_COLUMNS):
            missing = [column for column in triad if column not in header]
            key = "observation_files.missing_columns" if len(missing) > 1 else "observation_files.missing_column"
            raise _refused(key, path, line, missing=missing, triad=triad)


def _triad(table: _Table, columns: tuple[str, ...]) -> FloatArray:
    return np.column_stack([_column(table, column) for column in columns])


def _column(table: _Table, column: str) -> FloatArray:
    if column not in table.header:
        return np.full(len(table.rows), np.nan)
    place = table.header.index(column)
    least = _SMALLEST_SIGMA if column.startswith("sigma_") else -LARGEST_OUTPUT
    least, most = TEMPERATURE_RANGE_DEGC if column == TEMPERATURE else (least, LARGEST_OUTPUT)
    values = np.full(len(table.rows), np.nan)
    for k, (line, row) in enumerate(zip(table.lines, table.rows, strict=True)):
        cell = row[place].strip()
        if not cell and column not in ACCELEROMETER_COLUMNS:
            continue
        try:
            values[k] = float(cell)
        except ValueError as error:
            raise _refused("observation_files.not_a_number", table.path, line, column, cell=cell[:_SHOWN]) from error
        if not least <= values[k] <= most:
            raise _refused("observation_files.impossible", table.path, line, column, cell=cell[:_SHOWN])
    return values


def _diagonal(sigma: FloatArray) -> FloatArray:
    covariance = np.zeros((len(sigma), 3, 3))
    covariance[:, range(3), range(3)] = sigma**2
    # All of a covariance is unknown where its diagonal is.
    covariance[np.isnan(sigma).any(axis=1)] = np.nan
    return covariance


def _guess_units(mean: FloatArray) -> SampleUnits:
    reach = float(median(np.ptp(mean, axis=0))) / 2 if len(mean) else 0.0
    if 8.0 < reach < 12.0:
        return SampleUnits(accelerometer="m/s^2", gyroscope="rad/s")
    return SampleUnits(accelerometer="g" if 0.8 < reach < 1.2 else "count", gyroscope="count")
