"""Position means that somebody else averaged: one CSV row per position.

The header names the columns, in any order: ``ax,ay,az`` are needed; ``gx,gy,gz``, ``sigma_ax`` to ``sigma_gz`` (1 sigma of the
mean, raw unit), ``name`` and ``temperature_degc`` are optional, triads as a whole. Lines that start with ``#`` are comments.
An empty value in an optional column is "not available".
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imufield.calibrate.observations import Observations
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, FloatArray, SampleUnits

NAME = "name"
TEMPERATURE = "temperature_degc"
_SIGMA_ACCELEROMETER = tuple(f"sigma_{column}" for column in ACCELEROMETER_COLUMNS)
_SIGMA_GYROSCOPE = tuple(f"sigma_{column}" for column in GYROSCOPE_COLUMNS)
_TRIADS = (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, _SIGMA_ACCELEROMETER, _SIGMA_GYROSCOPE)
_COLUMNS = (*(column for triad in _TRIADS for column in triad), NAME, TEMPERATURE)


@dataclass(frozen=True, slots=True)
class _Table:
    """The text cells of a file."""

    path: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    """Line number of each row."""


def read_observations(path: str | Path, *, units: SampleUnits | None = None) -> Observations:
    """Read position means from a CSV file.

    Parameters
    ----------
    path : str or Path
    units : SampleUnits, optional
        Raw units of the means. Default: m/s^2 where the outputs span 2 g of that (rad/s with it), g where they span 2, else
        count.

    Returns
    -------
    Observations
        Covariances are diagonal from the sigmas, NaN where there are none; directions are NaN.

    Raises
    ------
    UsageError
        If the file cannot be read, or a column is unknown, missing or twice there; names file, line and column.
    CalibrationError
        If a value is not a number or not finite.
    """
    table = _read_table(Path(path))
    mean = _triad(table, ACCELEROMETER_COLUMNS)
    m = len(table.rows)
    names = tuple(row[table.header.index(NAME)].strip() for row in table.rows) if NAME in table.header else ("",) * m
    unknown = np.full(m, np.nan)
    return Observations(
        name=tuple(name or f"p{row + 1:02d}" for row, name in enumerate(names)),
        mean_raw=mean,
        covariance_raw=_diagonal(_triad(table, _SIGMA_ACCELEROMETER)),
        gyroscope_mean_raw=_triad(table, GYROSCOPE_COLUMNS),
        gyroscope_covariance_raw=_diagonal(_triad(table, _SIGMA_GYROSCOPE)),
        direction=np.full((m, 3), np.nan),
        start_s=unknown,
        duration_s=unknown.copy(),
        temperature_degc=_column(table, TEMPERATURE),
        units=_guess_units(mean) if units is None else units,
    )


def _read_table(path: Path) -> _Table:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}; check the path", path=str(path)) from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 text (byte {error.start}); save it as CSV", path=str(path)) from error
    numbered = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")]
    lines = [k for k, _ in numbered]
    rows = [_cells(path, k, line) for k, line in numbered]
    if not rows:
        raise UsageError(f"{path} is empty; it needs a header with ax,ay,az and one row per position", path=str(path))
    header = tuple(cell.strip() for cell in rows[0])
    _check_header(path, lines[0], header)
    for line, row in zip(lines[1:], rows[1:], strict=True):
        if len(row) != len(header):
            raise UsageError(
                f"{path}, line {line}: {len(row)} values where the header has {len(header)} columns; complete the row",
                path=str(path),
                line=line,
            )
    return _Table(path, header, rows[1:], lines[1:])


def _cells(path: Path, number: int, line: str) -> list[str]:
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error as error:
        raise UsageError(f"{path}, line {number}: not CSV ({error}); save it as CSV", path=str(path), line=number) from error


def _check_header(path: Path, line: int, header: tuple[str, ...]) -> None:
    for column in header:
        if column not in _COLUMNS:
            raise UsageError(
                f"{path}, line {line}: unknown column {column!r}; the columns are {', '.join(_COLUMNS)}",
                path=str(path),
                column=column,
            )
        if header.count(column) > 1:
            raise UsageError(f"{path}, line {line}: column {column!r} is there twice; keep one", path=str(path), column=column)
    for triad in _TRIADS:
        present = [column for column in triad if column in header]
        if len(present) < 3 and (present or triad is ACCELEROMETER_COLUMNS):
            missing = ", ".join(column for column in triad if column not in header)
            raise UsageError(
                f"{path}, line {line}: column {missing} is missing; give all of {', '.join(triad)}", path=str(path)
            )


def _triad(table: _Table, columns: tuple[str, ...]) -> FloatArray:
    return np.column_stack([_column(table, column) for column in columns])


def _column(table: _Table, column: str) -> FloatArray:
    if column not in table.header:
        return np.full(len(table.rows), np.nan)
    place = table.header.index(column)
    cells = zip(table.lines, table.rows, strict=True)
    return np.array([_number(table.path, line, column, row[place]) for line, row in cells], dtype=np.float64)


def _number(path: Path, line: int, column: str, cell: str) -> float:
    if not cell.strip() and column not in ACCELEROMETER_COLUMNS:
        return math.nan
    try:
        value = float(cell)
    except ValueError as error:
        raise CalibrationError(
            f"{path}, line {line}, column {column}: {cell.strip()!r} is not a number; correct or remove the row",
            Reason.NOT_FINITE,
            line=line,
            column=column,
        ) from error
    if not math.isfinite(value) or (column.startswith("sigma_") and value <= 0):
        raise CalibrationError(
            f"{path}, line {line}, column {column}: {cell.strip()} is no possible value; correct or remove the row",
            Reason.NOT_FINITE,
            line=line,
            column=column,
        )
    return value


def _diagonal(sigma: FloatArray) -> FloatArray:
    covariance = np.zeros((len(sigma), 3, 3))
    covariance[:, range(3), range(3)] = sigma**2
    # All of a covariance is unknown where its diagonal is.
    covariance[np.isnan(sigma).any(axis=1)] = np.nan
    return covariance


def _guess_units(mean: FloatArray) -> SampleUnits:
    reach = float(np.median(np.ptp(mean, axis=0))) / 2 if len(mean) else 0.0
    if 8.0 < reach < 12.0:
        return SampleUnits("m/s^2", "rad/s")
    return SampleUnits("g" if 0.8 < reach < 1.2 else "count", "count")
