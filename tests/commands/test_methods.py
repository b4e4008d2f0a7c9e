"""``imufield solve`` by another method, for both triads."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from tests.commands.conftest import Program


def test_a_method_solves_both_triads_and_a_cross_check_covers_both(program: Program, solved_session: Path) -> None:
    shutil.copytree(solved_session, program.folder / "session")
    ended = program.run("solve", "session", "--latitude", 48, "--json")
    assert ended.returncode == 0, ended.stderr
    plain = json.loads(ended.stdout)
    # What the summary says of it in one line.
    assert plain["error_at_rest"]["before_mg"] > plain["error_at_rest"]["after_mg"] > 0.0
    assert f"{plain['error_at_rest']['after_mg']:.3g} mg after" in plain["error_at_rest"]["words"]
    ended = program.run("solve", "session", "--latitude", 48, "--json", "--method", "bsas", "--cross-check")
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    reasons = found["quality"]["reasons"]
    for triad in ("accelerometer", "gyroscope"):
        assert any(reason.startswith(f"bsas, ide, least-squares agree on the {triad}: ") for reason in reasons)
        sigma = np.array(plain[triad]["uncertainty"]["scale"])
        assert np.all(np.abs(np.array(found[triad]["scale"]) - plain[triad]["scale"]) <= 0.02 * sigma)
    assert any(reason.startswith("gyroscope solved by bsas: ") for reason in reasons)
    assert found["quality"]["verdict"] == plain["quality"]["verdict"]


def test_a_method_that_does_not_arrive_makes_a_poor_verdict(program: Program, solved_session: Path) -> None:
    shutil.copytree(solved_session, program.folder / "session")
    ended = program.run("solve", "session", "--latitude", 48, "--json", "--method", "bas")
    found = json.loads(ended.stdout)
    assert found["quality"]["verdict"] == "poor"
    reasons = found["quality"]["reasons"]
    # Behind the summary, what lowered the verdict comes first.
    assert reasons[1].startswith("the gyroscope's fit by bas did not converge")


def test_settings_of_a_method_reach_both_triads(program: Program, solved_session: Path) -> None:
    shutil.copytree(solved_session, program.folder / "session")
    short = ("solve", "session", "--latitude", 48, "--json", "--no-polish", "--method", "ide")
    ended = program.run(*short, "--set", "population=8", "--set", "EG=3")
    reasons = json.loads(ended.stdout)["quality"]["reasons"]
    # Three generations are not enough, and each triad says why.
    assert sum("ide did not converge" in reason for reason in reasons) == 2
    assert "3 generations" in json.loads(ended.stdout)["solver"]["message"]
    ended = program.run(*short, "--set", "beetles=8")
    assert ended.returncode == 2
    assert "beetles" in ended.stderr
