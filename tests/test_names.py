"""Docstrings that are contracts: every public name has one, and the parameters it documents are the real ones."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.sources import modules

PROJECT = Path(__file__).resolve().parent.parent
Documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def public(node: ast.AST, above: str = "") -> Iterator[tuple[str, Documented, ast.AST]]:
    """Yield name, definition and what it stands in, of everything public in a module."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Documented) and not child.name.startswith("_"):
            yield above + child.name, child, node
            if isinstance(child, ast.ClassDef):
                yield from public(child, f"{above}{child.name}.")


def section(docstring: str, title: str) -> list[str] | None:
    """Return the names a numpydoc section documents, or None where there is no such section."""
    lines = docstring.expandtabs().splitlines()
    indent = min((len(line) - len(line.lstrip()) for line in lines[1:] if line.strip()), default=0)
    lines = [lines[0], *(line[indent:] for line in lines[1:])]
    for i, line in enumerate(lines[:-1]):
        if line.strip() == title and re.fullmatch(r"-{3,}", lines[i + 1].strip()):
            return list(_entries(lines[i + 2 :]))
    return None


def _entries(lines: list[str]) -> Iterator[str]:
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        if re.fullmatch(r"-{3,}", following.strip()):
            return
        if line and not line[0].isspace():
            yield from (name.strip().lstrip("*") for name in line.partition(" :")[0].split(","))


def real_parameters(node: Documented) -> list[str]:
    """Return the parameters of a function, of a class's ``__init__``, or the fields of a dataclass."""
    if isinstance(node, ast.ClassDef):
        for child in node.body:
            if isinstance(child, ast.FunctionDef) and child.name == "__init__":
                return real_parameters(child)
        return fields(node)
    given = node.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    star = [one for one in (given.vararg, given.kwarg) if one is not None]
    return [one.arg for one in [*named, *star] if one.arg not in ("self", "cls")]


def fields(node: ast.ClassDef) -> list[str]:
    return [child.target.id for child in node.body if isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name)]


def is_overload(node: Documented) -> bool:
    return any(isinstance(one, ast.Name) and one.id in ("overload", "override") for one in node.decorator_list)


def wrong_docstrings(tree: ast.Module) -> Iterator[str]:
    if tree.body and not ast.get_docstring(tree):
        yield "the module has no docstring"
    for name, node, _ in public(tree):
        if is_overload(node):
            continue
        docstring = ast.get_docstring(node, clean=False)
        if not docstring:
            yield f"{name} has no docstring"
            continue
        documented = section(docstring, "Parameters")
        if documented is not None and sorted(documented) != sorted(real_parameters(node)):
            yield f"{name}: documented parameters are not the real ones"
        attributes = section(docstring, "Attributes")
        if attributes is not None and isinstance(node, ast.ClassDef) and fields(node):
            methods = [child.name for child in node.body if isinstance(child, ast.FunctionDef)]
            if not set(attributes) <= {*fields(node), *methods}:
                yield f"{name}: documented attributes are not the real ones"


def test_docstrings() -> None:
    assert [f"{path}: {wrong}" for path, module in modules().items() for wrong in wrong_docstrings(module.tree)] == []


def test_tests_mirror_the_tree() -> None:
    for path in sorted((PROJECT / "tests").rglob("test_*.py")):
        folder = path.parent.relative_to(PROJECT / "tests")
        # What is done to the program as a whole belongs to no room.
        known = folder.name == "torture" or (PROJECT / "imufield" / folder).is_dir() or (PROJECT / folder).is_dir()
        assert known, f"{path} belongs to no room"


def test_the_check_of_parameters_bites() -> None:
    (node,) = ast.parse('''
def f(a, *rest, b=1):
    """Do.

    Parameters
    ----------
    a, *rest : int
        Both.
    c : int

    Returns
    -------
    int
    """
''').body
    assert isinstance(node, ast.FunctionDef)
    assert section(ast.get_docstring(node, clean=False) or "", "Parameters") == ["a", "rest", "c"]
    assert real_parameters(node) == ["a", "b", "rest"]
