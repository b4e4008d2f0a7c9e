"""``imufield export-data``: the decoded samples of a session for other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer

from imufield.acquire.protocol import Protocol
from imufield.acquire.recording import Damage
from imufield.acquire.session import Session
from imufield.commands.chain import recorded_protocol, session_samples
from imufield.commands.output import say
from imufield.commands.rows import RowCount
from imufield.deliver.export_data import FORMATS, export_samples, facts_of
from imufield.deliver.numbers import beside, hanging
from imufield.errors import UsageError
from imufield.files import refuse_overwriting
from imufield.samples import FloatArray


def run_export_data(folder: Path | None, to: str, output: Path | None) -> None:
    """Write one row per sample, flagged ones included.

    Raises
    ------
    UsageError
        If the format is not known, its package is not installed, or it cannot hold these samples.
    RecordingError
        If the session cannot be read or the file not be written.
    """
    if to not in FORMATS:
        listed = "; ".join(f"{name}: {one.title}" for name, one in FORMATS.items())
        raise UsageError(f"--to {to!r} is unknown; choose one of {listed}")
    session = Session.newest() if folder is None else Session.open(folder)
    path = output or session.folder / f"samples.{FORMATS[to].suffix}"
    refuse_overwriting(path, session.parts)
    protocol = recorded_protocol({}, session)
    damage: list[Damage] = []
    count = RowCount()
    blocks = count.through(session_samples(session, damage))
    rows = export_samples(blocks, path, to, facts_of(protocol, _raw_zero(session, protocol)))
    for one in damage:
        say(one.what, err=True)
    typer.echo(beside(f"{rows} samples in", path))
    if FORMATS[to].lacks:
        say(f"time in s, accelerometer in m/s^2, gyroscope in rad/s; {FORMATS[to].lacks}")
    else:
        say(f"time in s, {count.units()}, temperature in degC")
    flags = count.flags(has_status=not FORMATS[to].lacks)
    if flags:
        typer.echo(hanging("", flags))


def _raw_zero(session: Session, protocol: Protocol) -> FloatArray:
    stated = session.metadata.get("nominal", {}).get("raw_zero")
    return protocol.nominal.raw_zero if stated is None else np.asarray(stated, dtype=np.float64)
