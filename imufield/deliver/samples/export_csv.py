"""Samples as CSV: the shortest text of each number that reads back as the same, empty where there is none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from imufield.deliver.samples.number_text import float_column, integer_column, table_text
from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, Samples

ROWS = 2048
"""Rows that are written at once: a quarter of a megabyte of text. More is no faster."""


def write_csv(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:  # noqa: ARG001  (CSV has no place for them)
    """Write header and rows; return the number of rows."""
    rows = 0
    with path.open("wb") as file:
        file.write((",".join(SAMPLE_COLUMNS) + "\n").encode())
        for block in blocks:
            rows += len(block)
            file.write(rows_text(block))
    return rows


def rows_text(samples: Samples) -> bytes:
    """Return the lines of samples."""
    floats = (samples.time_s, *samples.accelerometer.T, *samples.gyroscope.T, samples.temperature_degc)
    counter = integer_column(samples.counter, samples.counter == NO_COUNTER)
    return table_text([*map(float_column, floats), counter, samples.status.tolist()])
