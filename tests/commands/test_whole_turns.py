"""Whole turns from the terminal to the parameter file: a virtual operator makes them, the guide sees, `solve` uses them."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from imufield import load
from imufield.acquire.recording.session import Session
from imufield.cli.run import run

if TYPE_CHECKING:
    from tests.commands.conftest import Program

BEFORE = re.compile(r"\(([+-]?\d\.\d+) deg with the earlier parameters\)")
CLOSURE = re.compile(r"(?:stop|vertical): closing error ([+-]?\d\.\d+) deg")


def gyroscope_path(session: Session) -> str:
    return str(load(session.folder / "parameters.toml").document["gyroscope"]["path"])


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("rolled", "6 of them whole turns about axes that are not vertical, checked against gravity at the end"),
        ("table", "6 whole turns about the vertical against a stop"),
    ],
)
def test_solve_closes_the_turns_that_the_guide_led(make_session: Callable[..., Session], kind: str, words: str) -> None:
    session = make_session("faces6", rotations=kind)
    assert run(["solve", str(session.folder)]) == 0
    assert words in gyroscope_path(session)
    shown = " ".join(load(session.folder / "parameters.toml").calibration.quality.reasons)
    closures = [float(text) for text in CLOSURE.findall(shown)]
    assert len(closures) == 6
    assert max(map(abs, closures)) < 0.1
    before = [float(text) for text in BEFORE.findall(shown)]
    assert len(before) == 6
    assert max(map(abs, before)) > 2 * max(map(abs, closures))


def test_turns_sharpen_the_scale(make_session: Callable[..., Session]) -> None:
    """One turn each way and axis makes the scale about twice as sharp, where no typical nonlinearity stands beside it."""
    session = make_session("paper24", rotations="rolled")
    assert run(["solve", str(session.folder), "--grade", "navigation"]) == 0
    with_turns = load(session.folder / "parameters.toml").document["gyroscope"]["uncertainty"]["scale"]
    session.update(guide={"hold_s": 4.0})
    assert run(["solve", str(session.folder), "--grade", "navigation"]) == 0
    without = load(session.folder / "parameters.toml").document["gyroscope"]["uncertainty"]["scale"]
    assert all(sharp < 0.65 * blunt for sharp, blunt in zip(with_turns, without, strict=True))


def test_the_emulated_operator_turns_and_the_program_sees_it(program: Program) -> None:
    port = program.emulate("--positions", "faces6", "--hold-s", 6, "--rotations", "rolled", "--wait", speed=8.0)
    options = ("--positions", "faces6", "--hold-s", 2, "--clock-speed", 8, "--rotations", "rolled", "--latitude", 48)
    captured = program.run("capture", "--port", port, "--driver", "stim300", *options, "--plain")
    assert captured.returncode == 0, captured.stderr
    session = Session.newest(program.folder / "imufield-sessions")
    assert session.finished
    solved = program.run("solve", session.folder)
    assert solved.returncode == 0, solved.stderr
    assert "whole turns about axes that are not vertical, checked against gravity at the end" in gyroscope_path(session)
