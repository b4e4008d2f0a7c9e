"""Decodes a session; a long one in a process of its own, beside the one that asked.

Decoding takes as long as what is done with the samples, and two processes do both at once.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from typing import TYPE_CHECKING

import numpy as np

from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decoded_session import Step, decoded, recorded_protocol, session_blocks
from imufield.acquire.recording.reader import Damage, PartStart, size_bytes
from imufield.acquire.recording.session import Session
from imufield.acquire.session_decoder import SessionDecoder
from imufield.dataclass import dataclass
from imufield.errors import ImufieldError, RecordingError
from imufield.progress import done, task
from imufield.sentences import Sentences

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

sentence = Sentences(__package__)

LONG_BYTES = 1 << 26
"""Of a recording that is decoded in a process of its own. To start one takes as long as to decode a third of that."""

PIPE_BYTES = 1 << 20
"""Two steps of a usual instrument, and what Linux allows unless told otherwise (pipe(7), ``pipe-max-size``)."""

PROGRAM = "imufield.cli"
"""Module of the function ``main`` that the program's main module imports and calls."""


@dataclass(frozen=True, slots=True)
class _End:
    """What is sent behind the last step."""

    damage: list[Damage]
    statistics: list[DecoderStatistics]
    error: ImufieldError | None


def session_steps(session: Session, damage: list[Damage], decoder: SessionDecoder) -> Iterator[Step]:
    """Decode a session to its end, a long one in a process of its own.

    Parameters
    ----------
    session : Session
    damage : list of Damage
        Receives what could not be read, at the latest at the end.
    decoder : SessionDecoder
        Has the protocol of the part under way; its statistics are complete at the end.

    Raises
    ------
    RecordingError, ProtocolError
        If it cannot be read.
    """
    beside = _started(session) if size_bytes(session.parts) >= LONG_BYTES else None
    if beside is None:
        yield from _here(session, damage, decoder)
        return
    process, answers = beside
    try:
        with closing(answers):
            end = yield from _steps_of(answers, session, decoder)
    except EOFError as error:
        process.join()
        code = process.exitcode or 0
        if code > 0:  # Its traceback is told.
            raise RuntimeError("the process that decodes has failed") from error
        raise RecordingError(sentence("decoding_process.killed", folder=session.folder, signal=-code)) from error
    finally:
        process.kill()
        process.join()
    damage += end.damage
    decoder.statistics += end.statistics
    if end.error is not None:
        raise end.error


def _here(session: Session, damage: list[Damage], decoder: SessionDecoder) -> Iterator[Step]:
    yield from decoded(session_blocks(session, damage), session, decoder)
    yield Step(decoder.flush())


def _started(session: Session) -> tuple[BaseProcess, Connection] | None:
    """Start the process; None where it would gain nothing, or the system starts no more."""
    import multiprocessing.resource_tracker  # Late, as most recordings are short.

    from imufield.campaign import interrupts_held

    # A process of its own has this one where many sessions are read at once: the cores are busy.
    if (os.cpu_count() or 1) == 1 or multiprocessing.parent_process() is not None or not _is_program():
        return None
    context = multiprocessing.get_context("spawn")
    answers, end = context.Pipe(duplex=False)
    _widen(end)
    process = context.Process(target=_send, args=(session, end), daemon=True)
    with closing(end):
        try:
            if os.name == "posix":
                # Started below, it would let interrupts through to what is started next (CPython 3.11, ``ensure_running``).
                multiprocessing.resource_tracker.ensure_running()
            with interrupts_held():
                process.start()
        except OSError:
            answers.close()
            return None
    return process, answers


def _widen(end: Connection) -> None:
    """Make the pipe large enough for whole steps: with its usual 64 KiB the sender waits for the reader in each of them."""
    if sys.platform == "linux":
        import fcntl

        # Refused above the limit of one pipe, and of all pipes of the user.
        with suppress(OSError):
            fcntl.fcntl(end.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)


def _is_program() -> bool:
    """Whether the main module is imufield's own: the process imports it again, and somebody's script would run twice."""
    return getattr(getattr(sys.modules["__main__"], "program", None), "__module__", "") == PROGRAM


def _steps_of(answers: Connection, session: Session, decoder: SessionDecoder) -> Generator[Step, None, _End]:
    """Yield the steps that are sent and return what is sent behind them; EOFError where that does not come."""
    answer = _received(answers)
    with task("reading", 1.0) as reading:
        while not isinstance(answer, _End):
            step, reading.done = answer
            if isinstance(step.item, PartStart):
                decoder.protocol = recorded_protocol(step.item.metadata, session)
            yield step
            answer = _received(answers)
    return answer


def _received(answers: Connection) -> tuple[Step, float] | _End:
    try:
        head, sizes = answers.recv()
        arrays = [np.empty(size, dtype=np.uint8) for size in sizes]
        for array in arrays:
            answers.recv_bytes_into(array)
    except OSError as error:
        # In the middle of an answer.
        raise EOFError(str(error)) from error
    answer: tuple[Step, float] | _End = pickle.loads(head, buffers=arrays)  # noqa: S301  (of our own process)
    return answer


def _put(end: Connection, answer: tuple[Step, float] | _End) -> None:
    """Send an answer, its arrays as they lie in memory: inside the pickle they take three times as long."""
    arrays: list[pickle.PickleBuffer] = []
    head = pickle.dumps(answer, protocol=5, buffer_callback=arrays.append)
    contents = [array.raw() for array in arrays]
    end.send((head, [len(content) for content in contents]))
    for content in contents:
        end.send_bytes(content)


def _send(session: Session, end: Connection) -> None:
    """Send the steps of a session, each with the share that is read, and how it ended."""
    damage: list[Damage] = []
    decoder = SessionDecoder()
    error = None
    # Who has asked may read no more.
    with suppress(BrokenPipeError):
        try:
            for step in _here(session, damage, decoder):
                _put(end, (step, done()))
        except ImufieldError as raised:
            error = raised
        _put(end, _End(damage, decoder.statistics, error))
