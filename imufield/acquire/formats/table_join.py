"""Several files of one recording to one table: by their times, or row by row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imufield.acquire.formats.table_columns import choose_time_scale
from imufield.acquire.formats.table_file import Fields, File
from imufield.acquire.formats.table_names import TEMPERATURE, TIME
from imufield.errors import UsageError
from imufield.samples import FloatArray, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_GAP_STEPS = 1.5  # Between two samples further apart than this, in median steps, nothing is interpolated.


class Joined(NamedTuple):
    """Columns of several files on one time in seconds."""

    columns: dict[str, FloatArray]
    zero_s: float
    """Seconds from 1970 to their time 0 if they count from there, else 0."""
    units: dict[str, str]
    assumptions: list[str]


def join(files: Sequence[File], rate_hz: float | None, time_unit: str | None = None) -> Joined:
    """Bring the columns of all files onto one time in seconds."""
    units: dict[str, str] = {}
    timed: list[dict[str, FloatArray]] = []
    said: list[str] = []
    first_of: dict[str, str] = {}
    for file in files:
        fields = dict(file.fields)
        if doubled := sorted(fields.keys() & first_of.keys() - {TIME, TEMPERATURE}):
            raise UsageError(sentence("table_join.doubled", path=str(file.path), fields=doubled))
        # Each sensor of a chip may come with the temperature of that chip.
        if TEMPERATURE in fields and TEMPERATURE in first_of:
            del fields[TEMPERATURE]
            said.append(sentence("table_join.second_temperature", name=file.name, first=first_of[TEMPERATURE]))
        units = file.units | units
        timed.append(fields)
        first_of = dict.fromkeys(fields, file.name) | first_of
    scales: dict[Path, float] = {}
    zero_s = next((file.zero_s for file in files if TIME in file.fields), 0.0)
    for file, fields in zip(files, timed, strict=True):
        if TIME in fields:
            # The times of triads of one file are of one column.
            if file.path not in scales:
                unit = time_unit or file.units.get(TIME)
                scales[file.path], assumption = choose_time_scale(file.path, fields[TIME], unit, rate_hz)
                said += [assumption] if assumption else []
            scale = scales[file.path]
            # Seconds stay as they are, to the last bit.
            if scale != 1.0:
                fields[TIME] = fields[TIME] * scale
            if file.zero_s != zero_s:
                fields[TIME] = fields[TIME] + (file.zero_s - zero_s)
    names = [file.name for file in files]
    if all(TIME in fields for fields in timed):
        columns, joining = _join_by_time(names, timed)
    else:
        columns, joining = _join_by_row([file.path for file in files], timed, rate_hz)
    return Joined(columns, zero_s, units, said + joining)


def _join_by_time(names: Sequence[str], files: Sequence[Fields]) -> tuple[dict[str, FloatArray], list[str]]:
    """Join files that have a time column each, in seconds; equal times as they are, others by linear interpolation."""
    time = files[0][TIME]
    joined = dict(files[0])
    said: list[str] = []
    usable = np.ones(len(time), dtype=bool)
    for name, file in zip(names[1:], files[1:], strict=True):
        if np.array_equal(file[TIME], time):
            joined |= {field: column for field, column in file.items() if field != TIME}
            continue
        covered = _covered(time, file[TIME])
        if not covered.any():
            spans = [f"{each[0]:.6g} to {each[-1]:.6g} s" for each in (file[TIME], time)]
            raise UsageError(sentence("table_join.no_common_time", name=name, first=names[0], spans=spans))
        joined |= {field: np.interp(time, file[TIME], column) for field, column in file.items() if field != TIME}
        usable &= covered
        # Of times that are all in both, interpolation takes the values as they are.
        if not np.isin(time[covered], file[TIME]).all():
            said.append(sentence("table_join.interpolated", name=name, first=names[0]))
    if not usable.all():
        said.append(sentence("table_join.left_out", rows=int((~usable).sum()), of=len(time), first=names[0]))
        joined = {field: column[usable] for field, column in joined.items()}
    return joined, said


def _covered(time: FloatArray, other: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Mark the times between two neighbouring samples of the other file, or within half a sample of one."""
    if len(other) < 2:
        return np.zeros(len(time), dtype=bool)
    # A file with gaps still has its usual step.
    step = float(median(np.diff(other)))
    after = np.clip(np.searchsorted(other, time), 1, len(other) - 1)
    before = after - 1
    is_between = (time >= other[before]) & (time <= other[after]) & (other[after] - other[before] <= _GAP_STEPS * step)
    is_near = np.minimum(np.abs(time - other[before]), np.abs(time - other[after])) <= 0.5 * step
    return is_between | is_near


def _join_by_row(
    paths: Sequence[Path], files: Sequence[Fields], rate_hz: float | None
) -> tuple[dict[str, FloatArray], list[str]]:
    """Join files row by row, because not all of them have a time column."""
    sizes = [len(next(iter(file.values()))) for file in files]
    if len(set(sizes)) > 1:
        listed = [f"{path}: {size}" for path, size in zip(paths, sizes, strict=True)]
        raise UsageError(sentence("table_join.other_rows", listed=listed, rows=sizes))
    # Of a time in several files the first counts.
    joined = {name: column for file in reversed(files) for name, column in file.items()}
    if TIME in joined:
        return joined, [sentence("table_join.by_row")]
    if rate_hz is None:
        raise UsageError(sentence("table_join.no_rate", path=str(paths[0]), known=[*joined]))
    joined[TIME] = np.arange(sizes[0]) / rate_hz
    return joined, [sentence("table_join.by_rate", rate_hz=rate_hz)]
