"""A position that the user leaves out: what is calibrated, and where it is shown."""

from __future__ import annotations

import csv
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest

from imufield.cli.run import run
from imufield.deliver.parameters.file import load
from imufield.errors import Reason
from tests.commands.told import fails, missing, says


@pytest.fixture
def session(solved_session: Path, tmp_path: Path) -> Path:
    """Return a session that was solved with all its positions."""
    shutil.copytree(solved_session, tmp_path / "session")
    return tmp_path / "session"


def document(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


def test_a_position_that_is_left_out_is_shown_everywhere_and_used_nowhere(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = document(session / "parameters.toml")["position"][4]["name"]
    assert run(["solve", str(session), "--without", name]) == 0
    shown = capsys.readouterr().out
    assert not missing(shown, "not used")
    found = document(session / "parameters.toml")
    assert {position["name"] for position in found["position"] if not position["used"]} == {name}
    assert found["session"]["positions"] == len(found["position"])
    left_out = next(position for position in found["position"] if not position["used"])
    whole = document(session / "parameters-1.toml")
    predicted = next(position for position in whole["position"] if position["name"] == name)["leave_one_out_m_s2"]
    # A fit without it, and the linearised forecast of one.
    assert left_out["leave_one_out_m_s2"] == pytest.approx(predicted, rel=0.1)
    assert any(not missing(reason, name, "excluded") for reason in found["quality"]["reasons"])
    assert len(whole["position"]) - whole["quality"]["parameters_fitted"] - 1 == found["quality"]["degrees_of_freedom"]
    load(session / "parameters.toml")
    assert run(["verify", str(session / "parameters.toml"), str(session)]) == 0
    assert run(["report", str(session)]) == 0
    assert name in (session / "report.html").read_text(encoding="utf-8")
    capsys.readouterr()
    assert run(["replay", str(session)]) == 0
    assert says(capsys.readouterr().out, "commands", "replay.left_out", file="parameters.toml", names=[name])


def test_a_name_that_is_not_there_is_refused_with_those_that_are(session: Path) -> None:
    fails(["solve", str(session), "--without", "x+1"], 2, Reason.USAGE, "x+1", "x+0", key="observations.not_there")


def test_means_of_a_file_may_lack_what_a_session_at_another_temperature_has(session: Path, tmp_path: Path) -> None:
    table = tmp_path / "means.csv"
    rows = [",".join(map(str, position["mean_raw"])) for position in document(session / "parameters.toml")["position"]]
    table.write_text("\n".join(["ax,ay,az", *rows]), encoding="utf-8")
    # The message names what all of them have: it comes once every session was read.
    fails(
        ["solve", "--observations", str(table), "--temperature", str(session), "--without", "nowhere"],
        2,
        Reason.USAGE,
        "x+0",
        key="observations.not_there",
    )


def test_a_touched_hold_is_poor_and_what_the_sentence_says_to_type_cures_it(session: Path, tmp_path: Path) -> None:
    clean = document(session / "parameters.toml")
    table, path = tmp_path / "means.csv", tmp_path / "found.toml"
    with table.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow([*(f"{kind}{axis}" for kind in ("a", "sigma_a") for axis in "xyz"), "name"])
        for number, position in enumerate(clean["position"]):
            moved = 1.02 if number == 4 else 1.0
            rows.writerow([*(moved * value for value in position["mean_raw"]), *position["sigma_raw"], position["name"]])
    arguments = [
        "solve",
        "--observations",
        str(table),
        "--gravity",
        f"{clean['site']['gravity_m_s2']!r}+-0.00001",
        "-o",
        str(path),
    ]
    assert run(arguments) == 0
    touched, option = document(path), f"--without={clean['position'][4]['name']}"
    assert touched["quality"]["verdict"] == "poor"
    assert not missing(touched["quality"]["reasons"][1], option)
    assert run([*arguments, option]) == 0
    cured = document(path)
    assert cured["quality"]["verdict"] != "poor"
    for key in ("scale", "bias_m_s2"):
        sigmas = zip(
            cured["accelerometer"][key], clean["accelerometer"][key], cured["accelerometer"]["uncertainty"][key], strict=True
        )
        assert all(abs(found - wanted) < 3 * sigma for found, wanted, sigma in sigmas)
