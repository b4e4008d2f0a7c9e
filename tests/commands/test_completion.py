"""What Tab completes: the program asked as the shells ask it, and bash itself with the script that is installed.

The shells say what they ask for in variables: one start of the program for each shell is enough to see that it looks there.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from imufield.acquire.registry import driver_names
from imufield.cli.run import run
from imufield.deliver.exports import TARGETS

IMUFIELD = [sys.executable, "-m", "imufield"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working folder with sessions, one of them of somebody who wishes no good."""
    for name in ("imufield-sessions/20260301T101500Z-stim300", "my-session", "imufield-sessions/$(touch stolen)", "a b"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "session.toml").touch()
    (tmp_path / "home").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


Answers = Callable[[dict[str, str]], str]


@pytest.fixture
def answered(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Answers:
    """Return what this process writes for the variables that a shell sets."""

    def answer(variables: dict[str, str]) -> str:
        with monkeypatch.context() as patch:
            for name, value in ({"HOME": str(folder / "home")} | variables).items():
                patch.setenv(name, value)
            assert run([]) == 0
        told = capsys.readouterr()
        assert told.err == ""
        return told.out

    return answer


def asked(folder: Path, variables: dict[str, str]) -> str:
    environment = {**os.environ, "HOME": str(folder / "home"), "_TYPER_FORCE_DISABLE_TERMINAL": "1", **variables}
    done = subprocess.run(IMUFIELD, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout


def completed(answered: Answers, words: str) -> set[str]:
    """Return what bash gets for a line; a line that ends in a blank begins another word."""
    number = len(shlex.split(words)) - (not words.endswith(" "))
    shown = answered({"_IMUFIELD_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(number)})
    return set(shown.split("\n")) - {""}


SESSIONS = {"imufield-sessions/20260301T101500Z-stim300", "my-session"}


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("imufield exp", {"export", "export-data"}),
        ("imufield capture --driver stim", {"stim300"}),
        ("imufield emulate ", set(driver_names())),
        ("imufield devices witm", {"witmotion"}),
        ("imufield export my-session --to ", set(TARGETS)),
        ("imufield export my-session --to=px", {"px4"}),
        ("imufield solve ", SESSIONS),
        ("imufield solve my-session imu", {"imufield-sessions/20260301T101500Z-stim300"}),
        ("imufield export my", {"my-session"}),
        ("imufield capture --session ", SESSIONS),
        ("imufield capture --target-b", {"--target-bias-ug"}),
    ],
)
def test_names(answered: Answers, words: str, wanted: set[str]) -> None:
    assert completed(answered, words) == wanted


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_the_same(folder: Path, shell: str) -> None:
    variables = {"_IMUFIELD_COMPLETE": f"complete_{shell}", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    shown = asked(folder, {**variables, "_TYPER_COMPLETE_ARGS": "imufield capture --driver novatel"})
    assert "novatel_oem7_ascii" in shown
    assert "stim300" not in shown


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_has_a_script(answered: Answers, shell: str) -> None:
    assert "complete_" + shell in answered({"_IMUFIELD_COMPLETE": f"source_{shell}"})


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_what_is_installed(folder: Path) -> None:
    """As a person does it: install, open a shell, press Tab."""
    program = folder / "imufield"
    program.write_text(f'#!/bin/sh\nexec {shlex.join(IMUFIELD)} "$@"\n')
    program.chmod(0o755)
    environment = {**os.environ, "HOME": str(folder / "home"), "PATH": f"{folder}:{os.environ['PATH']}"}

    def bash(script: str) -> str:
        command = ["bash", "--noprofile", "--norc", "-c", script]
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True).stdout

    # The shell is found by the processes above the program.
    assert "bash completion installed" in bash("imufield --install-completion; true")
    pressed = 'COMP_WORDS=(imufield solve my); COMP_CWORD=2; _imufield_completion imufield; printf "%s\\n" "${COMPREPLY[@]}"'
    assert bash(f"source ~/.bashrc; {pressed}") == "my-session\n"
    assert not (folder / "stolen").exists()


def test_ports(folder: Path) -> None:
    code = """
import sys
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo
list_ports.comports = lambda: [ListPortInfo("/dev/ttyUSB7")]
sys.argv = ["imufield"]
from imufield.cli import main
main()
"""
    variables = {"_IMUFIELD_COMPLETE": "complete_bash", "COMP_WORDS": "imufield record --port ", "COMP_CWORD": "3"}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **variables}, cwd=folder, capture_output=True, text=True, check=True
    )
    assert done.stdout == "/dev/ttyUSB7\n"


def test_nothing_heavy_is_imported(folder: Path) -> None:
    code = """
import os, sys
from imufield.cli.run import run
for words in ("imufield devices ", "imufield export --to ", "imufield solve ", "imufield capture --port "):
    os.environ.update(_IMUFIELD_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(len(words.split())))
    assert run([]) == 0
print(sorted({"numpy", "scipy", "can", "cantools", "mcap", "matplotlib", "rich.console"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
