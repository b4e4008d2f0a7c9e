"""Every command with every file it takes, in every state a file can be in: one sentence and the code docs/errors.md gives."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imufield.cli.run import run

CONFIGURATION, DATA, PARAMETERS = 2, 4, 5

STATES: dict[str, Callable[[Path], object]] = {
    "missing": lambda path: None,
    "a folder": Path.mkdir,
    "empty": Path.touch,
    "rubbish": lambda path: path.write_bytes(b"\xff\x00" + np.random.default_rng(1).bytes(3000)),
    "a text": lambda path: path.write_text("Dear diary,\nnothing.\n"),
}

READ = {
    "solve BAD": DATA,
    "solve --observations BAD": DATA,
    "solve S --preset BAD": PARAMETERS,
    "apply BAD S -o out.csv": PARAMETERS,
    "apply S/parameters.toml BAD -o out.csv": DATA,
    "export BAD --to c -o out.h": PARAMETERS,
    "verify BAD S": PARAMETERS,
    "verify S/parameters.toml BAD": DATA,
    "verify S/parameters.toml S --preset BAD": PARAMETERS,
    "import BAD -o new": DATA,
    "import BAD --protocol stim300 -o new": DATA,
    "import S/parameters.toml --protocol BAD -o new": DATA,
    "report BAD": DATA,
    "report S --parameters BAD": PARAMETERS,
    "report S --preset BAD": PARAMETERS,
    "history BAD": PARAMETERS,
    "noise BAD": DATA,
    "noise S --parameters BAD": PARAMETERS,
    "replay BAD": DATA,
    "export-data BAD": DATA,
    "capture --port loop:// --protocol BAD": DATA,
    "capture --port loop:// --positions BAD": CONFIGURATION,
    "record --port loop:// --protocol BAD": DATA,
    "emulate stim300 --positions BAD": CONFIGURATION,
}
"""What a command reads, and the code where it cannot."""

WRITTEN = {
    "solve S -o BAD": PARAMETERS,
    "export S/parameters.toml --to c -o BAD/below": PARAMETERS,
    "apply S/parameters.toml S -o BAD": DATA,
    "export-data S -o BAD": DATA,
    "report S -o BAD": PARAMETERS,
    "verify S/parameters.toml S -o BAD": PARAMETERS,
    "history . --csv BAD": PARAMETERS,
    "import rows.csv --rate-hz 100 -o BAD": DATA,
}
"""What a command writes, and the code where it cannot."""


@pytest.fixture
def folder(solved_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(solved_session, tmp_path / "S")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def one_sentence(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert "Traceback" not in captured.err
    assert sum(line.startswith("imufield: ") for line in lines) == 1, captured.err
    assert lines[-1].startswith("imufield: ")
    assert lines[-1].endswith(".")
    return lines[-1]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("command", READ)
def test_a_file_that_cannot_be_used(command: str, state: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    STATES[state](folder / "bad.file")
    before = sorted(folder.rglob("*"))
    code = run(command.replace("BAD", "bad.file").split())
    sentence = one_sentence(capsys)
    assert code == READ[command], sentence
    assert "bad.file" in sentence
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("place", ["a file in the way", "no such folder"])
@pytest.mark.parametrize("command", WRITTEN)
def test_a_place_that_cannot_be_written(command: str, place: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "rows.csv").write_text("ax,ay,az,gx,gy,gz\n" + "0.1,0.2,9.8,0,0,0\n" * 50)
    (folder / "way").touch()
    name = "way/below" if place == "a file in the way" else "/proc/none/below"
    code = run(command.replace("BAD", name).split())
    sentence = one_sentence(capsys)
    assert code == WRITTEN[command], sentence
    assert name in sentence
