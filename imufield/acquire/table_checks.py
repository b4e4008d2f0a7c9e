"""What the numbers of a table are checked for, each fault by its line."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from imufield.acquire.table_arrays import ArrayTable
from imufield.acquire.table_columns import COUNTER, FIELDS, STATUS, TIME
from imufield.acquire.table_text import TextTable
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import ACCELEROMETER_COLUMNS, GYROSCOPE_COLUMNS, FloatArray, Status

Source = TextTable | ArrayTable
"""A file whose columns are known."""


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


_MAY_LACK = dict.fromkeys(ACCELEROMETER_COLUMNS, Status.ACCELEROMETER_INVALID) | dict.fromkeys(
    GYROSCOPE_COLUMNS, Status.GYROSCOPE_INVALID
)
"""The flag of a gap, by column."""


def check_finite(source: Source, name: str, column: FloatArray, status: FloatArray | None, first_row: int) -> None:
    """Refuse what is no number, but for the gaps that say of themselves that they are."""
    wrong = ~np.isfinite(column)
    if status is not None and name in _MAY_LACK:
        wrong &= (status.astype(np.int64) & int(_MAY_LACK[name])) == 0
    if wrong.any():
        row = int(np.argmax(wrong))
        line, where = source.where(first_row + row)
        raise RecordingError(
            f"{source.path} has {column[row]} for {name} in {where}: remove the line or fill the gap.",
            Reason.BAD_DATA,
            path=str(source.path),
            line=line,
        )


_LIMITS = {STATUS: (0, 2**32 - 1), COUNTER: (-(2**63), 2**63 - 1)}
"""Of what is kept in whole numbers."""


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
            line, where = source.where(first_row + row)
            raise RecordingError(
                f"{source.path} has {column[row]:g} for {name} in {where}, no whole number from {low} to {high}: "
                "correct or remove the line.",
                Reason.BAD_DATA,
                path=str(source.path),
                line=line,
            )


def check_no_step_back(source: Source, time: FloatArray | None, first_row: int, *, is_guess: bool) -> None:
    """Refuse a time that decreases; ``is_guess``: nobody said that the column is the time."""
    if time is None or not (steps_back := np.diff(time) < 0.0).any():
        return
    row = int(np.argmax(steps_back)) + 1
    line, where = source.where(first_row + row)
    wrong = f"steps back in time from {time[row - 1]:.9g} to {time[row]:.9g} in {where}"
    sentence = f"{source.path} {wrong}: sort the file or cut it there."
    if is_guess:
        sentence = (
            f"{source.path} has no header, and its first column, taken for time, {wrong}: say with --columns what its "
            f"{source.width} columns are, e.g. --columns {','.join(FIELDS[: source.width])} (`-` skips one), or, if it is the "
            "time, sort the file or cut it there."
        )
    raise RecordingError(sentence, Reason.BAD_DATA, path=str(source.path), line=line)


def check_values(paths: Sequence[Path], fields: Collection[str]) -> None:
    """Refuse files without a triad that has values."""
    if ACCELEROMETER_COLUMNS[0] not in fields and GYROSCOPE_COLUMNS[0] not in fields:
        names = ", ".join(map(str, paths))
        raise UsageError(f"{names}: neither accelerometer nor gyroscope has values: name the columns with --columns.")
