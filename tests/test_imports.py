"""Imports point down only, and never in a circle (CONTRIBUTING.md has the picture, .ci/house.py the order of rooms)."""

from __future__ import annotations

import ast

from tests.sources import PROJECT, house, modules


def test_imports_point_down() -> None:
    assert house().arrows_up(modules().values()) == []


def test_no_import_goes_in_a_circle() -> None:
    assert house().circles(house().graph(modules().values())) == []


def test_every_folder_says_in_a_line_what_lives_there() -> None:
    for module in modules().values():
        if module.path.name == "__init__.py":
            first = (ast.get_docstring(module.tree) or "").partition("\n")[0]
            assert len(first) > 20, module.path


def test_the_check_of_arrows_bites() -> None:
    def module(name: str, source: str) -> object:
        path = PROJECT / "imufield" / (name.replace(".", "/") + ".py")
        return house().Module(path, name, source, ast.parse(source))

    low = module("acquire.link.serial", "def f():\n    from imufield.guide.lead.guide import Guide\n")
    high = module("guide.lead.guide", "from imufield.acquire.link import serial\n")
    assert house().arrows_up([low, high]) == ["acquire.link.serial (acquire/link) -> guide.lead.guide (guide/lead)"]
    assert house().circles(house().graph([low, high])) == [["acquire.link.serial", "guide.lead.guide"]]


def test_drivers_are_imported_under_their_installed_name() -> None:
    for module in modules().values():
        for node in ast.walk(module.tree):
            origin = node.module if isinstance(node, ast.ImportFrom) else None
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [origin or ""]
            assert not any(name.split(".")[0] in ("drivers", "protocols") for name in names), f"{module.path}: a second copy"


def test_every_command_starts_fast() -> None:
    """The command line imports its commands when they run, so that `imufield --help` comes at once."""
    for module in modules().values():
        if module.room == "cli":
            top = [node for node in module.tree.body if isinstance(node, ast.ImportFrom)]
            above = [name for name in (node.module or "" for node in top) if name.startswith("imufield.commands")]
            assert all(name.startswith("imufield.commands.options") for name in above), module.path.name


def test_options_are_light() -> None:
    """Every start of the program reads them: of imufield they import nothing that imports NumPy."""
    light = (
        "imufield.errors",
        "imufield.sentences",
        "imufield.files",
        "imufield.limits",
        "imufield.dataclass",
        "imufield.toml_and_json",
        "imufield.commands.options",
    )
    for module in modules().values():
        if module.name.startswith("commands.options"):
            top = [node.module or "" for node in module.tree.body if isinstance(node, ast.ImportFrom)]
            assert all(name.startswith(light) for name in top if name.startswith("imufield")), module.path.name
