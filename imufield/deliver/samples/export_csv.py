"""Samples as CSV: the shortest text of each number that reads back as the same, empty where there is none."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from imufield.deliver.samples.number_text import float_cells, integer_cell, table_text
from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, Samples

ROWS = 4096
"""Of a block: half a megabyte of text. What is made of more would be given back to the system each time."""
_PENDING = 4  # Blocks between those who decode and who write text, so that neither waits for the other.


def write_csv(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:  # noqa: ARG001  (CSV has no place for them)
    """Write header and rows; return the number of rows. The next blocks come while a thread makes text of one."""
    rows = 0
    pending: deque[Future[bytes]] = deque()
    with path.open("wb") as file, ThreadPoolExecutor(1) as thread:
        file.write((",".join(SAMPLE_COLUMNS) + "\n").encode())
        for block in blocks:
            rows += len(block)
            pending.append(thread.submit(rows_text, block))
            if len(pending) > _PENDING:
                file.write(pending.popleft().result())
        file.writelines(text.result() for text in pending)
    return rows


def rows_text(samples: Samples) -> bytes:
    """Return the lines of samples."""
    floats = (samples.time_s[np.newaxis], samples.accelerometer.T, samples.gyroscope.T, samples.temperature_degc[np.newaxis])
    cells = [cell for columns in floats for cell in float_cells(columns)]
    cells.append(integer_cell(samples.counter, samples.counter == NO_COUNTER))
    cells.append(integer_cell(samples.status.astype(np.int64), np.zeros(len(samples), dtype=np.bool_)))
    return table_text(cells)
