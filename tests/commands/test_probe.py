"""``probe`` and connecting without a driver, on real pseudo-terminals; which have no baud rate to get wrong."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imufield.acquire.decoder import Decoder
from imufield.acquire.instrument.baud_search import SILENT_S, SILENT_TRY_S, search, serial_candidates
from imufield.acquire.instrument.connect import check_capacity, connect
from imufield.acquire.instrument.connected import ConnectOptions, ask_identity
from imufield.acquire.instrument.instrument import Instrument
from imufield.acquire.link.host_clock import ScaledClock, SystemClock
from imufield.acquire.link.serial import Chunk, Link, open_link
from imufield.acquire.recording.session import Session
from imufield.acquire.registry import load_driver
from imufield.commands.probe import probe_port
from imufield.errors import LinkError, LinkTimeoutError, Reason, UsageError
from imufield.samples import Samples
from imufield.simulate.emulator.emulate import SCRIPTS, Emulation, choose_wire, make_emulator, make_virtual_imu
from imufield.simulate.emulator.port import PseudoTerminal
from imufield.simulate.emulator.serial import Emulator
from imufield.simulate.instruments.device import Answer, Device, Frames
from imufield.simulate.instruments.microstrain import MicroStrainInstrument
from imufield.simulate.instruments.protocol_device import ProtocolDevice
from tests.acquire.streams import INSTRUMENTS as STREAMS
from tests.commands.told import missing

if TYPE_CHECKING:
    from tests.commands.conftest import Program

INSTRUMENTS = (*SCRIPTS, "stim300")


def emulated(name: str, rate_hz: float | None = None, form: str | None = None) -> Emulator:
    emulator = make_emulator(Emulation(device=name, rate_hz=rate_hz, form=form))
    assert isinstance(emulator, Emulator)
    return emulator


def script_of(emulator: Emulator) -> Any:
    assert isinstance(emulator.device, ProtocolDevice)
    return emulator.device.script


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
        yield terminal.address
    finally:
        stopping.set()
        thread.join()
        terminal.close()


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_an_instrument_is_found_with_its_command_line(name: str) -> None:
    with emulated(name) as there:
        found = probe_port(there.port, None, SystemClock(), ask=True)
        assert there.device.streaming
    assert found.found is not None, found.error
    assert found.found.name == name
    assert found.command == f"imufield capture --port {there.port} --driver {name}"
    # A WitMotion has no register of its model.
    assert found.identity.keys() >= {"serial_number", "firmware", *(() if name == "witmotion" else ("model",))}
    assert there.device.memory_writes == []  # type: ignore[attr-defined]  # each of these has it


class Playback(Device):
    """Sends what an instrument sends, and hears nothing."""

    def __init__(self, name: str) -> None:
        _, _, self._sample = STREAMS[name]

    def encode(self, samples: Samples) -> Frames:
        parts = [self._sample(int(number), time_s) for number, time_s in zip(samples.counter, samples.time_s, strict=True)]
        ends = np.cumsum([len(part) for part in parts], dtype=np.int64)
        return Frames(np.frombuffer(b"".join(parts), dtype=np.uint8), ends, ends - 1)

    def jump_counter(self, by: int) -> None:
        """Have none."""


@pytest.mark.parametrize("name", STREAMS)
def test_every_protocol_is_found_on_a_port(name: str) -> None:
    rate_hz = STREAMS[name][1]
    with Emulator(Playback(name), make_virtual_imu(Emulation(rate_hz=rate_hz))) as there:
        found = probe_port(there.port, None, SystemClock())
    assert found.found is not None, [(one.name, one.reason) for one in found.others]
    assert found.found.name == STREAMS[name][0]
    assert not any(other.found for other in found.others)


def test_nothing_is_sent_unless_asked_to() -> None:
    there = emulated("xsens_mtdata2")
    heard: list[bytes] = []
    hear = there.device.receive
    there.device.receive = lambda data: (heard.append(data), hear(data))[1]  # type: ignore[func-returns-value,method-assign]
    with there:
        assert probe_port(there.port, None, SystemClock()).identity == {}
        assert b"".join(heard) == b""
        assert probe_port(there.port, 115200, SystemClock(), ask=True).command.endswith("--baud 115200")
        assert b"".join(heard)


def test_silence_and_noise_are_told_apart() -> None:
    terminal = PseudoTerminal()
    silent = probe_port(terminal.address, None, SystemClock())
    terminal.close()
    assert silent.error is not None
    assert (silent.found, silent.error.reason) == (None, Reason.SILENCE)
    with sending(b"\x55\x51\xfa\xff\x36 noise") as port:
        noisy = probe_port(port, None, SystemClock())
    assert noisy.error is not None
    assert (noisy.found, noisy.error.reason) == (None, Reason.NO_FRAMES)
    assert noisy.command == ""


def test_frames_without_samples_are_named_on_a_port(program: Program) -> None:
    # What a receiver sends whose corrected data are logged, and not the raw ones.
    with emulated("novatel_oem7", form="IMURATECORRIMUS") as there:
        port = there.port
        error = probe_port(port, None, SystemClock()).error
        assert error is not None
        assert getattr(error.message, "key", "") == "baud_search.without_samples"
        assert not missing(error.message, port, " IMURATECORRIMUS)", "RAWIMUSX")
        for command in ("record", "capture"):
            ended = program.run(command, "--port", port, "--driver", "novatel_oem7", "--session", "mine")
            assert (ended.returncode, missing(ended.stderr, "IMURATECORRIMUS", "RAWIMUSX")) == (3, [])
        given = ("--port", port, "--driver", "novatel_oem7", "--set", "imu=corrected", "--session", "mine")
        refused = program.run("capture", *given, "--latitude", "48")
        assert (refused.returncode, missing(refused.stderr, "RAWIMUSX")) == (6, [])
        assert not (program.folder / "mine").exists()
        recorded = program.run("record", *given, "--duration-s", "0.5")
        assert (recorded.returncode, missing(recorded.stderr, "RAWIMUSX")) == (0, [])


def test_several_bit_rates_are_tried_on_a_port_that_stays_open() -> None:
    candidates = serial_candidates()
    with emulated("xsens_mtdata2") as there:
        found = search(there.port, candidates, [9600, 115200, 921600], SystemClock())
        try:
            # A WitMotion alone is sought at the first of these; a pseudo-terminal would hand on anything.
            assert [one.baud for one in found.hearings][-1] == 115200
            assert found.recognised is not None
            assert found.recognised.candidate.name == "xsens_mtdata2"
            assert found.link.settings.baud == 115200
        finally:
            found.link.close()


def test_a_silent_port_is_given_up_early() -> None:
    terminal, clock = PseudoTerminal(), SystemClock()
    begin_s = clock.monotonic_s()
    found = search(terminal.address, serial_candidates(), [115200, 9600, 921600], clock)
    found.link.close()
    terminal.close()
    assert len(found.hearings) == 3
    assert clock.monotonic_s() - begin_s >= SILENT_S + 2 * SILENT_TRY_S


def test_the_command(program: Program) -> None:
    with emulated("vectornav_binary", 100) as there:
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
        # Another form of it is no other instrument.
        assert "not         vectornav_binary" not in words.stdout
        assert "--latitude DEGREES" in words.stdout
        assert "DEGREES" not in port["command"]
    gone = program.run("probe", "--port", "/dev/nowhere", "--json")
    assert gone.returncode == 3
    assert json.loads(gone.stdout)["ports"][0]["error"]["reason"] == "port_not_found"
    assert "/dev/nowhere" in gone.stderr
    said_once = program.run("probe", "--port", "/dev/nowhere")
    assert (said_once.stdout + said_once.stderr).count("/dev/nowhere does not exist") == 1


@pytest.mark.parametrize("end", [signal.SIGINT, None])
def test_the_rate_is_put_back_however_a_recording_ends(end: signal.Signals | None, program: Program) -> None:
    there = emulated("microstrain_mip", 100, "gps_time")
    instrument = script_of(there)
    before = list(instrument.format)
    with there:
        duration = () if end is not None else ("--duration-s", 1)
        process = program.start("record", "--port", there.port, "--session", "here", "--rate-hz", 250, "--json", *duration)
        assert process.stdout is not None
        deadline_s = time.monotonic() + 120
        while instrument.rate_hz != 250 and time.monotonic() < deadline_s:
            time.sleep(0.02)
        assert instrument.rate_hz == 250
        process.stdout.readline()
        if end is not None:
            process.send_signal(end)
        _, errors = process.communicate(timeout=900)
        assert process.returncode == (0 if end is None else 130), errors
        assert instrument.format == before
        assert instrument.streaming
        assert instrument.memory_writes == []
    session = Session.open(program.folder / "here")
    assert session.metadata["link"]["rate_hz"] == 250
    assert session.metadata["link"]["rate_before_hz"] == 100
    assert session.metadata["instrument"]["serial_number"] == "6251.123456"
    assert "250 Hz" in errors
    assert "never tried on a real instrument" in errors


def test_a_rate_that_cannot_be_set_is_refused_before_a_session_is_made(program: Program) -> None:
    with emulated("xsens_mtdata2") as there:
        refused = program.run("record", "--port", there.port, "--session", "here", "--rate-hz", 50)
        assert refused.returncode == 2
        assert "never writes" in refused.stderr
        assert not (program.folder / "here").exists()
        assert there.device.streaming


def connected(port: str, **options: Any) -> Any:
    said: list[str] = []
    return connect(ConnectOptions(port=port, **options), SystemClock(), say=said.append), said


def test_a_silent_instrument_is_told_to_send_and_left_silent() -> None:
    there = emulated("xsens_mtdata2")
    instrument = script_of(there)
    instrument.streaming = False
    with there:
        found, said = connected(there.port, driver="xsens_mtdata2")
        assert found.identity["serial_number"] == "0368248C"
        assert any("its output was started" in one for one in said)
        assert instrument.streaming
        found.close()
        assert not instrument.streaming


def test_increments_are_read_at_the_rate_that_was_set() -> None:
    settings = {"output": "increment", "rate_hz": "100"}
    with emulated("microstrain_mip", 100, "increments") as there:
        found, _ = connected(there.port, driver="microstrain_mip", settings=settings, rate_hz=250)
        assert found.protocol.settings["rate_hz"].value == 250
        assert found.protocol.units.interval_s == 1 / 250
        found.close()
        assert there.device.rate_hz == 100


RATES = {
    "aceinna_serial": (100, 200),
    "microstrain_mip": (500, 250),
    "stim300": (500, 250),
    "vectornav_ascii": (100, 50),
    "vectornav_binary": (200, 400),
    "witmotion": (50, 100),
    "xsens_mtdata2": (100, None),
}
"""Rate of the emulated instrument, and another it can be set to."""


@pytest.mark.parametrize("name", RATES)
def test_two_commands_understand_each_other(name: str, program: Program) -> None:
    before_hz, rate_hz = RATES[name]
    port = program.folder / "imu"
    emulator = program.start("emulate", name, "--positions", "none", "--rate-hz", before_hz, "--link", port, "--json")
    try:
        assert emulator.stdout is not None
        assert json.loads(emulator.stdout.readline())["event"] == "started"
        found = probe_port(str(port), None, SystemClock(), ask=True)
        assert found.found is not None, found.error
        assert found.found.name == name
        order = () if rate_hz is None else ("--rate-hz", rate_hz)
        done = program.run("record", "--port", port, "--session", "here", "--duration-s", 1, *order)
        assert done.returncode == 0, done.stderr
        again = probe_port(str(port), None, SystemClock())
        assert again.found is not None
        assert again.found.rate_hz == pytest.approx(before_hz, rel=0.25), "put back"
    finally:
        emulator.send_signal(signal.SIGINT)
        emulator.communicate(timeout=900)
    session = Session.open(program.folder / "here")
    told = {key: session.metadata["instrument"][key] for key in found.identity}
    assert told == found.identity
    assert found.identity["serial_number"]
    assert session.metadata["link"].get("rate_hz") == rate_hz
    assert session.metadata["link"].get("rate_before_hz") == (None if rate_hz is None else before_hz)


@pytest.mark.parametrize(("name", "is_untried"), [("kvh_17xx", True), ("sbg_sbgecom", True), ("xsens_mtdata2", False)])
def test_what_was_never_tried_on_a_real_instrument_is_said(name: str, is_untried: bool) -> None:
    with emulated(name) as there:
        found, said = connected(there.port, driver=name)
        found.close()
    assert any(getattr(one, "key", "") == "connected.experimental" for one in said) == is_untried


class Stubborn(MicroStrainInstrument):
    """Takes every rate, and sends no faster than 100 Hz."""

    def _settings(self, number: int, data: bytes) -> bytes:
        answer = super()._settings(number, data)
        self.format = [(one, max(decimation, 10)) for one, decimation in self.format]
        return answer


def test_a_rate_that_was_not_taken_is_an_error_and_all_is_as_before() -> None:
    there = emulated("microstrain_mip", 50, "gps_time")
    assert isinstance(there.device, ProtocolDevice)
    form = choose_wire(Emulation(device="microstrain_mip", form="gps_time")).form
    assert form is not None
    instrument = there.device.script = Stubborn(50, form)
    before = list(instrument.format)
    with there:
        with pytest.raises(LinkError, match="set to 500 Hz but reports 100 Hz") as error:
            connected(there.port, rate_hz=500)
        assert error.value.reason is Reason.REFUSED
        assert instrument.format == before
        assert instrument.streaming


def test_what_cannot_be_put_back_is_said() -> None:
    with emulated("witmotion", 50) as there:
        found, said = connected(there.port, rate_hz=100)
    found.close()
    assert "not restored" in said[-1]


def test_a_protocol_file_knows_no_commands() -> None:
    with emulated("xsens_mtdata2") as there, pytest.raises(UsageError, match="protocol file"):
        connected(there.port, protocol="xsens_mtdata2", rate_hz=50)


def test_a_rate_that_the_wire_cannot_carry() -> None:
    with emulated("xsens_mtdata2") as there:
        found = search(there.port, serial_candidates(), [115200], SystemClock())
        found.link.close()
    assert found.recognised is not None
    check_capacity(found.recognised, 100, 115200)
    # 61 bytes of 10 bits and a tenth to spare: 115200 bit/s carry 172 a second, the cut first frame aside.
    with pytest.raises(UsageError, match=r"1[67]\d samples/s"):
        check_capacity(found.recognised, 200, 115200)


def test_what_is_given_but_not_there_is_named() -> None:
    with sending(b"12 hello\r\n") as port, pytest.raises(LinkError) as error:
        connected(port, driver="stim300")
    assert error.value.reason is Reason.NO_FRAMES
    assert not isinstance(error.value, LinkTimeoutError)


def heard(link: Link, decoder: Decoder, samples: int) -> list[Chunk]:
    """Read until the decoder has so many samples."""
    chunks: list[Chunk] = []
    while decoder.statistics.samples < samples:
        chunk = link.read()
        if chunk is not None:
            chunks.append(chunk)
            decoder.feed(chunk.data, chunk.monotonic_s)
    return chunks


@pytest.mark.parametrize("deaf", [False, True])
def test_samples_that_gave_way_to_answers_are_not_lost_on_the_link(deaf: bool) -> None:
    driver = load_driver("stim300")
    there = emulated("stim300", 125.0)
    if deaf:
        there.device.receive = lambda data: Answer()  # type: ignore[method-assign]
    with there:
        link = open_link(there.port, baud=driver.default_baud)
        try:
            listening = Decoder(driver.load_protocol())
            chunks = heard(link, listening, 40)
            # Behind what it says when it is switched on; the slow clock leaves a busy machine time for the answers.
            listening.messages()
            first = chunks[0]
            instrument = Instrument(driver, SystemClock() if deaf else ScaledClock(0.05), set(listening.statistics.by_kind))
            messages = ask_identity(instrument, link, chunks, listening.messages())
            assert bool(messages) is not deaf
            assert not deaf or first in chunks, "nothing gave way where nothing was answered"
            counting = Decoder(driver.load_protocol())
            for chunk in chunks:
                counting.feed(chunk.data, chunk.monotonic_s)
            heard(link, counting, 80)
            counting.flush()
            # A machine that stands still for longer than the port keeps bytes does lose samples.
            assert counting.statistics.lost == 0 or there.bytes_dropped
        finally:
            link.close()
