"""``imufield record``: how long it goes on, and what it says of a link that is lost or silent."""

from __future__ import annotations

import json
import signal
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from imufield.acquire.instrument.connected import Connected, ConnectOptions
from imufield.acquire.link.serial import Chunk
from imufield.acquire.protocol.protocol import load_protocol
from imufield.acquire.recording.session import Session
from imufield.commands import record as module
from imufield.commands.options.acquire_commands import RecordOptions
from imufield.commands.record import run_record
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError
from imufield.pipeline.chain import session_samples
from imufield.pipeline.windows import RAMP
from imufield.samples import Status, concatenate
from imufield.sentences import Sentences
from tests.commands.conftest import SPEED, Program
from tests.commands.pty_terminal import Terminal
from tests.commands.told import says
from tests.refused import refused

sentence = Sentences("imufield.commands.terminal")
commands_sentence = Sentences("imufield.commands")


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


def connect_to(host: Simulated, columns: str, rate_hz: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command find a host that sends lines with these columns."""
    connected = Connected(
        link=host,  # type: ignore[arg-type]
        protocol=load_protocol("text", {"columns": columns, "rate_hz": rate_hz}),
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


def record_loose(host: Loose, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect_to(host, "time,ax,ay,az", 10, monkeypatch)
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


@dataclass
class ClockSet(Loose):
    """The same, whose computer has its clock set, an hour on or back, while the plug is out."""

    by_s: float = 3600.0

    def read(self) -> Chunk | None:
        got = super().read()
        moved_ns = round(1e9 * self.by_s) if self.now_s >= self.back_s else 0
        return None if got is None else replace(got, utc_ns=got.utc_ns + moved_ns)


@pytest.mark.parametrize("by_s", [3600.0, -3600.0])
def test_a_clock_that_is_set_while_the_plug_is_out_moves_no_sample(
    by_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_loose(ClockSet(0.0, by_s=by_s), tmp_path / "here", monkeypatch)
    samples = concatenate(list(session_samples(Session.open(tmp_path / "here"), [])))
    assert np.diff(samples.time_s).max() == pytest.approx(3.0, abs=0.5)
    assert samples.time_s[-1] == pytest.approx(10.0, abs=0.2)


def test_a_plug_that_stays_out_is_an_error_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LinkError, match="line is gone"):
        record_loose(Loose(0.0, back_s=1e9), tmp_path / "here", monkeypatch)
    assert len(concatenate(list(session_samples(Session.open(tmp_path / "here"), [])))) == pytest.approx(20, abs=2)


def line(number: int, temperature: str) -> Chunk:
    """Return a line of an instrument that prints one a second."""
    return Chunk(f"{number:.1f},0.01,0.02,9.8{temperature}\n".encode(), number, round(1e9 * number))


@dataclass
class Warming(Simulated):
    """A host with an instrument that warms by 1.5 degC/min from -10 to 10 degC, or sends no temperature."""

    is_told: bool = True

    def read(self) -> Chunk | None:
        self.now_s += 1.0
        degc = min(-10 + 1.5 * self.now_s / 60, 10.0)
        return line(round(self.now_s), f",{degc:.2f}" if self.is_told else "")


def record_ramp(host: Warming, folder: Path, monkeypatch: pytest.MonkeyPatch, *, as_json: bool = False) -> None:
    columns = "time,ax,ay,az,temperature" if host.is_told else "time,ax,ay,az"
    connect_to(host, columns, 1, monkeypatch)
    options = RecordOptions(connect=ConnectOptions(), session=folder, duration_s=1500.0, ramp=True, as_json=as_json)
    run_record(options, host)


def test_a_ramp_is_led_and_ends_with_what_comes_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record_ramp(Warming(0.0), tmp_path / "my ramp", monkeypatch)
    said = capsys.readouterr().out
    recorded = sentence("ramp.recorded", low=-9.9, high=10.0)
    assert recorded in said
    assert f"imufield solve SESSION --temperature '{tmp_path}/my ramp'" in said
    assert Session.open(tmp_path / "my ramp").record.kind == RAMP
    record_ramp(Warming(0.0), tmp_path / "json", monkeypatch, as_json=True)
    events = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    ramps = [event for event in events if event["event"] == "ramp"]
    assert len(ramps) >= 149
    assert sum(len(event["words"]) for event in ramps) == 3
    assert ramps[60]["degc_per_min"] == pytest.approx(1.5, abs=0.02)
    assert ramps[-1]["is_even"]


def test_a_ramp_without_temperature_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    host = Warming(0.0, is_told=False)
    with refused(UsageError, Reason.NOT_FINITE, key="ramp.no_temperature"):
        record_ramp(host, tmp_path / "cold", monkeypatch)
    assert host.now_s < 60


@dataclass
class Pausing(Simulated):
    """A host whose instrument says nothing from the third second on, and is not lost; until a second, or for good."""

    back_s: float = 1e9

    def read(self) -> Chunk | None:
        got = super().read()
        return None if 3.0 <= self.now_s < self.back_s else got


def record_pausing(host: Pausing, folder: Path, monkeypatch: pytest.MonkeyPatch, *, as_json: bool = False) -> None:
    connect_to(host, "time,ax,ay,az", 10, monkeypatch)
    run_record(RecordOptions(connect=ConnectOptions(), session=folder, duration_s=60.0, as_json=as_json), host)


def test_silence_is_said_while_it_lasts_and_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record_pausing(Pausing(0.0, back_s=43.0), tmp_path / "here", monkeypatch)
    said = capsys.readouterr()
    assert commands_sentence("record.silent", port="line") in said.err
    assert commands_sentence("record.data_again") in said.err
    assert commands_sentence("record.back") not in said.err, "it was never away"
    assert commands_sentence("record.pauses", pauses_s=40.0) in said.out
    record_pausing(Pausing(0.0, back_s=43.0), tmp_path / "json", monkeypatch, as_json=True)
    *progress, last = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    pauses_s = [event["pause_s"] for event in progress]
    assert max(pauses_s) == pytest.approx(40.0, abs=1.1)
    assert pauses_s.count(0.0) == pytest.approx(20, abs=2)
    assert last["pauses_s"] == pytest.approx(40.0, abs=0.2)


def test_a_recording_that_ends_in_silence_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with refused(LinkTimeoutError, Reason.SILENCE, "line", key="record.ended_silent"):
        record_pausing(Pausing(0.0), tmp_path / "here", monkeypatch)
    session = Session.open(tmp_path / "here")
    assert session.finished
    assert len(concatenate(list(session_samples(session, [])))) == pytest.approx(30, abs=2)


@dataclass
class Overheard(Simulated):
    """A host with an instrument of which only others are heard from the third second on; until a second, or for good."""

    back_s: float = 1e9

    def read(self) -> Chunk | None:
        got = super().read()
        return got if got is None or not 3.0 <= self.now_s < self.back_s else Chunk(b"others\n", got.monotonic_s, got.utc_ns)


def test_a_recording_at_whose_end_only_others_sent_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = Overheard(0.0)
    connect_to(lost, "time,ax,ay,az", 10, monkeypatch)
    options = RecordOptions(connect=ConnectOptions(), session=tmp_path / "here", duration_s=60.0)
    with refused(LinkTimeoutError, Reason.NO_FRAMES, "line", key="record.ended_unread") as caught:
        run_record(options, lost)
    assert caught.value.values["unread_s"] == pytest.approx(57.0, abs=1.0)
    assert commands_sentence("record.unread", port="line") in capsys.readouterr().err
    host = Overheard(0.0, back_s=40.0)
    connect_to(host, "time,ax,ay,az", 10, monkeypatch)
    run_record(replace(options, session=tmp_path / "back"), host)
    said = capsys.readouterr().err
    assert commands_sentence("record.unread", port="line") in said
    assert commands_sentence("record.samples_again") in said
    assert commands_sentence("record.back") not in said, "it was never away"


def test_silence_puts_no_empty_line_into_what_a_program_reads_on_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    record_pausing(Pausing(0.0, back_s=43.0), tmp_path / "json", monkeypatch, as_json=True)
    assert all(json.loads(line) for line in capsys.readouterr().out.splitlines())


def test_an_instrument_that_stops_is_missed_on_the_terminal(program: Program) -> None:
    port = program.emulate()
    options = ("--driver", "stim300", "--clock-speed", SPEED, "--duration-s", 10 * SPEED, "--session", "mine")
    with closing(Terminal(program, "record", "--port", port, *options)) as terminal:
        terminal.expect("(Ctrl-C ends)")
        program.started[0].send_signal(signal.SIGSTOP)
        terminal.expect(commands_sentence("record.silent", port=port).split(":")[0])
        terminal.expect("NO DATA for")
        assert terminal.wait() == 3
        assert any(says(terminal.text, "commands", "record.pauses", pauses_s=pause_s) for pause_s in range(200))
