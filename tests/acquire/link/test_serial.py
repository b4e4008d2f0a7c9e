import os
import select
import socket
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import serial

from imufield.acquire.link import link_errors
from imufield.acquire.link.host_clock import ScaledClock
from imufield.acquire.link.ports import SerialPort
from imufield.acquire.link.serial import READ_LIMIT_BYTES, Chunk, SerialLink, open_link
from imufield.errors import ImufieldError, LinkError, LinkTimeoutError, Reason, UsageError
from tests.refused import refused

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are POSIX")


class Terminal:
    """The instrument's end of a pseudo-terminal."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        self.port = os.ttyname(self._slave)

    def unplug(self) -> None:
        for descriptor in (self.master, self._slave):
            with suppress(OSError):
                os.close(descriptor)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.unplug()


def read_until(link: SerialLink, size: int) -> bytes:
    data, deadline_s = b"", time.monotonic() + 60.0
    while len(data) < size and time.monotonic() < deadline_s:
        chunk = link.read()
        if chunk is not None:
            assert 0 < len(chunk.data) <= READ_LIMIT_BYTES
            data += chunk.data
    return data


def read_one(link: SerialLink) -> Chunk:
    deadline_s = time.monotonic() + 60.0
    while time.monotonic() < deadline_s:
        chunk = link.read()
        if chunk is not None:
            return chunk
    raise AssertionError("nothing came")


def wait_for_error(link: SerialLink) -> LinkError:
    for _ in range(100):
        try:
            link.read()
        except LinkError as error:
            return error
    raise AssertionError("the link never noticed")


def test_reads_what_the_instrument_sends_with_the_time_of_arrival(terminal: Terminal) -> None:
    link = open_link(terminal.port, baud=921600)
    assert link.read() is None
    before_s, before_ns = time.monotonic(), time.time_ns()
    os.write(terminal.master, b"\x93hello\r\n\x00\xff")
    chunk = read_one(link)
    assert chunk.data == b"\x93hello\r\n\x00\xff"
    assert before_s <= chunk.monotonic_s <= time.monotonic()
    assert before_ns <= chunk.utc_ns <= time.time_ns()
    link.close()


def test_many_small_writes_come_as_few_chunks_and_complete(terminal: Terminal) -> None:
    link = open_link(terminal.port, baud=921600)
    sent = bytes(i % 251 for i in range(40 * 400))

    def send() -> None:
        for start in range(0, len(sent), 40):
            os.write(terminal.master, sent[start : start + 40])

    sender = threading.Thread(target=send)
    sender.start()
    assert read_until(link, len(sent)) == sent
    sender.join()
    link.close()


def test_a_scaled_clock_stamps_scaled_times(terminal: Terminal) -> None:
    clock = ScaledClock(8.0)
    link = open_link(terminal.port, baud=921600, clock=clock)
    before_s = clock.monotonic_s()
    os.write(terminal.master, b"x")
    chunk = read_one(link)
    assert before_s <= chunk.monotonic_s <= clock.monotonic_s()
    link.close()


def test_commands_reach_the_instrument(terminal: Terminal) -> None:
    link = open_link(terminal.port, baud=9600)
    link.write(b"SERVICEMODE\r")
    assert os.read(terminal.master, 100) == b"SERVICEMODE\r"
    link.close()


def test_an_instrument_that_takes_nothing_is_a_time_out(terminal: Terminal) -> None:
    link = open_link(terminal.port, baud=9600)
    with refused(LinkTimeoutError, Reason.SILENCE, "1000000", key="serial.not_taken") as caught:
        link.write(b"x" * 1_000_000)
    assert caught.value.values["limit_s"] == 1
    link.close()


@pytest.mark.parametrize("settings", [{"baud": 1843200}, {"baud": 9600, "parity": "E"}, {"baud": 460800, "stop_bits": 2}])
def test_odd_settings_are_accepted_on_a_terminal(terminal: Terminal, settings: dict[str, object]) -> None:
    link = open_link(terminal.port, **settings)  # type: ignore[arg-type]  # a table of keyword arguments
    os.write(terminal.master, b"x")
    assert read_until(link, 1) == b"x"
    link.close()


def test_another_bit_rate_on_the_open_port(terminal: Terminal) -> None:
    link = open_link(terminal.port, baud=9600)
    os.write(terminal.master, b"at the old rate")
    # The system hands it over when it likes; what comes after the change would be of the new rate.
    assert link._descriptor is not None
    assert select.select([link._descriptor], [], [], 60.0)[0]
    link.set_baud(921600)
    os.write(terminal.master, b"new")
    assert read_until(link, 3) == b"new"
    assert link.settings.baud == 921600
    with pytest.raises(LinkError) as caught:
        link.set_baud(-1)
    assert caught.value.reason is Reason.BOUNDS
    assert link.settings.baud == 921600
    link.close()
    with pytest.raises(LinkError):
        link.set_baud(9600)


@pytest.mark.parametrize("baud", [0, -9600])
def test_an_impossible_baud_rate_is_refused(terminal: Terminal, baud: int) -> None:
    with refused(LinkError, Reason.BOUNDS, str(baud), key="link_errors.baud") as caught:
        open_link(terminal.port, baud=baud)
    assert caught.value.values["baud"] == baud
    assert caught.value.reason is Reason.BOUNDS


def test_a_second_reader_is_refused(terminal: Terminal) -> None:
    first = open_link(terminal.port, baud=9600)
    with refused(LinkError, Reason.PORT_BUSY, first.name, key="link_errors.busy") as caught:
        open_link(terminal.port, baud=9600)
    assert caught.value.reason is Reason.PORT_BUSY
    first.close()
    open_link(terminal.port, baud=9600).close()


def test_unplugging_is_noticed_and_plugging_in_again_too(terminal: Terminal, tmp_path: Path) -> None:
    # A USB adapter gets its old name back; a pseudo-terminal does not, so the name is a link to it.
    name = tmp_path / "ttyUSB0"
    name.symlink_to(terminal.port)
    link = open_link(str(name), baud=9600)
    terminal.unplug()
    error = wait_for_error(link)
    assert error.reason is Reason.DISCONNECTED
    assert error.values["port"] == str(name)
    name.unlink()
    assert not link.reopen()
    with refused(LinkError, Reason.DISCONNECTED, "ttyUSB0", key="serial.closed"):
        link.read()
    again = Terminal()
    name.symlink_to(again.port)
    assert link.reopen()
    os.write(again.master, b"back")
    assert read_until(link, 4) == b"back"
    link.close()
    again.unplug()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere pseudo-terminals have other names")
@pytest.mark.parametrize("is_linked", [True, False])
def test_the_number_of_a_pseudo_terminal_that_is_gone_leads_to_no_instrument(
    terminal: Terminal, tmp_path: Path, *, is_linked: bool
) -> None:
    name = tmp_path / "port"
    name.symlink_to(terminal.port)
    link = open_link(str(name) if is_linked else terminal.port, baud=9600)
    terminal.unplug()
    assert wait_for_error(link).reason is Reason.DISCONNECTED
    others = [Terminal() for _ in range(20)]  # The lowest number that is free is given first.
    before = [termios.tcgetattr(other.master) for other in others]
    if is_linked:
        # An emulator that is killed leaves its link.
        assert not link.reopen()
    else:
        with refused(LinkError, Reason.DISCONNECTED, terminal.port, key="serial.gone_for_good"):
            link.reopen()
    assert [termios.tcgetattr(other.master) for other in others] == before
    for other in others:
        other.unplug()


def test_reopening_does_not_hide_what_waiting_cannot_cure(terminal: Terminal, tmp_path: Path) -> None:
    name = tmp_path / "ttyUSB0"
    name.symlink_to(terminal.port)
    link = open_link(str(name), baud=9600)
    name.unlink()
    name.symlink_to(terminal.port)
    link.settings = type(link.settings)(baud=0)
    with refused(LinkError, Reason.BOUNDS) as caught:
        link.reopen()
    assert caught.value.values["baud"] == 0


def test_closing_twice_is_allowed_and_reading_afterwards_is_not(terminal: Terminal) -> None:
    link = open_link(terminal.port, baud=9600)
    link.close()
    link.close()
    with refused(LinkError, Reason.DISCONNECTED, key="serial.closed"):
        link.read()
    with refused(LinkError, Reason.DISCONNECTED, key="serial.closed"):
        link.write(b"x")


@pytest.mark.parametrize(
    ("port", "kind", "reason", "key", "facts"),
    [
        ("/dev/ttyUSB99", LinkError, Reason.PORT_NOT_FOUND, "absent", ()),
        ("/etc/passwd", LinkError, Reason.PORT_NOT_FOUND, "no_terminal", ()),
        ("/tmp", LinkError, Reason.PORT_NOT_FOUND, "no_terminal", ()),
        ("/dev/null", LinkError, Reason.PORT_NOT_FOUND, "no_terminal", ()),
        ("socket://127.0.0.1:1", LinkError, Reason.PORT_NOT_FOUND, "no_answer", ("Connection refused",)),
        ("telepathy://x", UsageError, Reason.USAGE, "unknown_kind", ("socket://host:port",)),
        ("socket://", UsageError, Reason.USAGE, "no_host", ("socket://192.168.1.5:4001",)),
        ("socket://:99", UsageError, Reason.USAGE, "no_host", ("socket://192.168.1.5:4001",)),
        ("socket://there", UsageError, Reason.USAGE, "no_host", ("socket://192.168.1.5:4001",)),
        ("rfc2217://", UsageError, Reason.USAGE, "no_host", ("rfc2217://192.168.1.5:4001",)),
    ],
)
def test_what_cannot_be_opened_says_why(
    port: str, kind: type[ImufieldError], reason: Reason, key: str, facts: tuple[str, ...]
) -> None:
    with refused(kind, reason, port, *facts, key=f"link_errors.{key}") as caught:
        open_link(port, baud=115200)
    assert caught.value.values["port"] == port
    assert caught.value.message.count(". ") == 0


def test_a_missing_port_names_those_that_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        link_errors, "serial_ports", lambda: [SerialPort(device=f"/dev/ttyUSB{i}", description="") for i in range(8)]
    )
    ports = ("/dev/ttyUSB99", "/dev/ttyUSB0", "/dev/ttyUSB5, ...")
    with refused(LinkError, Reason.PORT_NOT_FOUND, *ports, key="link_errors.absent"):
        open_link("/dev/ttyUSB99", baud=115200)
    monkeypatch.setattr(link_errors, "serial_ports", list)
    with refused(LinkError, Reason.PORT_NOT_FOUND, "/dev/ttyUSB99") as caught:
        open_link("/dev/ttyUSB99", baud=115200)
    assert "/dev/ttyUSB0" not in caught.value.message


@pytest.mark.parametrize(
    ("error", "reason", "fact"),
    [
        (serial.SerialException(13, "could not open port: Permission denied"), Reason.NO_PERMISSION, "usermod -aG dialout"),
        (serial.SerialException(16, "could not open port: Device busy"), Reason.PORT_BUSY, "COM9"),
        (
            serial.SerialException("could not open port 'COM9': FileNotFoundError(2, 'x')"),
            Reason.PORT_NOT_FOUND,
            "COM9",
        ),
        (serial.SerialException("could not open port 'COM9': PermissionError(13, 'x')"), Reason.PORT_BUSY, "COM9"),
        (serial.SerialException("Could not configure port: (5, 'Input/output error')"), Reason.DISCONNECTED, "Input/output"),
        (ValueError("Failed to set custom baud rate (7): 22"), Reason.BOUNDS, "7 baud"),
    ],
)
def test_what_other_systems_and_ports_report_is_understood(error: Exception, reason: Reason, fact: str) -> None:
    made = link_errors.open_error("COM9", 7, error)
    assert made.reason is reason
    assert fact in made.message


def with_server(serve: Callable[[socket.socket], None]) -> tuple[str, threading.Thread]:
    server = socket.create_server(("127.0.0.1", 0))

    def run() -> None:
        with server:
            peer, _ = server.accept()
            with peer:
                serve(peer)

    thread = threading.Thread(target=run)
    thread.start()
    return f"socket://127.0.0.1:{server.getsockname()[1]}", thread


def test_a_socket_delivers_everything_before_it_ends() -> None:
    sent = bytes(range(256)) * 800
    # pyserial drops what arrives while it opens a socket, so the server waits to be asked.
    address, thread = with_server(lambda peer: peer.sendall(sent) if peer.recv(1) else None)
    link = open_link(address, baud=1)
    link.write(b"?")
    assert read_until(link, len(sent)) == sent
    thread.join()
    assert wait_for_error(link).reason is Reason.DISCONNECTED
    link.close()


def test_a_loop_delivers_what_was_written() -> None:
    link = open_link("loop://", baud=115200)
    assert link.read() is None
    link.write(b"abc" * 300)
    assert read_until(link, 900) == b"abc" * 300
    link.close()


def test_a_spy_shows_what_it_reads(terminal: Terminal, capsys: pytest.CaptureFixture[str]) -> None:
    link = open_link(f"spy://{terminal.port}", baud=9600)
    os.write(terminal.master, b"seen")
    assert read_until(link, 4) == b"seen"
    link.close()
    assert "seen" in capsys.readouterr().err
