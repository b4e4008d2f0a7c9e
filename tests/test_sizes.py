"""What fits on a screen can be read: functions of 60 lines at most, modules of 600."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
FILES = sorted([*(PROJECT / "imufield").rglob("*.py"), *(PROJECT / "drivers").rglob("*.py")])
LONGEST_FUNCTION = 60
"""Lines from the first statement to the last: a command declares each of its options in a line of its signature."""
LONGEST_MODULE = 600


def lengths(source: str) -> Iterator[tuple[str, int]]:
    """Yield the name of every function and the lines of its body, docstring left out."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None and len(node.body) > 1 else node.body
            yield node.name, (body[-1].end_lineno or 0) - body[0].lineno + 1


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PROJECT).as_posix())
def test_sizes(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    too_long = {name: lines for name, lines in lengths(source) if lines > LONGEST_FUNCTION}
    assert not too_long, "cut it along its meaning"
    assert len(source.splitlines()) <= LONGEST_MODULE


def test_lines_are_counted_from_the_first_statement() -> None:
    source = 'def f(\n    a,\n    b,\n):\n    """Do\n    it."""\n    c = a\n\n    return c\n'
    assert list(lengths(source)) == [("f", 3)]
