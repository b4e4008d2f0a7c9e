"""Wire formats as data: what TOML and DBC files say, read and checked, and the values of a frame read by it (``layout``)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imufield.acquire.protocol.protocol import *  # noqa: F403  the names are listed below

__all__ = ["DBC_LIMIT_BYTES", "FOLDER", "SCHEMA_VERSION", "Nominal", "Protocol"]  # noqa: F405
__all__ += ["decode_dbc", "load_protocol", "parse_protocol", "protocol_names"]  # noqa: F405


def __getattr__(name: str) -> Any:
    """Hand on the names that stood here when this was a module; imported on first use."""
    if name in __all__:
        return getattr(importlib.import_module("imufield.acquire.protocol.protocol"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
