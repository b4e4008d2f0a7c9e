"""The instruments of the pages: emulated from their files as they stand there, then captured or recorded."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imufield.acquire.recording.session import Session
from imufield.cli.run import run
from imufield.earth import normal_gravity
from imufield.pipeline.chain import session_samples
from imufield.samples import concatenate
from imufield.simulate.truth.motion import Site

if TYPE_CHECKING:
    from tests.commands.conftest import Program

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")

DOCS = Path(__file__).resolve().parents[2] / "docs"
SPEED = 8


def fenced(page: str, kind: str, mark: str) -> str:
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = re.findall(rf"^```{kind}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    return next(str(block) for block in blocks if mark in block)


def captured(program: Program, who: list[str], how: list[str]) -> Session:
    """Emulate and capture six faces; return the session."""
    emulator = program.start(
        "emulate", *who, "--json", "--speed", SPEED, "--positions", "faces6", "--hold-s", 6, "--wait", "--grade", "mems"
    )
    assert emulator.stdout is not None
    line = emulator.stdout.readline()
    assert line, emulator.communicate()[1]
    reading = ("--positions", "faces6", "--hold-s", 2, "--clock-speed", SPEED, "--latitude", 45, "--plain", "--session", "mine")
    ended = program.run("capture", "--port", json.loads(line)["port"], *how, *reading)
    assert ended.returncode == 0, ended.stderr
    assert "6 of 6 positions measured" in ended.stdout
    assert "lack acceleration" not in ended.stdout
    solved = program.run("solve", "mine", "--json")
    assert solved.returncode == 0, solved.stderr
    return Session.open(program.folder / "mine")


def test_the_command_that_is_told_knows_the_place(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["emulate", "stim300", "--duration-s", "0.1", "--positions", "none"]) == 0
    told = shell_words(capsys.readouterr().out)
    place = {name: float(told[told.index(name) + 1]) for name in ("--latitude", "--height")}
    assert Site().gravity_m_s2 == normal_gravity(place["--latitude"], place["--height"])


@pytest.mark.parametrize("scheme", ["faces6", "paper24", "none"])
def test_the_command_that_is_told_asks_for_the_positions_that_come(scheme: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["emulate", "stim300", "--duration-s", "0.1", "--positions", scheme]) == 0
    told = shell_words(capsys.readouterr().out)
    # The usual ones need no word, and lying still is no scheme.
    asked = told[told.index("--positions") + 1] if "--positions" in told else None
    assert asked == {"faces6": "faces6"}.get(scheme)


def shell_words(out: str) -> list[str]:
    """Return the words of the command that is told, as a shell reads its lines."""
    return shlex.split(out[out.index("imufield capture") :].replace("\\\n", " ").partition("\n")[0])


@pytest.mark.parametrize("length", [0, 60])
def test_the_command_that_is_told_is_not_broken_in_a_word(
    length: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    link = "imu" + "x" * length
    typed = ["emulate", "stim300", "--rate-hz", "500", "--duration-s", "0.1", "--positions", "none", "--link", link]
    assert run([*typed, "--speed", "4"]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    command, _, *options = shell_words(out)
    assert command == "imufield"
    expected = {"--port": link, "--driver": "stim300", "--latitude": "45", "--height": "0", "--clock-speed": "4"}
    assert dict(zip(options[::2], options[1::2], strict=True)) == expected


def test_the_logger_of_the_page(program: Program) -> None:
    (program.folder / "my_logger.toml").write_text(fenced("protocols.md", "toml", 'name = "my_logger"'), encoding="utf-8")
    session = captured(program, ["my_logger.toml"], ["--protocol", "my_logger.toml"])
    samples = concatenate(list(session_samples(session, [])))
    assert np.all(samples.accelerometer == np.rint(samples.accelerometer))
    assert abs(np.median(samples.accelerometer) - 512) < 30
    assert abs(np.median(samples.temperature_degc) - 25) < 5


def test_the_driver_of_the_page(program: Program) -> None:
    site = program.folder / "site"
    (site / "my_package").mkdir(parents=True)
    (site / "my_package" / "__init__.py").touch()
    (site / "my_package" / "my_imu.py").write_text(fenced("protocols.md", "python", "MyImu"), encoding="utf-8")
    about = site / "my_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text("[imufield.drivers]\nmy_imu = my_package.my_imu:MyImu\n", encoding="utf-8")
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    program.variables["PYTHONPATH"] = os.pathsep.join(paths)
    session = captured(program, ["my_imu"], ["--driver", "my_imu"])
    assert session.metadata["settings"]["columns"]["value"] == "counter,ax,ay,az"
    samples = concatenate(list(session_samples(session, [])))
    assert np.median(np.linalg.norm(samples.accelerometer, axis=1)) == pytest.approx(9.8, abs=0.3)
    assert samples.counter[0] >= 0
