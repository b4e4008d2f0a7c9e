"""The documentation names what exists: links, commands, reasons, keys, code that compiles."""

from __future__ import annotations

import ast
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from imufield import errors
from imufield.cli.app import make_app
from imufield.cli.run import run
from imufield.commands.options.configuration import KEYS
from imufield.deliver.parameters.file import parameter_schema
from imufield.errors import ImufieldError, Reason

PROJECT = Path(__file__).resolve().parent.parent
PAGES = sorted([*PROJECT.glob("*.md"), *(PROJECT / "docs").rglob("*.md")])
page = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(PROJECT).as_posix())


def fenced(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


@page
def test_links_lead_somewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        assert target.startswith("https://") or (path.parent / target).exists(), f"{target} does not exist"


@page
def test_code_is_code(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for block in fenced(text, "python"):
        ast.parse(block)
    for block in fenced(text, "toml"):
        tomllib.loads(block)


@page
def test_commands_and_options_exist(path: Path) -> None:
    commands = get_command(make_app()).commands  # type: ignore[attr-defined]  # the app is a group
    text = path.read_text(encoding="utf-8")
    for command, rest in re.findall(r"(?:^\s{4,}|`|&& )imufield ([a-z][a-z-]*)([^`\n&]*)", text, flags=re.MULTILINE):
        assert command in commands, f"imufield {command}"
        known = {option for parameter in commands[command].params for option in parameter.opts} | {"--help"}
        for option in re.findall(r"(?<=\s)--[a-z][a-z-]*", rest):
            assert option in known, f"imufield {command} {option}"


def test_a_plan_prints_what_the_program_says(capsys: pytest.CaptureFixture[str]) -> None:
    """Every indented ``imufield plan`` that is followed by indented lines."""
    texts = [path.read_text(encoding="utf-8") for path in PAGES]
    printed = [
        pair for text in texts for pair in re.findall(r"^ {4}imufield (plan .*)\n\n((?: {4}.+\n)+)", text, flags=re.MULTILINE)
    ]
    assert printed
    for command, lines in printed:
        assert run(shlex.split(command)) == 0
        assert capsys.readouterr().out.splitlines() == [line.strip() for line in lines.splitlines()]


def test_every_reason_and_exit_code_has_a_row() -> None:
    text = (PROJECT / "docs" / "errors.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `(\w+)` \|", text, flags=re.MULTILINE) == [reason.value for reason in Reason]
    for one in (value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, ImufieldError)):
        row = re.search(rf"^\| {one.exit_code} \|[^|]+\| `{one.__name__}`[^|]*\|([^|]+)\|$", text, flags=re.MULTILINE)
        assert one is ImufieldError or (row and len(row[1]) > 20), f"{one.__name__} has no row with a remedy"


def _keys(rule: dict[str, Any], above: str = "") -> Iterator[str]:
    for name, inner in rule.get("properties", {}).items():
        yield name
        yield from _keys(inner, name)
    yield from _keys(rule["items"], above) if "items" in rule else ()


def test_every_key_of_the_parameter_file_is_described() -> None:
    text = (PROJECT / "docs" / "parameter-file.md").read_text(encoding="utf-8")
    known = set(re.findall(r"`([a-z0-9_]+)`", text)) | set(re.findall(r"`\[+([a-z_.]+)\]+`", text))
    known |= {name.partition(".")[2] for name in known if "." in name}
    assert set(_keys(parameter_schema())) <= known


def test_every_default_and_variable_is_described() -> None:
    text = (PROJECT / "docs" / "file-formats.md").read_text(encoding="utf-8").partition("## Defaults")[2]
    rows = re.findall(r"^\|(.*?)\|(.*?)\|(.*?)\|", text, flags=re.MULTILINE)
    found = [(keys, set(re.findall(r"`([\w-]+)`", commands))) for keys, _, commands in rows]
    described = {key: commands for keys, commands in found for key in re.findall(r"`(\w+)`", keys)}
    assert described == {key: set(commands) for key, commands in KEYS.items()}
    source = "".join(path.read_text(encoding="utf-8") for path in (PROJECT / "imufield").rglob("*.py"))
    variables = {name for name in re.findall(r"\bIMUFIELD_\w+", source) if name != "IMUFIELD_"}
    assert {name for _, cell, _ in rows for name in re.findall(r"IMUFIELD_\w+", cell)} == variables
