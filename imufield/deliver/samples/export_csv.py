"""Samples as CSV: the shortest text of each number that reads back as the same, empty where there is none.

Where pyarrow is installed it writes what is long, several times faster; the text is that of Python's ``repr`` either way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, FloatArray, Samples

_ROWS_AT_ONCE = 8192  # Text made at a time: about 1 MB, however large the blocks are.
_WORTH_ARROW = 1 << 15  # Rows that take Python as long as importing pyarrow.
_PLAIN_FROM = 1e-4  # Least size that ``repr`` writes without an exponent; pyarrow does from 1e-6.
_PLAIN_BELOW = 1e10  # Size from which pyarrow writes an exponent; ``repr`` does from 1e16.

Numbers = NDArray[np.float64 | np.int64 | np.uint32]
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

    # Arrays are made of their buffers: pa.array and pa.scalar import pandas where it is installed, 50 MB and half a second.
    def numbers(kind: pa.DataType, values: Numbers, known: NDArray[np.bool_]) -> pa.Array:
        return pa.Array.from_buffers(kind, len(values), [bits(known), pa.py_buffer(np.ascontiguousarray(values))])

    def bits(flags: NDArray[np.bool_]) -> pa.Buffer:
        return pa.py_buffer(np.packbits(flags, bitorder="little"))

    def flags_of(flags: NDArray[np.bool_]) -> pa.Array:
        return pa.Array.from_buffers(pa.bool_(), len(flags), [None, bits(flags)])

    def strings(texts: list[str]) -> pa.Array:
        ends = pa.py_buffer(np.cumsum([0, *map(len, texts)], dtype=np.int32))
        return pa.Array.from_buffers(pa.string(), len(texts), [None, ends, pa.py_buffer("".join(texts).encode())])

    point, nothing = strings([".0", ""])

    def text(values: FloatArray) -> pa.Array:
        known, size = ~np.isnan(values), np.abs(values)
        texts = pc.cast(numbers(pa.float64(), values, known), pa.string())
        is_plain = (size >= _PLAIN_FROM) & (size < _PLAIN_BELOW)
        is_whole = (values == np.rint(values)) & (size < _PLAIN_BELOW)
        if is_whole.any():
            longer = pc.call_function("binary_join_element_wise", [texts, point, nothing])
            texts = pc.call_function("if_else", [flags_of(is_whole), longer, texts])
        others = known & ~is_plain & ~is_whole
        return pc.call_function("replace_with_mask", [texts, flags_of(others), strings(float_texts(values[others]))])

    def write(samples: Samples, file: IO[bytes]) -> None:
        counter = numbers(pa.int64(), samples.counter, samples.counter != NO_COUNTER)
        status = numbers(pa.uint32(), samples.status, np.ones(len(samples), dtype=np.bool_))
        columns = [*map(text, _floats_of(samples)), counter, status]
        csv.write_csv(pa.Table.from_arrays(columns, names=SAMPLE_COLUMNS), file, options)

    return write
