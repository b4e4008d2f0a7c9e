"""The program's own modules, read and parsed once for all tests that look at them."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

PROJECT = Path(__file__).resolve().parent.parent


@cache
def house() -> ModuleType:
    """Return the program that measures the house."""
    spec = importlib.util.spec_from_file_location("house", PROJECT / ".ci" / "house.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Its dataclass looks up the module it stands in.
    sys.modules["house"] = module
    spec.loader.exec_module(module)
    return module


@cache
def modules() -> dict[str, Any]:
    """Return every module of imufield and its drivers, by its path in the project."""
    return {module.path.relative_to(PROJECT).as_posix(): module for module in house().modules()}
