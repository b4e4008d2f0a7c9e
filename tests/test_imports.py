"""Imports point down only (CONTRIBUTING.md has the picture)."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
BASE = {"samples", "earth", "errors", "files", "__init__"}
MEASURE = BASE | {"acquire"}
USE = MEASURE | {"calibrate"}
MAY_IMPORT = {
    **dict.fromkeys(BASE, BASE),
    # The package itself hands out `load`, on first use.
    "__init__": {"deliver"},
    "acquire": MEASURE,
    "drivers": MEASURE | {"drivers"},
    "calibrate": USE,
    "guide": USE | {"guide"},
    "deliver": USE | {"deliver"},
    "study": USE | {"guide", "deliver", "simulate", "study"},
    "simulate": USE | {"guide", "deliver", "simulate"},
    "commands": USE | {"guide", "deliver", "simulate", "study", "commands"},
    "testing": USE | {"guide", "deliver", "simulate", "commands"},
    "cli": BASE | {"commands", "cli"},
    "__main__": {"cli"},
}
FILES = sorted([*(PROJECT / "imufield").rglob("*.py"), *(PROJECT / "drivers").rglob("*.py")])


def module_of(path: Path) -> list[str]:
    parts = list(path.relative_to(PROJECT).with_suffix("").parts)
    return parts if parts[0] == "imufield" else ["imufield", *parts]


def room_of(module: list[str]) -> str:
    return module[1] if len(module) > 1 else "__init__"


def imported(tree: ast.AST, module: list[str]) -> Iterator[list[str]]:
    """Yield every module of imufield that the code imports, at its top or later."""
    for node in ast.walk(tree):
        names: list[list[str]] = []
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = module[: len(module) - node.level] if node.level else []
            origin = [*above, *(node.module.split(".") if node.module else [])]
            # `from imufield import samples` names a room, `from imufield import __version__` does not.
            names = [[*origin, alias.name] for alias in node.names] if len(origin) == 1 else [origin]
        yield from (name for name in names if name[0] in ("imufield", "drivers", "protocols"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PROJECT).as_posix())
def test_imports_point_down(path: Path) -> None:
    module = module_of(path)
    room = room_of(module)
    assert room in MAY_IMPORT, f"{room} is a new room: give it a place in MAY_IMPORT and in CONTRIBUTING.md"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for name in imported(tree, module):
        assert name[0] == "imufield", f"import imufield.{name[0]}, not {name[0]}: the second copy has other classes"
        wanted = room_of(name)
        if wanted in ("__version__", "__init__"):
            continue
        assert wanted in MAY_IMPORT[room], f"{room} must not import {'.'.join(name)}"


def test_the_core_names_no_driver() -> None:
    drivers = {path.stem for path in (PROJECT / "drivers").glob("*.py")} - {"__init__"}
    for path in (PROJECT / "imufield").rglob("*.py"):
        for name in imported(ast.parse(path.read_text(encoding="utf-8")), module_of(path)):
            assert name[1:2] != ["drivers"] or name[-1] not in drivers, f"{path.name} imports the driver {name[-1]}"


def test_every_command_starts_fast() -> None:
    """The command line imports its commands when they run, so that `imufield --help` comes at once."""
    for path in (PROJECT / "imufield" / "cli").glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        top = ast.Module([node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))], [])
        assert not [name for name in imported(top, module_of(path)) if room_of(name) == "commands"], path.name
