"""``imufield replay``: a recorded session through the same chain, or its bytes to a port for other programs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from imufield.acquire.link import Chunk
from imufield.acquire.recording import Damage, EndOfRecordingError, RecordingLink
from imufield.acquire.session import Session
from imufield.commands.chain import Chain, Plan, replay_into
from imufield.guide.jsonlines import JsonLinesView
from imufield.guide.plain import PlainView

if TYPE_CHECKING:
    from imufield.simulate.port import PseudoTerminal

WAIT_S = 0.05
SLOT_S = 0.002
LINGER_S = 0.5
"""The port stays this long after the last byte: a reader that polls may not have taken it yet."""


def run_replay(folder: Path | None, *, to_pty: bool, speed: float, as_json: bool) -> None:
    """Replay a session.

    Raises
    ------
    ImufieldError
        If the session cannot be read.
    """
    session = Session.newest() if folder is None else Session.open(folder)
    if to_pty:
        _replay_to_pty(session, speed)
        return
    damage: list[Damage] = []
    chain = Chain(Plan.of(session))
    view = JsonLinesView(typer.echo) if as_json else PlainView(typer.echo)
    replay_into(chain, session, damage, view.show)
    for one in damage:
        typer.echo(one.what, err=True)
    if not as_json:
        _tell(chain)


def _tell(chain: Chain) -> None:
    parts = chain.statistics
    samples, frames = sum(part.samples for part in parts), sum(part.frames for part in parts)
    lost = sum(part.samples_lost + part.losses_estimated for part in parts)
    bad, skipped = sum(part.frames_bad_checksum for part in parts), sum(part.bytes_skipped for part in parts)
    typer.echo(f"{samples} samples of {frames} frames; {lost} lost, {bad} with a bad checksum, {skipped} bytes skipped")
    if chain.finder is not None:
        found = chain.still_intervals()
        typer.echo(f"{len(found.observations)} still intervals, {len(found.refused)} refused")


def _replay_to_pty(session: Session, speed: float) -> None:
    """Send the bytes at the pace they were recorded with, from the moment a program opens the port."""
    from imufield.simulate.port import PseudoTerminal

    link = RecordingLink(session, pace=speed or None)
    port = PseudoTerminal()
    sent = 0
    try:
        typer.echo(f"waiting for a reader of {port.port}  (Ctrl-C ends)")
        while not port.has_reader():
            time.sleep(WAIT_S)
        while True:
            sent += _send(port, link.read())
    except EndOfRecordingError:
        typer.echo(f"{sent} bytes sent")
        time.sleep(LINGER_S)
    finally:
        port.close()


def _send(port: PseudoTerminal, chunk: Chunk | None) -> int:
    if chunk is None:
        return 0
    port.write(chunk.data)
    # As fast as possible means as fast as the reader takes it.
    while port.bytes_waiting and port.has_reader():
        time.sleep(SLOT_S)
        port.write(b"")
    return len(chunk.data)
