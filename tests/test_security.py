"""No file and no wire runs code: the syntax tree of every file, and the limits that SECURITY.md names."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.sources import modules

PROJECT = Path(__file__).resolve().parent.parent
BANNED_MODULES = {
    "pickle",
    "cPickle",
    "dill",
    "cloudpickle",
    "joblib",
    "marshal",
    "shelve",
    "yaml",
    "jsonpickle",
    "pty",
    "code",
}
BANNED_CALLS = {
    *("eval", "exec", "compile", "__import__"),
    *("os.system", "os.popen", "os.execv", "os.execvp", "os.execl", "os.spawnl", "os.spawnv", "os.startfile"),
    *("subprocess.getoutput", "subprocess.getstatusoutput", "builtins.eval", "builtins.exec"),
    *("pandas.read_pickle", "torch.load", "allantools.Dataset.load"),
}
BANNED_OPTIONS = {"shell", "allow_pickle"}
MAY_START_PROGRAMS = {
    "imufield/guide/view/sound.py",
    "imufield/commands/terminal/emulated.py",
    "imufield/acquire/formats/can_logs.py",
    "imufield/acquire/formats/table_arrays.py",
    "imufield/web/jobs.py",
}
MAY_USE = {
    # A dataclass is made of the names of fields in the code.
    ("imufield/dataclass.py", "exec"),
    # Over a pipe to a process of its own, as multiprocessing itself does.
    ("imufield/acquire/decoding_process.py", "pickle"),
}
SAMPLES = {
    "import pickle": "pickle",
    "from yaml import load": "yaml",
    "import numpy\nnumpy.load(f, allow_pickle=True)": "allow_pickle",
    "import subprocess\nsubprocess.run(x, shell=True)": "shell",
    "eval('1')": "eval",
    "import os as o\no.system('x')": "os.system",
    "from os import system as s\ns('x')": "os.system",
    "import importlib\nimportlib.import_module('pickle')": "pickle",
}


def names_of(tree: ast.AST) -> dict[str, str]:
    """Return what each imported name stands for."""
    names: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {one.asname or one.name.partition(".")[0]: one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {one.asname or one.name: f"{node.module}.{one.name}" for one in node.names}
    return names


def called(node: ast.expr, names: dict[str, str]) -> str:
    if isinstance(node, ast.Name):
        return names.get(node.id, node.id)
    return f"{called(node.value, names)}.{node.attr}" if isinstance(node, ast.Attribute) else ""


def imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (one.name for one in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module:
        yield node.module
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "import_module":
        yield from (str(one.value) for one in node.args if isinstance(one, ast.Constant))


def breaches(tree: ast.AST) -> Iterator[str]:
    names = names_of(tree)
    for node in ast.walk(tree):
        yield from (name for name in imported(node) if name.partition(".")[0] in BANNED_MODULES)
        if isinstance(node, ast.Call):
            name = called(node.func, names)
            yield from [name] if name in BANNED_CALLS else []
            for option in node.keywords:
                off = isinstance(option.value, ast.Constant) and option.value.value is False
                yield from [str(option.arg)] if option.arg in BANNED_OPTIONS and not off else []


def printing(tree: ast.AST) -> set[str]:
    """Return the ways to print that are called as they are written, whatever was imported under that name."""
    ways = {"print", "Console", "typer.echo", "typer.secho", "sys.stdout.write", "sys.stderr.write"}
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return {called(call, {}) for call in calls if isinstance(call, ast.Name | ast.Attribute)} & ways


@pytest.mark.parametrize(("text", "what"), SAMPLES.items())
def test_the_check_finds_what_it_looks_for(text: str, what: str) -> None:
    assert what in list(breaches(ast.parse(text)))


def test_no_file_runs_what_it_reads() -> None:
    found = [(name, breach) for name, module in modules().items() for breach in breaches(module.tree)]
    assert [(name, breach) for name, breach in found if (name, breach.partition(".")[0]) not in MAY_USE] == []
    # A permit that nobody uses hides the next one who does.
    assert {(name, breach.partition(".")[0]) for name, breach in found} >= MAY_USE


def test_few_files_can_start_programs() -> None:
    wanted = ((name, one) for name, module in modules().items() for node in ast.walk(module.tree) for one in imported(node))
    assert {name for name, one in wanted if one.partition(".")[0] == "subprocess"} <= MAY_START_PROGRAMS


def test_programs_get_lists_and_nothing_of_the_wire() -> None:
    # What sound says is made of constants and axis names: `tests/guide/view/test_sound.py` feeds it hostile texts.
    for name in MAY_START_PROGRAMS:
        tree = modules()[name].tree
        names = names_of(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and called(node.func, names) in ("subprocess.run", "subprocess.Popen"):
                assert isinstance(node.args[0], (ast.List, ast.Name)), f"{name}: a program needs a list of arguments"


def test_the_limits_named_are_those_of_the_code() -> None:
    text = (PROJECT / "SECURITY.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| `([\w.]+)` \| ([\d.e]+) \| [^|]{10,} \|$", text, flags=re.MULTILINE)
    assert len(rows) >= 15
    for place, value in rows:
        module, _, constant = place.rpartition(".")
        assert getattr(importlib.import_module(module), constant) == float(value), place


MAY_PRINT = {
    "imufield/acquire/formats/foreign_file_reader.py",  # To the program that started it, never to a terminal.
    "imufield/commands/terminal/output.py",
    "imufield/console.py",
    "imufield/cli/__init__.py",  # The version.
    "imufield/cli/app.py",  # The same.
    "imufield/progress.py",  # A line, made printable there.
}


def test_all_that_is_printed_goes_through_one_place() -> None:
    found = {name: printing(module.tree) for name, module in modules().items()}
    assert {name: ways for name, ways in found.items() if ways and name not in MAY_PRINT} == {}
