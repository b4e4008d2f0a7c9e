"""Samples as CSV: the shortest text of each number that reads back as the same, empty where there is none.

Where pyarrow is installed it writes what is long, several times faster; the text is that of Python's ``repr`` either way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO

import numpy as np

from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, FloatArray, Samples

_ROWS_AT_ONCE = 8192  # Text made at a time: about 1 MB, however large the blocks are.
_WORTH_ARROW = 1 << 15  # Rows that take Python as long as importing pyarrow.
# Between these both write a number that is not whole without an exponent.
_PLAIN_FROM, _PLAIN_BELOW = 1e-4, 1e10

Write = Callable[[Samples, IO[bytes]], object]


def write_csv(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:  # noqa: ARG001  (CSV has no place for them)
    """Write header and rows; return the number of rows."""
    rows = 0
    write: Write = write_rows
    with path.open("wb") as file:
        file.write((",".join(SAMPLE_COLUMNS) + "\n").encode())
        for block in blocks:
            if write is write_rows and len(block) >= _WORTH_ARROW:
                write = arrow_writer() or write_rows
            for start in range(0, len(block), _ROWS_AT_ONCE):
                write(block[start : start + _ROWS_AT_ONCE], file)
            rows += len(block)
    return rows


def write_rows(samples: Samples, file: IO[bytes]) -> None:
    """Write rows by Python alone."""
    columns = [
        *map(float_texts, _floats_of(samples)),
        ["" if value == NO_COUNTER else str(value) for value in samples.counter.tolist()],
        list(map(str, samples.status.tolist())),
    ]
    file.write(("\n".join(map(",".join, zip(*columns, strict=True))) + "\n").encode())


def float_texts(values: FloatArray) -> list[str]:
    """Return the shortest text that reads back as the same number; empty for NaN."""
    missing = np.isnan(values)
    if missing.all():
        return [""] * len(values)
    texts = list(map(repr, values.tolist()))
    for row in np.flatnonzero(missing):
        texts[row] = ""
    return texts


def _floats_of(samples: Samples) -> list[FloatArray]:
    return [samples.time_s, *samples.accelerometer.T, *samples.gyroscope.T, samples.temperature_degc]


def arrow_writer() -> Write | None:
    """Return what writes rows by pyarrow; None where that is not installed."""
    try:
        import pyarrow as pa
        import pyarrow.compute as pc
        from pyarrow import csv
    except ImportError:
        return None
    options = csv.WriteOptions(include_header=False, batch_size=_ROWS_AT_ONCE, quoting_style="none")

    def text(values: FloatArray) -> pa.Array:
        missing, size = np.isnan(values), np.abs(values)
        texts = pc.cast(pa.array(values, mask=missing), pa.string())
        is_plain = (size >= _PLAIN_FROM) & (size < _PLAIN_BELOW)
        is_whole = (values == np.rint(values)) & (size < _PLAIN_BELOW)
        if is_whole.any():
            texts = pc.if_else(pa.array(is_whole), pc.binary_join_element_wise(texts, ".0", ""), texts)
        others = ~(is_plain | is_whole | missing)
        return pc.replace_with_mask(texts, pa.array(others), pa.array(float_texts(values[others]), pa.string()))

    def write(samples: Samples, file: IO[bytes]) -> None:
        counter = pa.array(samples.counter, mask=samples.counter == NO_COUNTER)
        columns = [*map(text, _floats_of(samples)), counter, pa.array(samples.status)]
        csv.write_csv(pa.table(columns, names=SAMPLE_COLUMNS), file, options)

    return write
