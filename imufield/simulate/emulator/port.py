"""The instrument's end of a pseudo-terminal, which behaves as a UART: bytes that nobody reads are lost."""

from __future__ import annotations

import contextlib
import os
import select
import sys
from pathlib import Path

from imufield.errors import LinkError, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

BUFFER_BYTES = 65536
"""Kept for a reader who is late, as the driver of a USB adapter does; beyond it bytes are lost."""


class PseudoTerminal:
    """A pseudo-terminal in raw mode that can go away and come back.

    Reading and writing never block. Not for Windows, which has none.

    Parameters
    ----------
    link : Path, optional
        A symbolic link that points to the port as long as it is there; an existing link is replaced, a file is not.

    Raises
    ------
    LinkError
        If the system has no pseudo-terminals.
    UsageError
        If something that is no symbolic link stands where the link should.
    """

    def __init__(self, link: Path | None = None) -> None:
        if link is not None and not link.parent.is_dir():
            raise UsageError(sentence("port.no_folder", path=str(link.parent)))
        if link is not None and link.exists() and not link.is_symlink():
            raise UsageError(sentence("port.no_link", path=str(link)))
        self._link = link
        self._master = -1
        self._waiting = b""
        self.bytes_dropped = 0
        self._bytes_for_host = 0
        self._bytes_too_late = 0  # Of these, dropped as the host did not take them in time.
        self.device = ""  # Path of the port at present.
        self.open()

    @property
    def address(self) -> str:
        """What a host opens: the link where there is one, otherwise the device."""
        return str(self._link) if self._link is not None else self.device

    @property
    def bytes_waiting(self) -> int:
        """Bytes kept for a reader who is late."""
        return len(self._waiting)

    @property
    def share_taken(self) -> float:
        """Of the bytes for a host that holds the port, the part that was not dropped as it took them too late."""
        return 1.0 - self._bytes_too_late / max(self._bytes_for_host, 1)

    def open(self) -> None:
        """Bring the port into being, under a new device path."""
        if sys.platform == "win32":
            raise LinkError(sentence("port.no_pseudo_terminals"))
        import tty

        master, slave = os.openpty()
        # Raw mode: no echo, no translation of CR, every byte value passes. It outlives the closing of this end.
        tty.setraw(slave)
        os.set_blocking(master, False)
        self.device = os.ttyname(slave)
        # With this end closed the master can tell whether a host holds the port.
        os.close(slave)
        self._master = master
        if self._link is not None:
            _point(self._link, self.device)

    def close(self) -> None:
        """Take the port away; a host that holds it sees a disconnection."""
        if self._master < 0:
            return
        # Before the device: once that is gone the system gives its number to the next terminal, which is no instrument.
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        os.close(self._master)
        self._master = -1
        self.bytes_dropped += len(self._waiting)
        self._waiting = b""

    def has_reader(self) -> bool:
        """Return whether a host holds the port open (always, where the system does not tell)."""
        if self._master < 0:
            return False
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return not any(event & select.POLLHUP for _, event in poll.poll(0))

    def write(self, data: bytes) -> None:
        """Send what the system takes, keep a little for later, drop the rest; counted in ``bytes_dropped``.

        While no host holds the port everything is dropped, so that nobody finds old bytes when opening it.
        """
        waiting = self._waiting + data
        kept = 0
        if self.has_reader():
            sent = 0
            # EAGAIN: the buffer of the system is full. EIO: the host has just gone.
            with contextlib.suppress(OSError):
                while sent < len(waiting):
                    sent += os.write(self._master, waiting[sent:])
            waiting = waiting[sent:]
            kept = BUFFER_BYTES
            self._bytes_for_host += len(data)
            self._bytes_too_late += max(len(waiting) - kept, 0)
        self._waiting = waiting[:kept]
        self.bytes_dropped += len(waiting) - len(self._waiting)

    def read(self) -> bytes:
        """Return what the host has sent, empty for nothing."""
        if self._master < 0:
            return b""
        try:
            return os.read(self._master, 4096)
        except OSError:
            return b""


def _point(link: Path, device: str) -> None:
    # Rename over the old link: at no moment does the name lead nowhere.
    temporary = link.with_name(f".{link.name}.{os.getpid()}")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(device)
    temporary.replace(link)
