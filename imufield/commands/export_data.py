"""``imufield export-data``: the decoded samples of a session for other programs."""

from __future__ import annotations

from pathlib import Path

import typer

from imufield.acquire.recording import Damage
from imufield.acquire.session import Session
from imufield.commands.chain import session_samples
from imufield.commands.rows import RowCount
from imufield.deliver.export_data import export_csv
from imufield.errors import UsageError

FORMATS = ("csv",)


def run_export_data(folder: Path | None, to: str, output: Path | None) -> None:
    """Write one row per sample, flagged ones included.

    Raises
    ------
    UsageError
        If the format is not known.
    """
    if to not in FORMATS:
        raise UsageError(f"--to {to!r} is unknown; choose one of {', '.join(FORMATS)}")
    session = Session.newest() if folder is None else Session.open(folder)
    path = output or session.folder / f"samples.{to}"
    damage: list[Damage] = []
    count = RowCount()
    rows = export_csv(count.through(session_samples(session, damage)), path)
    for one in damage:
        typer.echo(one.what, err=True)
    typer.echo(f"{rows} samples in {path}")
    typer.echo(f"time in s, {count.units()}, temperature in degC")
    if count.flags():
        typer.echo(count.flags())
