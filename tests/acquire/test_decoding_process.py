"""A process that decodes beside this one gives what this one would: samples, events, losses, damage and errors."""

from __future__ import annotations

import dataclasses
import inspect
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Generator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import cast

import numpy as np
import pytest

import imufield.cli
from imufield.acquire import decoding_process
from imufield.acquire.decode.statistics import DecoderStatistics
from imufield.acquire.decoded_session import UNPLUGGED, Step, recorded_protocol
from imufield.acquire.decoding_process import session_steps
from imufield.acquire.link.chunk import Chunk
from imufield.acquire.recording.reader import Damage, read_part
from imufield.acquire.recording.recorder import Recorder, part_metadata
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.acquire.session_decoder import SessionDecoder
from imufield.errors import ImufieldError, Reason, RecordingError
from imufield.pipeline.chain import session_samples
from imufield.samples import Samples
from tests.commands.conftest import LONGEST_S, simulated_session
from tests.refused import refused
from tests.told import key_of

CHUNKS = 200
PAGE_BYTES = 4096
"""The least that a pipe holds: far less than the session."""


@pytest.fixture
def session(tmp_path: Path) -> Session:
    """Return a session of two parts; the second is unplugged in its middle and has lost its end."""
    session = simulated_session(tmp_path / "here", "faces6")
    chunks = list(islice((item for item in read_part(session.parts[0]) if isinstance(item, Chunk)), CHUNKS))
    with Recorder(session.add_part(), part_metadata(recorded_protocol({}, session), session.record.setting_values)) as recorder:
        for number, chunk in enumerate(chunks):
            if number == CHUNKS // 2:
                recorder.write_event({"event": UNPLUGGED})
            recorder.write_chunk(chunk)
    part = session.parts[-1]
    part.write_bytes(part.read_bytes()[:-8])
    return session


def as_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this process pass for the program on a machine of two cores."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(sys.modules["__main__"], "program", imufield.cli.program, raising=False)


@dataclass
class Outcome:
    """All that a reading gives."""

    steps: list[Step]
    damage: list[Damage]
    statistics: list[DecoderStatistics]
    error: ImufieldError | None = None


def read(session: Session, monkeypatch: pytest.MonkeyPatch, long_bytes: int) -> Outcome:
    monkeypatch.setattr(decoding_process, "LONG_BYTES", long_bytes)
    as_program(monkeypatch)
    decoder, outcome = SessionDecoder(), Outcome([], [], [])
    try:
        outcome.steps += session_steps(session, outcome.damage, decoder)
    except ImufieldError as error:
        outcome.error = error
    outcome.statistics = decoder.statistics
    assert decoder.protocol.units == recorded_protocol({}, session).units
    return outcome


def arrays(samples: Samples | None) -> list[bytes]:
    values = [] if samples is None else [getattr(samples, field.name) for field in dataclasses.fields(samples)]
    return [value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode() for value in values]


def both(session: Session, monkeypatch: pytest.MonkeyPatch) -> Outcome:
    """Read here and beside, compare all, and return one of them."""
    here, beside = (read(session, monkeypatch, long_bytes) for long_bytes in (1 << 40, 0))
    assert [(step.item, step.is_anew, arrays(step.samples)) for step in here.steps] == [
        (step.item, step.is_anew, arrays(step.samples)) for step in beside.steps
    ]
    # What comes across belongs to who receives it.
    assert all(step.samples.time_s.flags.writeable for step in beside.steps if step.samples is not None)
    assert (here.damage, here.statistics) == (beside.damage, beside.statistics)
    if here.error is not None:
        assert (type(here.error), here.error.reason, here.error.values, here.error.message) == (
            type(beside.error),
            beside.error.reason,
            beside.error.values,
            beside.error.message,
        )
        assert key_of(here.error.message) == key_of(beside.error.message)
    return beside


