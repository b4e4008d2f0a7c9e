"""What a shell completes: instruments, sessions, export targets and ports; what finds them is imported when it is needed."""

from __future__ import annotations

import shlex
from pathlib import Path

from imufield.files import DEFAULT_ROOT


def drivers() -> list[str]:
    """Return the names of the instruments' drivers."""
    from imufield.acquire.registry import driver_names

    return driver_names()


def targets() -> list[str]:
    """Return the names of the programs that parameters can be exported to."""
    from imufield.deliver.exports.registry import TARGETS

    return [*TARGETS]


def ports() -> list[str]:
    """Return the serial ports of this machine."""
    from serial.tools.list_ports import comports

    return [port.device for port in comports()]


def sessions() -> list[str]:
    """Return the folders of sessions in the working folder, and where captures go."""
    found = [path.parent for root in (Path(), DEFAULT_ROOT) for path in root.glob("*/session.toml")]
    # A folder may come from somebody else, and a shell reads a name that is more than a word as something to do.
    return [name for name in map(str, found) if shlex.quote(name) == name]
