"""Samples as CSV: the shortest text of each number that reads back as the same, empty where there is none."""

from __future__ import annotations

import codecs
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from imufield.deliver.samples.number_text import float_column, integer_column, table_text
from imufield.errors import UsageError
from imufield.files import open_to_read
from imufield.samples import NO_COUNTER, SAMPLE_COLUMNS, Samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)

ROWS = 2048
"""Rows that are written at once: a quarter of a megabyte of text. More is no faster."""
_END_BYTES = 1 << 13  # Of a file, at either end: there formats keep what they say of themselves.
_HEADING = ",".join(SAMPLE_COLUMNS).encode()
_OF_OVERVIEW = b"time_s,ax_min,"
_OF_TABLES = (b"PAR1", b"\x89HDF")
_FACT = b"imufield_"  # Begins the name of each fact in a table.
_OF_ROS2 = b"\x04\0\0\0ros2\x08\0\0\0imufield"  # Profile and library, first in the file.


def write_csv(blocks: Iterable[Samples], path: Path, facts: Mapping[str, str]) -> int:  # noqa: ARG001  (CSV has no place for them)
    """Write header and rows; return the number of rows."""
    rows = 0
    with path.open("wb") as file:
        file.write((",".join(SAMPLE_COLUMNS) + "\n").encode())
        for block in blocks:
            rows += len(block)
            file.write(rows_text(block))
    return rows


def refuse_foreign_file(path: Path) -> None:
    """Keep a file that no export wrote: it may be the log that a session came from; raises ``UsageError``."""
    begin = end = b""
    # A file that cannot be read is reported when it is written.
    with suppress(OSError):
        if path.is_file():
            with open_to_read(path) as file:
                begin = file.read(_END_BYTES)
                file.seek(max(path.stat().st_size - _END_BYTES, 0))
                end = file.read()
    # A spreadsheet saves it with other line ends and with a mark of UTF-8.
    heading = begin.removeprefix(codecs.BOM_UTF8).split(b"\n", 1)[0].rstrip()
    is_table = begin.startswith(_OF_TABLES) and _FACT in begin + end
    if begin and not (heading == _HEADING or begin.startswith(_OF_OVERVIEW) or is_table or _OF_ROS2 in begin):
        raise UsageError(sentence("export_csv.foreign", path=path))


def rows_text(samples: Samples) -> bytes:
    """Return the lines of samples."""
    floats = (samples.time_s, *samples.accelerometer.T, *samples.gyroscope.T, samples.temperature_degc)
    counter = integer_column(samples.counter, samples.counter == NO_COUNTER)
    return table_text([*map(float_column, floats), counter, samples.status.tolist()])
