"""Find drivers by name: the files of ``imufield.drivers``, then the entry-point group of that name.

Listing imports no driver; loading imports one.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from functools import cache
from typing import TYPE_CHECKING

from imufield.errors import ProtocolError, Reason, UnknownNameError
from imufield.sentences import Sentences

if TYPE_CHECKING:  # A shell completes names of drivers, and should not wait for NumPy.
    from importlib.metadata import EntryPoint, EntryPoints

    from imufield.acquire.driver import Driver

sentence = Sentences(__package__)

GROUP = "imufield.drivers"
# What every driver states of its instrument.
_STATED = ("name", "title", "protocol", "default_baud", "bauds", "status", "manual")


def driver_names() -> list[str]:
    """Return the names of the drivers there are, sorted. One of another distribution may still fail to load."""
    return sorted({*shipped_names()} | {point.name for point in _installed()})


def load_driver(name: str) -> type[Driver]:
    """Import the driver called ``name`` and return its class.

    Raises
    ------
    UnknownNameError
        If there is no such driver.
    ProtocolError
        If two distributions have one of that name, or it cannot be imported.
    """
    from importlib.metadata import EntryPoint

    points = tuple(_installed().select(name=name))
    shipped = name in shipped_names()
    # Which of two is meant, nobody can tell; the order of installation must not decide.
    if shipped + len(points) > 1:
        owners = [*(["imufield"] if shipped else []), *(point.dist.name if point.dist else point.value for point in points)]
        raise ProtocolError(sentence("registry.several", name=name, owners=owners, count=len(owners)), Reason.UNKNOWN_DRIVER)
    if shipped:
        return _load(EntryPoint(name, f"{GROUP}.{name}:DRIVER", GROUP))
    if points:
        return _load(points[0])
    from imufield.acquire.protocol.toml import near

    names = driver_names()
    unknown = sentence("registry.unknown", name=name, near=near(name, names), names=names)
    raise UnknownNameError(unknown, Reason.UNKNOWN_DRIVER)


def shipped_names() -> list[str]:
    """Return the names of the drivers that ship with imufield, sorted."""
    folder = importlib.import_module(GROUP).__path__
    return sorted(module.name for module in pkgutil.iter_modules(folder) if not module.name.startswith("_"))


def _installed() -> EntryPoints:
    return _points_on(tuple(sys.path))


# Asking every distribution takes milliseconds, and recognising an instrument asks for one driver after another.
@cache
def _points_on(path: tuple[str, ...]) -> EntryPoints:  # noqa: ARG001  (where the distributions are looked for)
    from importlib.metadata import entry_points  # as slow as all that a table needs to be imported

    return entry_points(group=GROUP)


def _load(point: EntryPoint) -> type[Driver]:
    from imufield.acquire.driver import Driver

    where = {"name": point.name, "place": point.value}
    try:
        found = point.load()
    except (Exception, SystemExit) as error:  # a module of somebody else, whose first run can fail in any way
        failed = sentence("registry.failed", kind=type(error).__name__, cause=error, **where)
        raise ProtocolError(failed, Reason.DRIVER_FAILED) from error
    if not (isinstance(found, type) and issubclass(found, Driver)):
        raise ProtocolError(sentence("registry.no_driver", kind=type(found).__name__, **where), Reason.DRIVER_FAILED)
    # Else it would fail later, in the middle of a session.
    missing = [name for name in _STATED if not hasattr(found, name)]
    if missing:
        raise ProtocolError(sentence("registry.incomplete", missing=missing, **where), Reason.DRIVER_FAILED)
    return found
