"""``imufield export-data``: the decoded samples of a session for other programs.

What a table of samples holds, for the person who asked for it: units, and rows that are better left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import typer

from imufield.acquire.recording.reader import Damage
from imufield.acquire.recording.session import Session
from imufield.commands.terminal.output import say
from imufield.deliver.parameters.numbers import beside, hanging
from imufield.deliver.samples.export_data import FORMATS, export_samples, facts_of
from imufield.errors import UsageError
from imufield.files import refuse_overwriting
from imufield.pipeline.chain import recorded_protocol, session_samples
from imufield.samples import Samples, SampleUnits, Status


class RowCount:
    """Counts flagged rows of blocks that pass."""

    def __init__(self) -> None:
        self._units: SampleUnits | None = None
        self._starting = 0
        self._unusable = 0

    def through(self, blocks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the blocks as they are."""
        for block in blocks:
            self._units = self._units or block.units
            self._starting += int(np.count_nonzero(block.status & np.uint32(Status.START_UP)))
            self._unusable += int(np.count_nonzero(~block.usable))
            yield block

    def units(self) -> str:
        """Return the units of the columns as they came, in words."""
        units = self._units or SampleUnits()
        each = (
            units.accelerometer + " per sample" * units.accelerometer_is_increment,
            units.gyroscope + " per sample" * units.gyroscope_is_increment,
        )
        return f"accelerometer in {each[0]}, gyroscope in {each[1]}"

    def flags(self, *, has_status: bool = True) -> str:
        """Return a sentence on the rows that are flagged, in a file that has a column for it or not; empty where none is."""
        if not self._unusable:
            return ""
        starting = f", {self._starting} of them from the instrument's start-up (16)" if self._starting else ""
        if not has_status:
            starting = starting.removesuffix(" (16)")
            return f"{self._unusable} messages lack a value that is not usable{starting}: it is NaN, with a covariance of -1"
        return f"{self._unusable} rows are marked as not usable in the column status{starting}: leave them out of means"


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
    stated = session.record.nominal.raw_zero
    raw_zero = protocol.nominal.raw_zero if stated is None else np.array(stated)
    damage: list[Damage] = []
    count = RowCount()
    blocks = count.through(session_samples(session, damage))
    rows = export_samples(blocks, path, to, facts_of(protocol, raw_zero))
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
