"""Decodes a session; a long one in a process of its own, beside the one that asked.

Decoding takes as long as what is done with the samples, and two processes do both at once. The steps come through a pipe in
Python's own format, which is safe from a process that we have started.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decoded_session import Step, decoded, recorded_protocol, session_blocks
from imufield.acquire.recording.reader import Damage, PartStart, size_bytes
from imufield.acquire.recording.session import Session
from imufield.acquire.session_decoder import SessionDecoder
from imufield.errors import ImufieldError, RecordingError
from imufield.progress import done, task
from imufield.sentences import Sentences

sentence = Sentences(__package__)

LONG_BYTES = 1 << 26
"""From this size on a recording has a process of its own, whose start takes as long as decoding a third of that."""


def session_steps(session: Session, damage: list[Damage], decoder: SessionDecoder) -> Iterator[Step]:
    """Decode a session to its end, a long one in a process of its own.

    Parameters
    ----------
    session : Session
    damage : list of Damage
        Receives what could not be read.
    decoder : SessionDecoder
        Has the protocol of the part under way; its statistics are complete at the end.

    Raises
    ------
    RecordingError, ProtocolError
        If it cannot be read.
    """
    is_long = size_bytes(session.parts) >= LONG_BYTES
    return (_beside if is_long and (os.cpu_count() or 1) > 1 else _here)(session, damage, decoder)


def _here(session: Session, damage: list[Damage], decoder: SessionDecoder) -> Iterator[Step]:
    yield from decoded(session_blocks(session, damage), session, decoder)
    yield Step(decoder.flush())


def _beside(session: Session, damage: list[Damage], decoder: SessionDecoder) -> Iterator[Step]:
    with _asked(session) as process, cast("BinaryIO", process.stdout) as answers, task("reading", 1.0) as reading:
        try:
            while not isinstance(answer := pickle.load(answers), _End):  # noqa: S301  (of our own process)
                step, reading.done = answer
                if isinstance(step.item, PartStart):
                    decoder.protocol = recorded_protocol(step.item.metadata, session)
                yield step
        except (EOFError, pickle.UnpicklingError) as error:
            raise RecordingError(sentence("decoding_process.ended", folder=session.folder, code=process.wait())) from error
        finally:
            process.kill()
    damage += answer.damage
    decoder.statistics += answer.statistics
    if answer.error is not None:
        raise answer.error


def _asked(session: Session) -> subprocess.Popen[bytes]:
    """Start the program, which finds imufield where this process found it."""
    command = [sys.executable, "-P", "-c", f"from {__name__} import main; main()", str(session.folder)]
    found = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(  # noqa: S603  (our own program)
        command,
        env=found,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        # Ctrl-C is for this process, and the other ends when nobody reads any more.
        start_new_session=True,
    )


@dataclass(frozen=True, slots=True)
class _End:
    """What is sent behind the last step."""

    damage: list[Damage]
    statistics: list[DecoderStatistics]
    error: ImufieldError | None


def main() -> None:
    """Send the steps of a session, each with the share that is read, and how it ended."""
    with suppress(BrokenPipeError):
        for answer in _answers(Session.open(Path(sys.argv[1]))):
            pickle.dump(answer, sys.stdout.buffer, pickle.HIGHEST_PROTOCOL)
        sys.stdout.flush()


def _answers(session: Session) -> Iterator[tuple[Step, float] | _End]:
    damage: list[Damage] = []
    decoder = SessionDecoder()
    error = None
    try:
        for step in _here(session, damage, decoder):
            yield step, done()
    except ImufieldError as raised:
        error = raised
    yield _End(damage, decoder.statistics, error)
