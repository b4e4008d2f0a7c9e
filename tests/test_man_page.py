"""The man page: every command and option of the program, and no mistake that the formatter sees."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest
from typer.main import get_command

from imufield.cli.app import make_app
from imufield.errors import ImufieldError

MAN_PAGE = Path(__file__).resolve().parent.parent / ".ci" / "man_page.py"


@pytest.fixture(scope="module")
def page() -> str:
    return str(runpy.run_path(str(MAN_PAGE))["man_page"]())


def test_all_that_help_says_is_there(page: str) -> None:
    plain = page.replace("\\-", "-")
    headings = re.findall(r"^\.SH (.*)$", page, flags=re.MULTILINE)
    assert headings == ["NAME", "SYNOPSIS", "OPTIONS", "COMMANDS", "ENVIRONMENT", "FILES", "EXIT STATUS"]
    for name, command in get_command(make_app()).commands.items():  # type: ignore[attr-defined]  # the app is a group
        section = plain.partition(f"\n.SS imufield {name}")[2].partition("\n.S")[0]
        for one in command.params:
            if one.param_type_name == "option" and not one.hidden:
                assert f"\n.B {', '.join((*one.opts, *one.secondary_opts))}" in section
                assert " ".join(one.help.split()).replace("`", "") in section
        assert f"$ imufield {name}" in section
    for kind in ImufieldError.__subclasses__():
        assert f"\n.TP\n{kind.exit_code}\n" in page


def test_no_line_is_taken_for_a_request(page: str) -> None:
    known = {".TH", ".SH", ".SS", ".TP", ".B", ".I", ".RI", ".PP", ".nh", ".ad", ".nr", ".ds"}
    assert {line.split()[0] for line in page.splitlines() if line.startswith((".", "'"))} <= known


@pytest.mark.skipif(shutil.which("groff") is None, reason="needs groff")
def test_the_formatter_has_no_objection(page: str) -> None:
    done = subprocess.run(
        ["groff", "-man", "-Tutf8", "-ww", "-rLL=78n"], input=page, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    # Bold and underlined letters are sequences, or printed twice.
    shown = re.sub(r"\x1b\[[0-9;]*m|.\x08", "", done.stdout)
    assert max(map(len, shown.splitlines())) <= 80
    # What is to be copied stays whole.
    assert "slcan:/dev/ttyACM0" in shown
    assert "$ imufield capture --port /dev/ttyUSB0 --latitude 48.1 --height 520" in shown
