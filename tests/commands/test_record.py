"""``imufield record`` without a port: how long it goes on."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.instrument.connected import Connected, ConnectOptions
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.session import Session
from imufield.commands import record as module
from imufield.commands.options.samples import RecordOptions
from imufield.commands.record import run_record
from imufield.errors import LinkError, Reason
from imufield.pipeline.chain import session_samples
from imufield.samples import Status, concatenate


def chunk(number: int) -> Chunk:
    """Return line ``number`` of an instrument that prints ten a second, and arrives when it is printed."""
    return Chunk(f"{number / 10:.1f},0.0,0.0,9.8\n".encode(), number / 10, round(1e8 * number))


@dataclass
class Simulated:
    """A host whose time goes on while it reads: its clock, and the link to an instrument that starts late."""

    now_s: float
    first_s: float = 0.0
    name: str = "line"
    losses: list[str] = field(default_factory=list)

    def monotonic_s(self) -> float:
        return self.now_s

    def utc_ns(self) -> int:
        return round(1e9 * self.now_s)

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s

    def read(self) -> Chunk | None:
        self.now_s = round(self.now_s + 0.1, 6)
        return chunk(round(10 * self.now_s)) if self.now_s >= self.first_s else None

    def drain(self) -> list[Chunk]:
        return []

    def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("heard", "first_s", "wanted"),
    [
        pytest.param(11, 0.0, 50, id="a second was heard while connecting"),
        pytest.param(0, 0.0, 50, id="nothing was"),
        pytest.param(0, 4.0, 50, id="it starts late"),
        pytest.param(81, 0.0, 81, id="what was heard is longer, and kept"),
    ],
)
def test_the_duration_counts_from_the_first_bytes(
    heard: int, first_s: float, wanted: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = Simulated(max(heard - 1, 0) / 10, first_s)
    protocol = load_protocol("text", {"columns": "time,ax,ay,az", "rate_hz": 10})
    heard_chunks = [chunk(number) for number in range(heard)]
    connected = Connected(
        link=host,  # type: ignore[arg-type]
        protocol=protocol,
        driver="text",
        model="text",
        baud=9600,
        chunks=heard_chunks,
        identity={},
        wire="serial",
        instrument=None,
        rate_hz=None,
        rate_before_hz=None,
    )
    monkeypatch.setattr(module, "connect", lambda *_: connected)
    run_record(RecordOptions(connect=ConnectOptions(), session=tmp_path / "here", duration_s=5.0), host)
    samples = concatenate(list(session_samples(Session.open(tmp_path / "here"), [])))
    assert abs(len(samples) - wanted) <= 1


@dataclass
class Loose(Simulated):
    """The same, with a plug that is out from the second to the fifth second, or for good."""

    back_s: float = 5.0
    again: list[Chunk] = field(default_factory=list)

    def put_back(self, chunks: list[Chunk]) -> None:
        self.again += chunks

    def read(self) -> Chunk | None:
        got = self.again.pop(0) if self.again else super().read()
        if 2.0 < self.now_s < self.back_s:
            raise LinkError("line is gone", Reason.DISCONNECTED)
        return got

    def reopen(self) -> bool:
        return self.now_s >= self.back_s


def record_loose(host: Loose, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    protocol = load_protocol("text", {"columns": "time,ax,ay,az", "rate_hz": 10})
    connected = Connected(
        link=host,  # type: ignore[arg-type]
        protocol=protocol,
        driver="text",
        model="text",
        baud=9600,
        chunks=[],
        identity={},
        wire="serial",
        instrument=None,
        rate_hz=None,
        rate_before_hz=None,
    )
    monkeypatch.setattr(module, "connect", lambda *_: connected)
    run_record(RecordOptions(connect=ConnectOptions(), session=folder, duration_s=10.0), host)


def test_a_loose_plug_does_not_end_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record_loose(Loose(0.0), tmp_path / "here", monkeypatch)
    samples = concatenate(list(session_samples(Session.open(tmp_path / "here"), [])))
    steps_s = np.diff(samples.time_s)
    assert samples.time_s[-1] == pytest.approx(10.0, abs=0.2)
    assert steps_s.max() == pytest.approx(3.0, abs=0.5)
    after = samples.status[1:][steps_s > 1]
    assert (after & np.uint32(Status.AFTER_GAP | Status.GAP_ESTIMATED)).all()
    said = " ".join(capsys.readouterr().err.split())
    assert "line is gone; waiting until it is back" in said
    assert "the link is back" in said


def test_a_plug_that_stays_out_is_an_error_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LinkError, match="line is gone"):
        record_loose(Loose(0.0, back_s=1e9), tmp_path / "here", monkeypatch)
    assert len(concatenate(list(session_samples(Session.open(tmp_path / "here"), [])))) == pytest.approx(20, abs=2)
