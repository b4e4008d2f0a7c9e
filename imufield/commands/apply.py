"""``imufield apply``: correct a recording, in bounded memory."""

from __future__ import annotations

from pathlib import Path

import typer

from imufield.acquire.recording import Damage
from imufield.acquire.session import Session
from imufield.commands.chain import session_samples
from imufield.commands.import_files import table_samples
from imufield.deliver.apply_session import apply_session
from imufield.deliver.parameters import load


def run_apply(parameters: Path, source: Path, output: Path) -> None:
    """Write a CSV of corrected samples from a session folder or a table.

    Raises
    ------
    ImufieldError
        If either cannot be read, or they do not belong together.
    """
    loaded = load(parameters)
    damage: list[Damage] = []
    if source.is_dir():
        session = Session.open(source)
        rows = apply_session(loaded, session_samples(session, damage), output, serial_number=session.serial_number)
    else:
        rows = apply_session(loaded, table_samples(source), output)
    for one in damage:
        typer.echo(one.what, err=True)
    typer.echo(f"{rows} corrected samples in {output}")
