"""``probe`` and connecting without a driver, on real pseudo-terminals; which have no bit rate to get wrong."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

from imufield.acquire.host_clock import SystemClock
from imufield.acquire.session import Session
from imufield.commands.connect import ConnectOptions, check_capacity, connect
from imufield.commands.listen import SILENT_S, SILENT_TRY_S, search, serial_candidates
from imufield.commands.probe import probe_port
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError
from imufield.simulate.instrument_microstrain import MicroStrainInstrument
from imufield.simulate.instrument_vectornav import VectorNavInstrument
from imufield.simulate.instrument_witmotion import WitMotionInstrument
from imufield.simulate.instrument_xsens import XsensInstrument
from imufield.simulate.instruments import InstrumentOnPort, ScriptedInstrument
from imufield.simulate.port import PseudoTerminal
from tests.acquire.streams import INSTRUMENTS as STREAMS

if TYPE_CHECKING:
    from tests.commands.conftest import Program

INSTRUMENTS: dict[str, Callable[[], ScriptedInstrument]] = {
    "xsens_mtdata2": XsensInstrument,
    "vectornav_ascii": lambda: VectorNavInstrument(binary=False),
    "microstrain_mip": MicroStrainInstrument,
    "witmotion": WitMotionInstrument,
}


class Listening(XsensInstrument):
    """Counts what it hears."""

    heard_bytes = 0

    def hear(self, data: bytes) -> bytes:
        self.heard_bytes += len(data)
        return super().hear(data)


@contextmanager
def sending(data: bytes) -> Iterator[str]:
    """Send the same bytes again and again, a hundred times a second."""
    terminal, stopping = PseudoTerminal(), threading.Event()

    def run() -> None:
        while not stopping.wait(0.01):
            terminal.write(data)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield terminal.port
    finally:
        stopping.set()
        thread.join()
        terminal.close()


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_an_instrument_is_found_with_its_command_line(name: str) -> None:
    with InstrumentOnPort(INSTRUMENTS[name]()) as there:
        found = probe_port(there.port, None, SystemClock(), ask=True)
    assert found.found is not None, found.error
    assert found.found.name == name
    assert found.command == f"imufield capture --port {there.port} --driver {name}"
    assert found.identity["serial_number"]
    assert there.instrument.streaming
    assert there.instrument.memory_writes == []


class Playback(ScriptedInstrument):
    """Sends what an instrument sends, and hears nothing."""

    def __init__(self, name: str) -> None:
        _, rate_hz, self._sample = STREAMS[name]
        super().__init__(rate_hz)

    def sample(self, number: int, time_s: float) -> bytes:
        return self._sample(number, time_s)

    def _cut(self, heard: bytes) -> tuple[bytes | None, bytes]:
        return None, b""

    def _answer(self, command: bytes) -> bytes:
        return b""


@pytest.mark.parametrize("name", STREAMS)
def test_every_protocol_is_found_on_a_port(name: str) -> None:
    with InstrumentOnPort(Playback(name)) as there:
        found = probe_port(there.port, None, SystemClock())
    assert found.found is not None, [(one.name, one.reason) for one in found.others]
    assert found.found.name == STREAMS[name][0]
    assert not any(other.found for other in found.others)


def test_nothing_is_sent_unless_asked_to() -> None:
    instrument = Listening()
    with InstrumentOnPort(instrument) as there:
        assert probe_port(there.port, None, SystemClock()).identity == {}
        assert instrument.heard_bytes == 0
        assert probe_port(there.port, 115200, SystemClock(), ask=True).command.endswith("--baud 115200")
        assert instrument.heard_bytes > 0


def test_silence_and_noise_are_told_apart() -> None:
    terminal = PseudoTerminal()
    silent = probe_port(terminal.port, None, SystemClock())
    terminal.close()
    assert silent.error is not None
    assert (silent.found, silent.error.reason) == (None, Reason.SILENCE)
    with sending(b"\x55\x51\xfa\xff\x36 noise") as port:
        noisy = probe_port(port, None, SystemClock())
    assert noisy.error is not None
    assert (noisy.found, noisy.error.reason) == (None, Reason.NO_FRAMES)
    assert noisy.command == ""


def test_several_bit_rates_are_tried_on_a_port_that_stays_open() -> None:
    candidates = serial_candidates()
    with InstrumentOnPort(XsensInstrument()) as there:
        found = search(there.port, candidates, [9600, 115200, 921600], SystemClock())
        try:
            # A WitMotion alone is sought at the first of these; a pseudo-terminal would hand on anything.
            assert [one.baud for one in found.hearings][-1] == 115200
            assert found.found is not None
            assert found.found.candidate.name == "xsens_mtdata2"
            assert found.link.settings.baud == 115200
        finally:
            found.link.close()


def test_a_silent_port_is_given_up_early() -> None:
    terminal, clock = PseudoTerminal(), SystemClock()
    begin_s = clock.monotonic_s()
    found = search(terminal.port, serial_candidates(), [115200, 9600, 921600], clock)
    found.link.close()
    terminal.close()
    assert len(found.hearings) == 3
    assert clock.monotonic_s() - begin_s >= SILENT_S + 2 * SILENT_TRY_S


def test_the_command(program: Program) -> None:
    with InstrumentOnPort(VectorNavInstrument()) as there:
        result = program.run("probe", "--port", there.port, "--ask", "--json")
        assert result.returncode == 0, result.stderr
        (port,) = json.loads(result.stdout)["ports"]
        assert port["found"]["name"] == "vectornav_binary"
        assert port["found"]["frames_bad_checksum"] == 0
        assert port["found"]["checksum_ratio"] == 1.0
        assert port["found"]["rate_hz"] == pytest.approx(100, rel=0.2)
        assert port["identity"]["model"] == "VN-100T-CR"
        words = program.run("probe", "--port", there.port)
        assert words.returncode == 0
        assert f"imufield capture --port {there.port} --driver vectornav_binary" in words.stdout
    gone = program.run("probe", "--port", "/dev/nowhere", "--json")
    assert gone.returncode == 3
    assert json.loads(gone.stdout)["ports"][0]["error"]["reason"] == "port_not_found"
    assert "/dev/nowhere" in gone.stderr
    said_once = program.run("probe", "--port", "/dev/nowhere")
    assert (said_once.stdout + said_once.stderr).count("/dev/nowhere does not exist") == 1


@pytest.mark.parametrize("end", [signal.SIGINT, None])
def test_the_rate_is_put_back_however_a_recording_ends(end: signal.Signals | None, program: Program) -> None:
    instrument = MicroStrainInstrument()
    before = list(instrument.format)
    with InstrumentOnPort(instrument) as there:
        duration = () if end is not None else ("--duration-s", 1)
        process = program.start("record", "--port", there.port, "--session", "here", "--rate-hz", 250, "--json", *duration)
        assert process.stdout is not None
        deadline_s = time.monotonic() + 60
        while instrument.rate_hz != 250 and time.monotonic() < deadline_s:
            time.sleep(0.02)
        assert instrument.rate_hz == 250
        process.stdout.readline()
        if end is not None:
            process.send_signal(end)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == (0 if end is None else 130), errors
        assert instrument.format == before
        assert instrument.streaming
        assert instrument.memory_writes == []
    session = Session.open(program.folder / "here")
    assert session.metadata["link"]["rate_hz"] == 250
    assert session.metadata["link"]["rate_before_hz"] == 100
    assert session.metadata["instrument"]["serial_number"] == "6251.123456"
    assert "250 Hz" in errors
    assert "experimental" in errors


def test_a_rate_that_cannot_be_set_is_refused_before_a_session_is_made(program: Program) -> None:
    with InstrumentOnPort(XsensInstrument()) as there:
        refused = program.run("record", "--port", there.port, "--session", "here", "--rate-hz", 50)
        assert refused.returncode == 2
        assert "never writes" in refused.stderr
        assert not (program.folder / "here").exists()
        assert there.instrument.streaming


def connected(port: str, **options: Any) -> Any:
    said: list[str] = []
    return connect(ConnectOptions(port=port, **options), SystemClock(), say=said.append), said


def test_a_silent_instrument_is_told_to_send_and_left_silent() -> None:
    instrument = XsensInstrument()
    instrument.streaming = False
    with InstrumentOnPort(instrument) as there:
        found, said = connected(there.port, driver="xsens_mtdata2")
        assert found.identity["serial_number"] == "0368248C"
        assert any("was told to send" in one for one in said)
        assert instrument.streaming
        found.close()
        assert not instrument.streaming


class Stubborn(MicroStrainInstrument):
    """Takes every rate, and sends no faster than 100 Hz."""

    def _settings(self, number: int, data: bytes) -> bytes:
        answer = super()._settings(number, data)
        self.format = [(one, max(decimation, 10)) for one, decimation in self.format]
        return answer


def test_a_rate_that_was_not_taken_is_an_error_and_all_is_as_before() -> None:
    instrument = Stubborn(50)
    before = list(instrument.format)
    with InstrumentOnPort(instrument) as there:
        with pytest.raises(LinkError, match="set to 500 Hz and says it is at 100 Hz") as error:
            connected(there.port, rate_hz=500)
        assert error.value.reason is Reason.REFUSED
        assert instrument.format == before
        assert instrument.streaming


def test_what_cannot_be_put_back_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with InstrumentOnPort(WitMotionInstrument()) as there:
        found, _ = connected(there.port, rate_hz=100)
    found.close()
    assert "not put back" in capsys.readouterr().err


def test_a_protocol_file_knows_no_commands() -> None:
    with InstrumentOnPort(XsensInstrument()) as there, pytest.raises(UsageError, match="protocol file"):
        connected(there.port, protocol="xsens_mtdata2", rate_hz=50)


def test_a_rate_that_the_wire_cannot_carry() -> None:
    with InstrumentOnPort(XsensInstrument()) as there:
        found = search(there.port, serial_candidates(), [115200], SystemClock())
        found.link.close()
    assert found.found is not None
    check_capacity(found.found, 100, 115200)
    # 54 bytes of 10 bits and a tenth to spare: 115200 bit/s carry 194 a second, the cut first frame aside.
    with pytest.raises(UsageError, match=r"1[89]\d such samples"):
        check_capacity(found.found, 200, 115200)


def test_what_is_given_but_not_there_is_named() -> None:
    with sending(b"12 hello\r\n") as port, pytest.raises(LinkError) as error:
        connected(port, driver="stim300")
    assert error.value.reason is Reason.NO_FRAMES
    assert not isinstance(error.value, LinkTimeoutError)
