"""Find the instrument on a port or bus, recognise it, and send it commands: identity, start, stop, output rate."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imufield.acquire.instrument.instrument import Instrument

__all__ = ["Instrument"]


def __getattr__(name: str) -> Any:
    """Hand on the names that stood here when this was a module; imported on first use."""
    if name in __all__:
        return getattr(importlib.import_module("imufield.acquire.instrument.instrument"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
