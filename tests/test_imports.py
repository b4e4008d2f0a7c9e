"""Imports point down only, and never in a circle (CONTRIBUTING.md has the picture, .ci/house.py the order of rooms)."""

from __future__ import annotations

import ast
import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

PROJECT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
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


@pytest.fixture(scope="module")
def modules(house: ModuleType) -> list[Any]:
    """Return every module of the program, read and parsed once for all tests here."""
    return list(house.modules())


def test_imports_point_down(house: ModuleType, modules: list[Any]) -> None:
    assert house.arrows_up(modules) == []


def test_no_import_goes_in_a_circle(house: ModuleType, modules: list[Any]) -> None:
    assert house.circles(house.graph(modules)) == []


def test_every_folder_says_in_a_line_what_lives_there(modules: list[Any]) -> None:
    for module in modules:
        if module.path.name == "__init__.py":
            first = (ast.get_docstring(module.tree) or "").partition("\n")[0]
            assert len(first) > 20, module.path


def test_the_check_of_arrows_bites(house: ModuleType) -> None:
    def module(name: str, source: str) -> object:
        path = PROJECT / "imufield" / (name.replace(".", "/") + ".py")
        return house.Module(path, name, source, ast.parse(source))

    low = module("acquire.link.serial", "def f():\n    from imufield.guide.lead.guide import Guide\n")
    high = module("guide.lead.guide", "from imufield.acquire.link import serial\n")
    assert house.arrows_up([low, high]) == ["acquire.link.serial (acquire/link) -> guide.lead.guide (guide/lead)"]
    assert house.circles(house.graph([low, high])) == [["acquire.link.serial", "guide.lead.guide"]]


def test_drivers_are_imported_under_their_installed_name(modules: list[Any]) -> None:
    for module in modules:
        for node in ast.walk(module.tree):
            origin = node.module if isinstance(node, ast.ImportFrom) else None
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [origin or ""]
            assert not any(name.split(".")[0] in ("drivers", "protocols") for name in names), f"{module.path}: a second copy"


def test_every_command_starts_fast(modules: list[Any]) -> None:
    """The command line imports its commands when they run, so that `imufield --help` comes at once."""
    for module in modules:
        if module.room == "cli":
            top = [node for node in module.tree.body if isinstance(node, ast.ImportFrom)]
            above = [name for name in (node.module or "" for node in top) if name.startswith("imufield.commands")]
            assert all(name.startswith("imufield.commands.options") for name in above), module.path.name


def test_options_are_light(modules: list[Any]) -> None:
    """Every start of the program reads them: of imufield they import nothing that imports NumPy."""
    light = (
        "imufield.errors",
        "imufield.sentences",
        "imufield.files",
        "imufield.limits",
        "imufield.commands.configuration",
        "imufield.commands.options",
    )
    for module in modules:
        if module.name.startswith("commands.options"):
            top = [node.module or "" for node in module.tree.body if isinstance(node, ast.ImportFrom)]
            assert all(name.startswith(light) for name in top if name.startswith("imufield")), module.path.name
