"""The parameter file: written, read, checked, converted and applied."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imufield.deliver.parameters.file import (
        PARAMETER_FILE,
        Context,
        Corrected,
        InstrumentFacts,
        Noise,
        Parameters,
        SessionFacts,
        from_document,
        json_ready,
        load,
        parameter_schema,
        to_document,
        to_toml,
        write_document,
        write_parameters,
    )

__all__ = [
    "PARAMETER_FILE",
    "Context",
    "Corrected",
    "InstrumentFacts",
    "Noise",
    "Parameters",
    "SessionFacts",
    "from_document",
    "json_ready",
    "load",
    "parameter_schema",
    "to_document",
    "to_toml",
    "write_document",
    "write_parameters",
]


def __getattr__(name: str) -> Any:
    """Hand on the names that stood here when this was a module; imported on first use."""
    if name in __all__:
        return getattr(importlib.import_module("imufield.deliver.parameters.file"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