def test_both_ways_give_the_same(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = both(session, monkeypatch)
    assert outcome.error is None
    assert len(outcome.damage) == 1
    assert len(outcome.statistics) == 3
    assert sum(step.is_anew for step in outcome.steps) == 1


def test_an_error_comes_across_with_its_values(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    protocol = load_driver("stim300").load_protocol({"rate_hz": 125.0, "gyroscope_output": "increment"})
    with Recorder(session.add_part(), part_metadata(protocol, {})):
        pass
    error = both(session, monkeypatch).error
    assert error is not None
    assert error.reason is Reason.UNITS


@pytest.fixture
def steps(session: Session, monkeypatch: pytest.MonkeyPatch) -> Generator[Step]:
    """Return the steps of a process that has sent its first, and waits with the others until they are read."""
    monkeypatch.setattr(decoding_process, "LONG_BYTES", 0)
    monkeypatch.setattr(decoding_process, "PIPE_BYTES", PAGE_BYTES)
    as_program(monkeypatch)
    sent = cast("Generator[Step]", session_steps(session, [], SessionDecoder()))
    next(sent)
    assert len(multiprocessing.active_children()) == 1
    return sent


def test_who_stops_reading_leaves_no_process(steps: Generator[Step]) -> None:
    steps.close()
    assert not multiprocessing.active_children()


def test_a_process_that_is_killed_is_told(session: Session, steps: Generator[Step]) -> None:
    multiprocessing.active_children()[0].kill()
    with refused(RecordingError, Reason.DAMAGED, str(session.folder), "signal 9", key="decoding_process.killed"):
        list(steps)


def test_a_defect_in_it_is_one_here(
    session: Session, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(decoding_process, "_send", "nothing that can be called")
    monkeypatch.setattr(decoding_process, "LONG_BYTES", 0)
    as_program(monkeypatch)
    with pytest.raises(RuntimeError):
        list(session_steps(session, [], SessionDecoder()))
    assert "TypeError" in capfd.readouterr().err


@pytest.mark.parametrize(
    "place", ["multiprocessing.process.BaseProcess.start", "multiprocessing.resource_tracker.ensure_running"]
)
def test_where_no_process_starts_this_one_decodes(session: Session, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    here = read(session, monkeypatch, 1 << 40)
    monkeypatch.setattr(place, lambda *_: os.close(-1))
    assert len(read(session, monkeypatch, 0).steps) == len(here.steps)


@pytest.mark.parametrize("from_file", [True, False])
def test_a_script_of_somebody_runs_once(session: Session, tmp_path: Path, *, from_file: bool) -> None:
    """Without the usual guard, or from standard input: a process that is spawned would run it again."""
    script = (
        "from imufield.acquire import decoding_process\n"
        "from imufield.cli import main\n"
        "from imufield.acquire.recording.session import Session\n"
        "from imufield.pipeline.chain import session_samples\n"
        "decoding_process.LONG_BYTES = 0\n"
        f"print(sum(map(len, session_samples(Session.open({str(session.folder)!r}), []))))\n"
    )
    path = tmp_path / "script.py"
    path.write_text(script)
    command = [sys.executable, str(path) if from_file else "-"]
    ended = subprocess.run(command, input=script, capture_output=True, text=True, timeout=LONGEST_S, check=True)
    assert ended.stdout.split() == [str(sum(map(len, session_samples(session, []))))]


def test_a_process_hears_no_interrupt(session: Session, tmp_path: Path) -> None:
    """Ctrl-C goes to all processes of a terminal, and this one would have a traceback to show; the program ends it."""
    # In a process whose first it is: something of multiprocessing starts with it.
    script = f"""
        import multiprocessing, os, signal
        from imufield.acquire import decoding_process
        from imufield.acquire.recording.session import Session
        from imufield.cli import program
        from imufield.pipeline.chain import session_samples

        if __name__ == "__main__":
            decoding_process.LONG_BYTES, decoding_process.PIPE_BYTES = 0, {PAGE_BYTES}
            blocks = session_samples(Session.open({str(session.folder)!r}), [])
            count = len(next(blocks))
            (process,) = multiprocessing.active_children()
            os.kill(process.pid, signal.SIGINT)
            print(count + sum(map(len, blocks)))
    """
    path = tmp_path / "script.py"
    path.write_text(inspect.cleandoc(script))
    ended = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=LONGEST_S, check=False)
    assert (ended.stdout.split(), ended.returncode) == ([str(sum(map(len, session_samples(session, []))))], 0), ended.stderr
