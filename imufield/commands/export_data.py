"""``imufield export-data``: the decoded samples of a session for other programs."""

from __future__ import annotations

import numpy as np

from imufield.acquire.decoded_session import session_protocol
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import open_or_newest
from imufield.commands.options.result_commands import ExportDataOptions
from imufield.commands.terminal.output import echo, say, say_each
from imufield.commands.terminal.row_count import RowCount
from imufield.deliver.parameters.printed_numbers import beside, hanging
from imufield.deliver.samples.export_csv import refuse_foreign_file
from imufield.deliver.samples.export_data import FORMATS, OUTLINE, export_samples, facts_of, format_of
from imufield.errors import RecordingError, UsageError
from imufield.files import refuse_overwriting
from imufield.pipeline.chain import session_outline, session_samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def run_export_data(options: ExportDataOptions) -> None:
    """Write one row per sample, flagged ones included.

    Raises
    ------
    UsageError
        If the format is not known, its package is not installed, or it cannot hold these samples.
    RecordingError
        If the session cannot be read or the file not be written.
    """
    to = format_of(options.output) if options.to is None else options.to
    if to not in FORMATS:
        listed = "; ".join(f"{name}: {form.title}" for name, form in FORMATS.items())
        raise UsageError(sentence("export_data.unknown_format", to=to, listed=listed))
    session = open_or_newest(options.session)
    path = options.output or session.folder / f"samples.{FORMATS[to].suffix}"
    refuse_overwriting(path, session.parts, RecordingError)
    refuse_foreign_file(path)
    protocol = session_protocol(session)
    # What was typed at the import goes before what the protocol assumes.
    stated = session.record.nominal.raw_zero
    raw_zero = protocol.nominal.raw_zero if stated is None else np.array(stated)
    damage: list[Damage] = []
    count = RowCount()
    read = session_outline if to == OUTLINE else session_samples
    blocks = count.through(read(session, damage))
    rows = export_samples(blocks, path, to, facts_of(protocol, raw_zero))
    say_each((entry.what for entry in damage), err=True)
    echo(beside(f"{rows} samples in", path))
    if FORMATS[to].lacks:
        say(f"time in s, accelerometer in m/s^2, gyroscope in rad/s; {FORMATS[to].lacks}")
    else:
        say(f"time in s, {count.units()}, temperature in degC")
    flags = count.flags(has_status=not FORMATS[to].lacks)
    if flags:
        echo(hanging("", flags))
