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
_PORTS_NAMED = 6  # More ports than this do not help a reader of an error message.


def open_error(port: str, baud: int, error: Exception) -> ImufieldError:
    """Turn what pyserial raised into the error a user can act on."""
    scheme, is_address, rest = port.partition("://")
    if isinstance(error, ValueError):
        return _bad_value(port, baud, str(error))
    host, _, host_port = rest.partition("/")[0].rpartition(":")
    # An address of a network that names no place there: pyserial then fails with a text of Python's own.
    if scheme.lower() in ("socket", "rfc2217") and not (host and host_port.isdecimal()):
        return UsageError(f"{port} names no host and port; give both, as in {scheme}://192.168.1.5:4001.", port=port)
    if is_address and "spy:" not in port:
        what = f"cannot be opened ({_cause(error)}): check address, port number and that the other end listens"
        return LinkError(f"{port} {what}.", Reason.PORT_NOT_FOUND, port=port)
    number = _errno(error)
    if number == errno.EACCES:
        return _no_permission(port)
    if number == errno.EINVAL:
        return baud_refused(port, baud)
    reason = Reason.PORT_NOT_FOUND if number in _ABSENT else Reason.DISCONNECTED
    if number in _BUSY:
        what, reason = f"is in use by {_holder(port)}: close it and try again", Reason.PORT_BUSY
    elif number in _NOT_A_TERMINAL:
        what, reason = f"is not a serial port; {_there_are()}", Reason.PORT_NOT_FOUND
    elif number == errno.ENOENT:
        what = f"does not exist; {_there_are()}"
    else:
        what = f"cannot be opened ({_cause(error)}); {_there_are()}"
    return LinkError(f"{port} {what}.", reason, port=port)


def _bad_value(port: str, baud: int, cause: str) -> ImufieldError:
    if "baud" in cause:
        return baud_refused(port, baud)
    what = f"cannot be opened: {cause}"
    if "not known" in cause:
        what = (
            "is no kind of address that can be opened: use a device such as /dev/ttyUSB0 or COM5, socket://host:port, "
            "rfc2217://host:port or loop://"
        )
    return UsageError(f"{port} {what}.", port=port)


def baud_refused(port: str, baud: int) -> LinkError:
    """Say that a port cannot be set to a baud rate."""
    return LinkError(
        f"{port} does not take {baud} baud: choose a rate that both the adapter and the instrument know.",
        Reason.BOUNDS,
        port=port,
        baud=baud,
    )


def _no_permission(port: str) -> LinkError:
    group = "dialout"
    # OSError: the port went away; KeyError: its group has no name; NotImplementedError: a system without groups (Windows).
    with suppress(OSError, KeyError, NotImplementedError):
        group = Path(port).group()
    return LinkError(
        f"no permission to open {port}: add yourself to its group with `sudo usermod -aG {group} $USER` and log in again.",
        Reason.NO_PERMISSION,
        port=port,
        group=group,
    )


def _errno(error: BaseException) -> int | None:
    """Find the error number in attribute, arguments or text."""
    number = getattr(error, "errno", None)
    if isinstance(number, int):
        return number
    if error.args and isinstance(error.args[0], int):
        return error.args[0]
    text = str(error)
    # Windows: "could not open port 'COM9': FileNotFoundError(2, ...)"; a port in use there is "access denied".
    for name, meaning in (("FileNotFoundError", errno.ENOENT), ("PermissionError", errno.EBUSY)):
        if name in text:
            return meaning
    found = re.search(r"\(\s*(\d+)\s*,", text)
    return int(found.group(1)) if found else None


def _cause(error: BaseException) -> str:
    """Return the system's own words, without pyserial's wrapping."""
    number = _errno(error)
    text = str(error)
    found = re.search(r"\[Errno -?\d+\] ([^\]']+)$", text)
    if found:
        return found.group(1).strip()
    return os.strerror(number) if number is not None else text


def _there_are() -> str:
    names = [port.device for port in serial_ports()]
    if not names:
        return "no serial port is there: plug the instrument in, `imufield devices` lists what is found"
    more = ", ..." if len(names) > _PORTS_NAMED else ""
    return f"this machine has {', '.join(names[:_PORTS_NAMED])}{more}; check the cable, or see `imufield devices`"


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
