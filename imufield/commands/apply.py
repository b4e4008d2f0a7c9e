"""``imufield apply``: correct a recording, in bounded memory."""

from __future__ import annotations

from imufield.acquire.formats.table_columns import OF_COLUMNS
from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.commands.options.result_commands import ApplyOptions
from imufield.commands.terminal.output import echo, say, say_each
from imufield.commands.terminal.row_count import RowCount
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.printed_numbers import beside, hanging
from imufield.deliver.samples.apply_session import TemperatureFlags, apply_session
from imufield.deliver.samples.export_csv import refuse_foreign_file
from imufield.deliver.samples.export_data import format_of
from imufield.errors import RecordingError, UsageError
from imufield.files import refuse_overwriting
from imufield.pipeline.chain import session_samples
from imufield.pipeline.table_samples import table_samples
from imufield.sentences import Sentences

sentence = Sentences(__package__)


def run_apply(options: ApplyOptions) -> None:
    """Write a CSV of corrected samples from a session folder or a table.

    Raises
    ------
    ImufieldError
        If either cannot be read, or they do not belong together.
    """
    source, output = options.source, options.output
    if source.suffix.lower() == ".toml" and source.is_file():
        raise UsageError(sentence("apply.swapped", source=source))
    parameters = load(options.parameters)
    damage: list[Damage] = []
    assumptions: list[str] = []
    instrument_note = ""
    if source.is_dir():
        if options.rate_hz is not None:
            raise UsageError(sentence("apply.rate_of_session"))
        session = Session.open(source)
        refuse_overwriting(output, [options.parameters, *session.parts], RecordingError)
        serial_number, blocks = session.serial_number, session_samples(session, damage)
        instrument_note = parameters.instrument_note(session.record.instrument, session.sha256)
    else:
        refuse_overwriting(output, [options.parameters, source], RecordingError)
        serial_number, blocks = "", table_samples(source, options.rate_hz, assumptions)
    if format_of(output) != "csv":
        raise UsageError(sentence("apply.other_format", output=output))
    refuse_foreign_file(output)
    count, flags = RowCount(), TemperatureFlags(parameters)
    try:
        rows = apply_session(parameters, count.through(blocks), output, serial_number=serial_number, flags=flags)
    except UsageError as error:
        # Only an import has options for columns and units.
        if getattr(error.message, "key", "") not in OF_COLUMNS:
            raise
        words = sentence("apply.by_import", error=error.message.removesuffix("."))
        raise UsageError(words, error.reason, **error.values) from error
    # On the other stream: the rows say nothing of what is missing between them.
    say_each((*assumptions, *(entry.what for entry in damage)), err=True)
    if assumptions:
        say(sentence("apply.assumed", source=source), err=True)
    echo(beside(f"{rows} corrected samples in", output))
    say("time in s, specific force in m/s^2, angular rate in rad/s, temperature in degC")
    about_file = (instrument_note, parameters.edited_note, parameters.verdict_note, parameters.gyroscope_note)
    for note in filter(None, (*about_file, count.flags(), *flags.notes())):
        echo(hanging("", note))
