"""Samples for other programs: one row each, flagged ones included, numbers exact to the last bit.

Raw units (in ``session.toml``), what is not available is left empty.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TextIO

import numpy as np

from imufield.errors import Reason, RecordingError
from imufield.files import refuse_what_is_no_file
from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, FloatArray, Samples

_ROWS_AT_ONCE = 8192
"""Text made at a time: about 1 MB, however large the blocks are."""


def export_csv(blocks: Iterable[Samples], path: str | Path) -> int:
    """Write a CSV file; it takes its name when it is complete.

    Parameters
    ----------
    blocks : iterable of Samples
        In time order; only one is held at a time.
    path : Path
        Replaced if it exists.

    Returns
    -------
    int
        Rows written.

    Raises
    ------
    RecordingError
        The file cannot be written; whatever stood under its name before is untouched.
    """
    path = Path(path)
    try:
        refuse_what_is_no_file(path)
        descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".new", dir=path.parent)
    except OSError as error:
        raise _cannot_write(path, error) from error
    try:
        with os.fdopen(descriptor, "w", encoding="ascii", newline="") as file:
            rows = write_csv(blocks, file)
        mask = os.umask(0)
        os.umask(mask)
        Path(name).chmod(0o666 & ~mask)
        Path(name).replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        with suppress(FileNotFoundError):
            Path(name).unlink()
    return rows


def write_csv(blocks: Iterable[Samples], file: TextIO) -> int:
    """Write header and rows to an open text file; return the number of rows."""
    file.write(",".join(SAMPLE_COLUMNS) + "\n")
    rows = 0
    for block in blocks:
        for start in range(0, len(block), _ROWS_AT_ONCE):
            part = block[start : start + _ROWS_AT_ONCE]
            file.write(_lines(part))
            rows += len(part)
    return rows


def _lines(samples: Samples) -> str:
    columns = [
        _floats(samples.time_s),
        *(_floats(samples.accelerometer[:, axis]) for axis in range(3)),
        *(_floats(samples.gyroscope[:, axis]) for axis in range(3)),
        _floats(samples.temperature_degc),
        ["" if value == NO_COUNTER else str(value) for value in samples.counter.tolist()],
        list(map(str, samples.status.tolist())),
    ]
    return "\n".join(map(",".join, zip(*columns, strict=True))) + "\n"


def _floats(values: FloatArray) -> list[str]:
    """Return the shortest text that reads back as the same number; empty for NaN."""
    missing = np.isnan(values)
    if missing.all():
        return [""] * len(values)
    texts = list(map(repr, values.tolist()))
    for row in np.flatnonzero(missing):
        texts[row] = ""
    return texts


def _cannot_write(path: Path, error: OSError) -> RecordingError:
    return RecordingError(
        f"{path} cannot be written ({error.strerror}): check the folder, its permissions and the disk space.",
        Reason.DISK_FULL,
        path=str(path),
        errno=error.errno,
    )
