"""Sources of raw bytes: serial port, TCP address and CAN bus, their clocks and errors, and reconnecting."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imufield.acquire.link.serial import *  # noqa: F403  the names are listed below

__all__ = ["COLLECT_S", "READ_LIMIT_BYTES", "WAIT_S", "WRITE_TIMEOUT_S", "Chunk", "Link", "Port"]  # noqa: F405
__all__ += ["SerialLink", "SerialSettings", "not_taken", "open_link"]  # noqa: F405


def __getattr__(name: str) -> object:
    """Hand on the names that stood here when this was a module; imported on first use, as most commands have no port."""
    if name in ("serial", *__all__):
        serial = importlib.import_module("imufield.acquire.link.serial")
        found: object = serial if name == "serial" else getattr(serial, name)
        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
