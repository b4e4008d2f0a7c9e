"""Checks of the numbers of tables, which name the line of a fault, and the joining of several files of one recording."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from imufield.acquire.formats.table_arrays import ArrayTable
from imufield.acquire.formats.table_columns import COUNTER, FIELDS, STATUS, TIME
from imufield.acquire.formats.table_text import TextTable
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, FloatArray, Status

_GAP_STEPS = 1.5  # Between two samples further apart than this, in median steps, nothing is interpolated.

Fields = Mapping[str, FloatArray]
Source = TextTable | ArrayTable
"""A file whose columns are known."""


def join_by_time(paths: Sequence[Path], files: Sequence[Fields]) -> tuple[dict[str, FloatArray], list[str]]:
    """Join files that have a time column each, in seconds; equal times as they are, others by linear interpolation.

    Returns
    -------
    fields : dict of ndarray
    sentences : list of str

    Raises
    ------
    UsageError
        Files that share no time.
    """
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
            raise UsageError(
                f"{path} and {paths[0]} share no time ({_span(file[TIME])} and {_span(time)}): they are not of one recording.",
                path=str(path),
            )
        joined |= {name: np.interp(time, file[TIME], column) for name, column in file.items() if name != TIME}
        usable &= covered
        said.append(f"{path.name}: its times differ from those of {paths[0].name}, it was interpolated to them.")
    if not usable.all():
        said.append(f"{int((~usable).sum())} of {len(time)} rows of {paths[0].name} have no partner in time and are left out.")
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


def _span(time: FloatArray) -> str:
    return f"{time[0]:.6g} to {time[-1]:.6g} s"


def join_by_row(
    paths: Sequence[Path], files: Sequence[Fields], rate_hz: float | None
) -> tuple[dict[str, FloatArray], list[str]]:
    """Join files row by row, because not all of them have a time column.

    Raises
    ------
    UsageError
        Different numbers of rows, or neither a time column nor a rate.
    """
    sizes = [len(next(iter(file.values()))) for file in files]
    if len(set(sizes)) > 1:
        listed = ", ".join(f"{path}: {size}" for path, size in zip(paths, sizes, strict=True))
        raise UsageError(
            f"files without a time column can only be joined row by row and differ in their rows ({listed}): add the time.",
            rows=sizes,
        )
    joined: dict[str, FloatArray] = {}
    # Of a time in several files the first counts.
    for file in files:
        joined = {**file, **joined}
    if TIME in joined:
        return joined, ["Files without a time column are joined row by row."]
    if rate_hz is None:
        raise UsageError(f"{paths[0]} has no time column: give its sample rate with --rate-hz.", path=str(paths[0]))
    joined[TIME] = np.arange(sizes[0]) / rate_hz
    return joined, [f"no time column: time counts from 0 at {rate_hz:g} Hz."]


def is_empty(column: FloatArray) -> bool:
    """Tell whether a column is there by name only: our own export writes empty cells for what is not available."""
    return bool(np.isnan(column[0]) and np.isnan(column).all())


def check_whole_triads(path: Path, fields: Mapping[str, FloatArray], kept: Mapping[str, FloatArray]) -> None:
    """Refuse an axis without a number beside axes that have some, and a time without one."""
    for group in (ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, (TIME,)):
        empty = [name for name in group if name in fields and name not in kept]
        if empty and (len(empty) < len(group) or group == (TIME,)):
            raise RecordingError(
                f"{path} has no number for {', '.join(empty)} in any row: correct the file, or skip the column with --columns.",
                Reason.BAD_DATA,
                path=str(path),
                columns=empty,
            )


def _fault(source: Source, row: int, what: str, behind: str) -> RecordingError:
    """Return the error that a row is wrong, with its line."""
    line, where = source.where(row)
    return RecordingError(f"{source.path} {what} in {where}{behind}", Reason.BAD_DATA, path=str(source.path), line=line)


# The flag of a gap, by column.
_MAY_LACK = dict.fromkeys(ACCELEROMETER_COLUMNS, Status.ACCELEROMETER_INVALID) | dict.fromkeys(
    GYROSCOPE_COLUMNS, Status.GYROSCOPE_INVALID
)


def check_finite(source: Source, name: str, column: FloatArray, status: FloatArray | None, *, first_row: int) -> None:
    """Refuse what is no number, but for the gaps that say of themselves that they are."""
    wrong = ~np.isfinite(column)
    if status is not None and name in _MAY_LACK:
        wrong &= (status.astype(np.int64) & int(_MAY_LACK[name])) == 0
    if wrong.any():
        row = int(np.argmax(wrong))
        raise _fault(source, first_row + row, f"has {column[row]} for {name}", ": remove the line or fill the gap.")


_LIMITS = {STATUS: (0, 2**32 - 1), COUNTER: (-(2**63), 2**63 - 1)}  # Of what is kept in whole numbers.


def check_whole_numbers(source: Source, kept: Mapping[str, FloatArray], first_row: int) -> None:
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
            behind = f", no whole number from {low} to {high}: correct or remove the line."
            raise _fault(source, first_row + row, f"has {column[row]:g} for {name}", behind)


def check_no_step_back(source: Source, time: FloatArray | None, first_row: int, *, is_guess: bool) -> None:
    """Refuse a time that decreases; ``is_guess``: nobody said that the column is the time."""
    if time is None or not (steps_back := np.diff(time) < 0.0).any():
        return
    row = int(np.argmax(steps_back)) + 1
    what, behind = f"steps back in time from {time[row - 1]:.9g} to {time[row]:.9g}", ": sort the file or cut it there."
    if is_guess:
        what = f"has no header, and its first column, taken for time, {what}"
        behind = (
            f": say with --columns what its {source.width} columns are, e.g. --columns {','.join(FIELDS[: source.width])} "
            "(`-` skips one), or, if it is the time, sort the file or cut it there."
        )
    raise _fault(source, first_row + row, what, behind)


def check_values(paths: Sequence[Path], fields: Collection[str]) -> None:
    """Refuse files without a triad that has values."""
    if ACCELEROMETER_COLUMNS[0] not in fields and GYROSCOPE_COLUMNS[0] not in fields:
        names = ", ".join(map(str, paths))
        raise UsageError(f"{names}: neither accelerometer nor gyroscope has values: name the columns with --columns.")
