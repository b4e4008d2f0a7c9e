"""Sources of raw bytes: serial port, TCP address and CAN bus, their clocks and errors, and reconnecting."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imufield.acquire.link.serial import (
        COLLECT_S,
        READ_LIMIT_BYTES,
        WAIT_S,
        WRITE_TIMEOUT_S,
        Chunk,
        Link,
        Port,
        SerialLink,
        SerialSettings,
        not_taken,
        open_link,
    )

__all__ = [
    "COLLECT_S",
    "READ_LIMIT_BYTES",
    "WAIT_S",
    "WRITE_TIMEOUT_S",
    "Chunk",
    "Link",
    "Port",
    "SerialLink",
    "SerialSettings",
    "not_taken",
    "open_link",
]


def __getattr__(name: str) -> Any:
    """Hand on the names that stood here when this was a module; imported on first use."""
    if name in __all__:
        return getattr(importlib.import_module("imufield.acquire.link.serial"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
