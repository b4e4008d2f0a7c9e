"""Turn the errors of opening a serial port into one sentence that names cause and remedy.

pyserial reports every failure as ``SerialException``, sometimes with ``errno``, sometimes (sockets, Windows) with the cause in
the text only, and two kinds not at all: ``termios.error`` and ``ValueError`` come through unchanged.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from imufield.acquire.link.ports import serial_ports
from imufield.errors import ImufieldError, LinkError, Reason, UsageError
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# A port that is no terminal; Windows has none.
_TERMINAL_ERRORS: tuple[type[Exception], ...] = ()
with suppress(ImportError):
    import termios

    _TERMINAL_ERRORS = (termios.error,)

OPEN_FAILURES: tuple[type[Exception], ...] = (OSError, ValueError, *_TERMINAL_ERRORS)
"""Everything pyserial raises when a port cannot be opened; SerialException is an OSError."""

_BUSY = {errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK}
_ABSENT = {errno.ENOENT, errno.ENXIO, errno.ENODEV}
_NOT_A_TERMINAL = {errno.ENOTTY, errno.EISDIR}
_ERRNO = re.compile(r"\[Errno (\d+)\]|\(\s*(\d+)\s*,")
_PORTS_NAMED = 6  # More ports than this do not help a reader of an error message.


def open_error(port: str, baud: int, error: Exception) -> ImufieldError:
    """Turn what pyserial raised into the error a user can act on."""
    scheme, is_address, rest = port.partition("://")
    if isinstance(error, ValueError):
        if "baud" in str(error):
            return baud_refused(port, baud)
        key = "link_errors.unknown_kind" if "not known" in str(error) else "link_errors.bad_value"
        return UsageError(sentence(key, port=port, cause=error))
    host, _, host_port = rest.partition("/")[0].rpartition(":")
    # An address of a network that names no place there: pyserial then fails with a text of Python's own.
    if scheme.lower() in ("socket", "rfc2217") and not (host and host_port.isdecimal()):
        return UsageError(sentence("link_errors.no_host", port=port, scheme=scheme))
    cause = _cause(error)
    if is_address and "spy:" not in port:
        return LinkError(sentence("link_errors.no_answer", port=port, cause=cause), Reason.PORT_NOT_FOUND)
    number = system_errno(error)
    if number == errno.EACCES:
        group = "dialout"
        # OSError: the port went away; KeyError: its group has no name; NotImplementedError: a system without groups (Windows).
        with suppress(OSError, KeyError, NotImplementedError):
            group = Path(port).group()
        return LinkError(sentence("link_errors.no_permission", port=port, group=group), Reason.NO_PERMISSION)
    if number == errno.EINVAL:
        return baud_refused(port, baud)
    if number in _BUSY:
        return LinkError(sentence("link_errors.busy", port=port, holder=_holder(port)), Reason.PORT_BUSY)
    key = "link_errors.absent" if number == errno.ENOENT else "link_errors.cannot_open"
    there_are = "link_errors.ports"
    if number in _NOT_A_TERMINAL:
        key, there_are = "link_errors.no_terminal", "link_errors.choose"
    reason = Reason.PORT_NOT_FOUND if number in _ABSENT | _NOT_A_TERMINAL else Reason.DISCONNECTED
    return LinkError(sentence(key, port=port, cause=cause, there_are=_there_are(there_are)), reason)


def check_port(port: str) -> None:
    """Raise the error of opening a port that is not there; whether another can be opened only opening it tells."""
    # The ports of Windows are no files.
    if os.name == "posix" and "://" not in port and not Path(port).exists():
        raise open_error(port, 0, OSError(errno.ENOENT, os.strerror(errno.ENOENT), port))


def baud_refused(port: str, baud: int) -> LinkError:
    """Say that a port cannot be set to a baud rate."""
    return LinkError(sentence("link_errors.baud", port=port, baud=baud), Reason.BOUNDS)


def system_errno(error: BaseException) -> int | None:
    """Find the system's error number in an error or in what caused it: in attribute, arguments or text."""
    cause: BaseException | None = error
    while cause is not None:
        for candidate in (getattr(cause, "errno", None), getattr(cause, "error_code", None), *cause.args[:1]):
            if isinstance(candidate, int):
                return candidate
        # Windows: "could not open port 'COM9': FileNotFoundError(2, ...)"; a port in use there is "access denied".
        for name, meaning in (("FileNotFoundError", errno.ENOENT), ("PermissionError", errno.EBUSY)):
            if name in str(cause):
                return meaning
        if found := _ERRNO.search(str(cause)):
            return int(found.group(1) or found.group(2))
        cause = cause.__cause__ or cause.__context__
    return None


def _cause(error: BaseException) -> str:
    """Return the system's own words, without pyserial's wrapping."""
    number = system_errno(error)
    text = str(error)
    found = re.search(r"\[Errno -?\d+\] ([^\]']+)$", text)
    if found:
        return found.group(1).strip()
    return os.strerror(number) if number is not None else text


def _there_are(key: str) -> str:
    names = [port.device for port in serial_ports()]
    if not names:
        return sentence("link_errors.no_ports")
    more = ["..."] if len(names) > _PORTS_NAMED else []
    return sentence(key, ports=names[:_PORTS_NAMED] + more)


def _holder(port: str) -> str:
    """Name the program that has the port open, where /proc shows it (own processes on Linux)."""
    try:
        target = Path(port).stat().st_rdev
        for process in Path("/proc").iterdir():
            if process.name.isdigit() and int(process.name) != os.getpid() and target in _open_devices(process):
                return f"{(process / 'comm').read_text().strip()} (process {process.name})"
    except OSError:
        pass
    return "another program"


def _open_devices(process: Path) -> Iterator[int]:
    """Yield the devices that a process has open, as far as this user may see them."""
    with suppress(OSError):
        for entry in (process / "fd").iterdir():
            # It may be closed meanwhile.
            with suppress(OSError):
                if device := entry.stat().st_rdev:
                    yield device
