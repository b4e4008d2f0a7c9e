"""The parameter file: written, read, checked, converted and applied."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imufield.deliver.parameters.file import *  # noqa: F403  (``__all__`` there is the list)


def __getattr__(name: str) -> object:
    """Hand on the names of ``file``; imported on first use, because NumPy takes longer than a prompt should wait."""
    file = importlib.import_module("imufield.deliver.parameters.file")
    if name in file.__all__:
        return getattr(file, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
