"""Several files of one recording onto one time: the time of the first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from imufield.acquire.table_columns import TIME
from imufield.errors import UsageError
from imufield.samples import FloatArray

_GAP_STEPS = 1.5
"""Between two samples further apart than this, in median steps, nothing is interpolated."""

Fields = Mapping[str, FloatArray]


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
    """Tell which times lie between two samples of the other file that are neighbours, or within half a sample of one."""
    if len(other) < 2:
        return np.zeros(len(time), dtype=bool)
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
    for file in files:
        joined = {**file, **joined}
    if TIME in joined:
        return joined, ["Files without a time column are joined row by row."]
    if rate_hz is None:
        raise UsageError(f"{paths[0]} has no time column: give its sample rate with --rate-hz.", path=str(paths[0]))
    joined[TIME] = np.arange(sizes[0]) / rate_hz
    return joined, [f"no time column: time counts from 0 at {rate_hz:g} Hz."]
