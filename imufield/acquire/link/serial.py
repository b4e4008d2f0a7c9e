"""Open a serial port, or a TCP address that pyserial knows, and read bytes from it in chunks with arrival times.

``/dev/ttyUSB0``, ``COM5``, ``socket://192.168.1.5:4001``, ``rfc2217://host:2217``, ``loop://`` and ``spy:///dev/ttyUSB0`` all
work. A read waits for the first byte, then lets the operating system collect for 20 ms, so that an instrument of 2000
datagrams a second costs 50 wake-ups a second and not 2000. What collects meanwhile is the system's buffer: 4 KiB of a Linux
terminal plus up to 64 KiB behind it, 20 ms at 3 Mbit/s being 6 KiB.
"""

from __future__ import annotations

import os
import select
import stat
from pathlib import Path
from typing import Protocol

import serial

from imufield.acquire.link.chunk import Chunk as Chunk  # noqa: PLC0414  (where drivers of others know it)
from imufield.acquire.link.host_clock import HostClock, SystemClock
from imufield.acquire.link.link_errors import OPEN_FAILURES, baud_refused, open_error
from imufield.dataclass import dataclass, replace
from imufield.errors import LinkError, LinkTimeoutError, Reason
from imufield.files import real_path
from imufield.sentences import Sentences

sentence = Sentences(__package__)

WAIT_S = 0.05
"""How long one read waits for a first byte: short enough for Ctrl-C and a screen, long enough to cost nothing."""
COLLECT_S = 0.02
"""How long bytes are collected after the first one, in host clock time: 50 chunks a second."""
READ_LIMIT_BYTES = 65_536
"""Most bytes of one chunk; what remains is the next chunk."""
WRITE_TIMEOUT_S = 1.0
"""Commands to instruments are shorter than 1 kB: even at 9600 baud they are out within this time."""
PSEUDO_TERMINALS = "/dev/pts/"
"""Linux numbers them here; an instrument that comes back has a link, which leads to its new number."""


class Link(Protocol):
    """A source of chunks."""

    name: str

    def read(self) -> Chunk | None:
        """Return what arrived, or None if nothing did within about 50 ms; raise LinkError when the link is gone."""

    def write(self, data: bytes) -> None:
        """Send a command; raise LinkError when the link is gone, LinkTimeoutError when it does not take the bytes."""

    def close(self) -> None:
        """Give the port back; may be called again."""


class Port(Protocol):
    """What is used of a pyserial port, whichever kind its address chose."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once; only 0 or 1 on sockets."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Return at most ``size`` bytes within the time-out."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send all bytes within the write time-out."""

    def fileno(self) -> int:
        """Return the descriptor, where there is one."""
        ...

    def reset_input_buffer(self) -> None:
        """Throw away what arrived and was not read."""

    def close(self) -> None:
        """Close; may be called again."""


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """How the wire is set; without effect on ``socket://`` and pseudo-terminals."""

    baud: int
    parity: str = serial.PARITY_NONE
    stop_bits: float = 1
    data_bits: int = 8


