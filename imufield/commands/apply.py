"""``imufield apply``: correct a recording, in bounded memory."""

from __future__ import annotations

from pathlib import Path

import typer

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.commands.export_data import RowCount
from imufield.commands.import_files import table_samples
from imufield.commands.terminal.output import say
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.numbers import beside, hanging
from imufield.deliver.samples.apply_session import apply_session
from imufield.errors import UsageError
from imufield.files import refuse_overwriting
from imufield.pipeline.chain import session_samples


def run_apply(parameters: Path, source: Path, output: Path, rate_hz: float | None = None) -> None:
    """Write a CSV of corrected samples from a session folder or a table; ``rate_hz`` of one without a time column.

    Raises
    ------
    ImufieldError
        If either cannot be read, or they do not belong together.
    """
    loaded = load(parameters)
    damage: list[Damage] = []
    if source.is_dir():
        if rate_hz is not None:
            raise UsageError("--rate-hz is for tables without a time column; a session has its time, leave it out")
        session = Session.open(source)
        refuse_overwriting(output, [parameters, *session.parts])
        serial_number, blocks = session.serial_number, session_samples(session, damage)
    else:
        refuse_overwriting(output, [parameters, source])
        serial_number, blocks = "", table_samples(source, rate_hz)
    count = RowCount()
    rows = apply_session(loaded, count.through(blocks), output, serial_number=serial_number)
    for one in damage:
        say(one.what, err=True)
    typer.echo(beside(f"{rows} corrected samples in", output))
    say("time in s, specific force in m/s^2, angular rate in rad/s, temperature in degC")
    if loaded.edited_note:
        typer.echo(hanging("", loaded.edited_note))
    if count.flags():
        typer.echo(hanging("", count.flags()))
