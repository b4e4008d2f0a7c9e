"""What fits on a screen can be read: functions of 60 lines at most, modules of 600."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.sources import modules

LONGEST_FUNCTION = 60
"""Lines from the first statement to the last: a command declares each of its options in a line of its signature."""
LONGEST_MODULE = 600


def lengths(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield the name of every function and the lines of its body, docstring left out."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None and len(node.body) > 1 else node.body
            yield node.name, (body[-1].end_lineno or 0) - body[0].lineno + 1


def test_functions() -> None:
    lines = [(path, *found) for path, module in modules().items() for found in lengths(module.tree)]
    assert [one for one in lines if one[2] > LONGEST_FUNCTION] == [], "cut it along its meaning"


def test_modules() -> None:
    lines = {path: len(module.source.splitlines()) for path, module in modules().items()}
    assert {path: number for path, number in lines.items() if number > LONGEST_MODULE} == {}


def test_lines_are_counted_from_the_first_statement() -> None:
    source = 'def f(\n    a,\n    b,\n):\n    """Do\n    it."""\n    c = a\n\n    return c\n'
    assert list(lengths(ast.parse(source))) == [("f", 3)]