class SerialLink:
    """A port opened through pyserial; made by ``open_link``.

    Parameters
    ----------
    port : str
        Device name or pyserial address.
    settings : SerialSettings
    clock : HostClock

    Raises
    ------
    LinkError
        Port not found, busy, no permission, not a serial port, baud rate refused: see ``reason``.
    UsageError
        The address is of no known kind.
    """

    def __init__(self, port: str, settings: SerialSettings, clock: HostClock) -> None:
        self.name = port
        self.settings = settings
        self._clock = clock
        self._port: Port | None = None
        self._seen_link = _link_to_pseudo_terminal(port)
        self._descriptor: int | None = None
        self._open()

    def _open(self) -> None:
        settings = self.settings
        if settings.baud <= 0:
            # A baud rate of 0 means "hang up" to a terminal.
            raise baud_refused(self.name, settings.baud)
        selectable = _can_be_selected(self.name)
        try:
            self._port = serial.serial_for_url(
                self.name,
                baudrate=settings.baud,
                parity=settings.parity,
                stopbits=settings.stop_bits,
                bytesize=settings.data_bits,
                # Set once: pyserial configures the port again whenever the time-out is changed.
                timeout=0 if selectable else WAIT_S,
                write_timeout=WRITE_TIMEOUT_S,
                # POSIX lets two programs read one port, and each then gets half of the bytes.
                exclusive=True if os.name == "posix" else None,
            )
        except OPEN_FAILURES as error:
            raise open_error(self.name, settings.baud, error) from error
        self._descriptor = self._port.fileno() if selectable else None

    def read(self) -> Chunk | None:
        """Return up to 20 ms of wire, or None if nothing came within 50 ms.

        Raises
        ------
        LinkError
            The port is closed or gone.
        """
        port = self._opened()
        try:
            data = self._read_waiting(port) if self._descriptor is None else self._read_selected(port, self._descriptor)
        except (OSError, TypeError) as error:
            # TypeError: pyserial's POSIX port, closed by another thread while it waits, passes None on as descriptor.
            raise self._gone(error) from error
        if not data:
            return None
        return Chunk(data, self._clock.monotonic_s(), self._clock.utc_ns())

    def _read_selected(self, port: Port, descriptor: int) -> bytes:
        """Read a port that has a descriptor: time-out 0, waiting is done here."""
        if not select.select([descriptor], [], [], WAIT_S)[0]:
            return b""
        self._clock.sleep(COLLECT_S)
        data = port.read(READ_LIMIT_BYTES)
        # A terminal hands out 4095 bytes at most at a time; go on until it is empty.
        while len(data) < READ_LIMIT_BYTES:
            try:
                more = port.read(READ_LIMIT_BYTES - len(data))
            except OSError:
                # The last bytes before a disconnection still count; the next read meets the error again.
                break
            if not more:
                break
            data += more
        return data

    def _read_waiting(self, port: Port) -> bytes:
        """Read a port without descriptor (Windows, loop://, rfc2217://): its count of waiting bytes is exact."""
        first = port.read(1)
        if not first:
            return b""
        self._clock.sleep(COLLECT_S)
        return first + port.read(min(port.in_waiting, READ_LIMIT_BYTES - 1))

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises
        ------
        LinkTimeoutError
            The port did not take them within 1 s.
        LinkError
            The port is closed or gone.
        """
        port = self._opened()
        try:
            port.write(data)
        except serial.SerialTimeoutException as error:
            raise not_taken(self.name, f"{len(data)} bytes", sentence("serial.check_flow")) from error
        except (OSError, TypeError) as error:
            raise self._gone(error) from error

    def set_baud(self, baud: int) -> None:
        """Go on at another baud rate, and throw away what arrived at the old one.

        The port stays open: opening one anew resets instruments that hang on its DTR line, as hobby boards do.

        Raises
        ------
        LinkError
            The rate is refused, or the port is gone.
        """
        port = self._opened()
        try:
            # A property of pyserial's ports, which a structural type cannot describe.
            setattr(port, "baudrate", baud)  # noqa: B010
            port.reset_input_buffer()
        except OPEN_FAILURES as error:
            raise open_error(self.name, baud, error) from error
        self.settings = replace(self.settings, baud=baud)

    def close(self) -> None:
        """Give the port back; may be called again."""
        port, self._port, self._descriptor = self._port, None, None
        if port is not None:
            port.close()

    def reopen(self) -> bool:
        """Try to open the same port again after it was lost.

        Returns
        -------
        bool
            False while the port is not there, busy or (until udev has set its group) not permitted: try again later.

        Raises
        ------
        LinkError
            The port is there and cannot be used, or is a pseudo-terminal: waiting would not help.
        """
        self.close()
        # The system gives the number of a pseudo-terminal that is gone to the next one: somebody's shell, and no instrument.
        if self.name.startswith(PSEUDO_TERMINALS):
            raise LinkError(sentence("serial.gone_for_good", port=self.name), Reason.DISCONNECTED)
        # Who is killed leaves a link, which leads to that next one.
        seen_link = _link_to_pseudo_terminal(self.name)
        if seen_link is not None and seen_link == self._seen_link:
            return False
        try:
            self._open()
        except LinkError as error:
            if error.reason in (Reason.PORT_NOT_FOUND, Reason.PORT_BUSY, Reason.NO_PERMISSION, Reason.DISCONNECTED):
                return False
            raise
        self._seen_link = seen_link
        return True

    def _opened(self) -> Port:
        if self._port is None:
            raise self._gone(None)
        return self._port

    def _gone(self, cause: BaseException | None) -> LinkError:
        key = "serial.closed" if cause is None else "serial.gone"
        return LinkError(sentence(key, port=self.name, cause=str(cause)), Reason.DISCONNECTED)


def not_taken(name: str, what: str, remedy: str) -> LinkTimeoutError:
    """Return the error that a link did not take what was sent in time."""
    told = sentence("serial.not_taken", port=name, what=what, limit_s=WRITE_TIMEOUT_S, remedy=remedy)
    return LinkTimeoutError(told, Reason.SILENCE)


def _link_to_pseudo_terminal(port: str) -> tuple[int, int] | None:
    """Return what tells a link to a pseudo-terminal from a later one of its name; None where the port is no such link."""
    try:
        status = Path(port).lstat()
    except OSError:
        return None
    leads_there = stat.S_ISLNK(status.st_mode) and str(real_path(port)).startswith(PSEUDO_TERMINALS)
    return (status.st_ino, status.st_mtime_ns) if leads_there else None


def _can_be_selected(port: str) -> bool:
    """Tell whether ``select`` works on a port: terminals and sockets on POSIX."""
    if os.name != "posix":
        return False
    scheme, separator, _ = port.partition("://")
    return not separator or scheme.lower() in ("socket", "spy", "alt", "hwgrep")


def open_link(
    port: str,
    *,
    baud: int,
    clock: HostClock | None = None,
    parity: str = serial.PARITY_NONE,
    stop_bits: float = 1,
    data_bits: int = 8,
) -> SerialLink:
    """Open a port by device name or pyserial address.

    Parameters
    ----------
    port : str
        ``/dev/ttyUSB0``, ``COM5``, ``socket://host:port``, ``rfc2217://host:port``, ``loop://``, ``spy://PORT``.
    baud : int
        Ignored by sockets and pseudo-terminals.
    clock : HostClock, optional
        Stamps the chunks; the system's clock by default.
    parity : str
        "N", "E", "O".
    stop_bits, data_bits : float, int

    Raises
    ------
    LinkError
        Port not found, busy, no permission, not a serial port, baud rate refused: see ``reason``.
    UsageError
        The address is of no known kind.
    """
    return SerialLink(port, SerialSettings(baud, parity, stop_bits, data_bits), clock or SystemClock())
