"""Samples of a table of another program, without a recording; files that cannot be read to their end are refused."""

from __future__ import annotations

import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from imufield.acquire.formats.tables import ROWS_PROTOCOL, row_chunks, stream_table
from imufield.acquire.protocol.protocol import load_protocol
from imufield.errors import Reason, RecordingError, UsageError
from imufield.pipeline.still_units import with_units_of_stills
from imufield.samples import Samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def table_samples(path: Path, rate_hz: float | None, assumptions: list[str]) -> Iterator[Samples]:
    """Yield the samples of a table, e.g. an exported CSV, block by block; ``assumptions`` receives what was assumed of it."""
    from imufield.acquire.decoder import Decoder  # An import of a table asks for what is below alone.

    refuse_endless([path])
    decoder: Decoder | None = None
    # The way of an import, through rows and the decoder: a table gives the same numbers imported or not.
    for table in stream_table(path, rate_hz=rate_hz):
        if decoder is None:
            first = with_units_of_stills(table)
            assumptions += first.assumptions
            decoder = Decoder(load_protocol(ROWS_PROTOCOL, first.settings))
        for chunk in row_chunks(table.rows, table.status, table.counter):
            yield decoder.feed(chunk.data, chunk.monotonic_s)
    if decoder is not None:
        yield decoder.flush()


def refuse_endless(paths: Sequence[Path]) -> None:
    """Refuse devices and pipes, which have no end or none that is sure to come, and names that no file can have.

    Raises
    ------
    UsageError, RecordingError
        If there is one.
    """
    for path in paths:
        try:
            mode = path.stat().st_mode
        except FileNotFoundError:
            continue  # said by what reads it
        except OSError as error:
            unreadable = sentence("table_samples.unreadable", path=path, cause=error.strerror)
            raise RecordingError(unreadable, Reason.NOT_A_RECORDING) from error
        if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
            raise UsageError(sentence("table_samples.device", path=path))
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise UsageError(sentence("table_samples.pipe", path=path))
