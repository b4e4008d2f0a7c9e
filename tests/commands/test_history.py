"""``imufield history`` over a folder of sessions."""

from __future__ import annotations

import json
import re
import shutil
from datetime import UTC, datetime
from pathlib import Path

import pytest

from imufield.cli.run import run
from imufield.commands import history
from imufield.commands.history import run_history
from imufield.commands.options.result_commands import HistoryOptions
from imufield.deliver.parameters.file import load
from imufield.deliver.parameters.write import to_toml
from imufield.errors import Reason
from tests.commands.told import fails, missing


@pytest.fixture
def folder(short_solved: Path, tmp_path: Path) -> Path:
    shutil.copytree(short_solved, tmp_path / "sessions" / "one")
    return tmp_path / "sessions"


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a drawing say whose it is: what it looks like, its own tests tell, and a line of the pages draws a real one."""
    monkeypatch.setattr(history, "plot_history", lambda judged: repr(judged.instrument.serial_number).encode())


def test_history_is_printed_and_written(folder: Path, drawn: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, plot = tmp_path / "history.csv", tmp_path / "history.svg"
    run_history(HistoryOptions(folder=folder, csv=table, plot=plot), now=datetime(2100, 1, 1, tzinfo=UTC))
    text = capsys.readouterr().out
    assert "stim300" in text
    assert "one/parameters.toml" in text
    assert "365" in text
    assert not missing(text, table, plot)
    # Nothing to compare: the instrument, its file, what there is to say, where the numbers are, and what was written.
    assert len(text.splitlines()) <= 10
    assert table.read_text().startswith("instrument,serial_number,created")
    assert plot.read_text() == "''"


def test_json_is_one_document(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run(["history", str(folder), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    (instrument,) = document["instruments"]
    assert instrument["stale"] is False
    assert set(instrument["calibrations"][0]["parameters"]["bias x"]) == {"value", "sigma", "unit"}


def test_an_accuracy_is_taken_from_the_settings(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "imufield.toml").write_text("target_bias_ug = 500\n")
    assert run(["history", str(folder), "--target-scale-ppm", "200", "--json"]) == 0
    (instrument,) = json.loads(capsys.readouterr().out)["instruments"]
    # One calibration is too few, of both.
    assert [sum(kind in told for told in instrument["sentences"]) for kind in ("bias", "scale")] == [1, 1]
    assert instrument["repeatability"] == {}
    assert instrument["news"] == []


def test_damaged_file_is_told_and_left_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = folder / "one" / "parameters.toml"
    (folder / "cut.toml").write_text(good.read_text()[:2000])
    assert run(["history", str(folder)]) == 0
    assert "cut.toml" in capsys.readouterr().err


def test_several_instruments_are_drawn_into_a_file_each(
    folder: Path, drawn: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = load(folder / "one" / "parameters.toml").document
    document["instrument"] = document["instrument"] | {"serial_number": "X"}
    document.pop("integrity", None)
    (folder / "other.toml").write_text(to_toml(document))
    assert run(["history", str(folder), "--csv", str(tmp_path / "x.csv"), "--plot", str(tmp_path / "x.svg")]) == 0
    assert sorted(path.name for path in tmp_path.glob("x*")) == ["x-X.svg", "x-stim300.svg", "x.csv"]
    assert str(tmp_path / "x-X.svg") in capsys.readouterr().out
    assert [(tmp_path / name).read_text() for name in ("x-X.svg", "x-stim300.svg")] == ["'X'", "''"]
    run_history(HistoryOptions(folder=folder, serial_number="X", plot=tmp_path / "x.svg"))
    assert (tmp_path / "x.svg").read_text() == "'X'"


def test_empty_folder_is_one_sentence(tmp_path: Path) -> None:
    assert run(["history", str(tmp_path)]) == 5


def test_the_file_for_a_date_is_printed_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["history", str(folder), "--at", "2001-03-04"]) == 0
    said = capsys.readouterr()
    assert said.out == f"{folder / 'one' / 'parameters.toml'}\n"
    assert not missing(said.err, "2001-03-04", "365", "--stale-days")
    fails(["history", str(folder), "--at", "yesterday"], 2, Reason.USAGE, "--at", "'yesterday'")


@pytest.mark.parametrize(
    ("at", "days"),
    [
        ("2026-11-21", None),
        ("2026-11-21T23:59", None),
        ("2026-11-22T00:30+02:00", None),
        ("2026-11-20", "1 day after"),
        ("2026-11-23", "2 days before"),
    ],
)
def test_how_far_a_calibration_is_from_a_date(
    at: str, days: str | None, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed(folder / "one" / "parameters.toml", folder / "one" / "parameters.toml", created="2026-11-21T22:45:10Z")
    assert run(["history", str(folder), "--at", at]) == 0
    said = capsys.readouterr().err
    assert not missing(said, at, days or "")
    assert (re.search(r"\bdays?\b (?:after|before)", said) is None) is (days is None)


def changed(path: Path, to: Path, created: str, session: str | None = None) -> None:
    """Write a parameter file as if it had been measured at another time, in another recording where one is given."""
    document = load(path).document
    document["session"] = document["session"] | {"recorded": created} | ({"sha256": session} if session else {})
    document.pop("integrity", None)
    to.write_text(to_toml(document))


def test_the_table_has_headings_and_scales_as_errors(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changed(folder / "one" / "parameters.toml", folder / "two.toml", "2030-01-01T00:00:00Z", "0" * 64)
    capsys.readouterr()
    assert run(["history", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    (heading,) = [line for line in lines if "parameter " in line]
    assert heading.split() == ["parameter", "value", "±", "sigma", "unit", "change"]
    (scale,) = [line for line in lines if line.startswith("scale error x")]
    truth = load(folder / "two.toml").calibration.intrinsic.scale[0]
    # Rounded to a tenth of its sigma.
    assert float(scale.split()[3]) == pytest.approx((truth - 1) * 1e6, abs=float(scale.split()[5]) / 10)
    assert scale.split()[4] == "±"
    assert scale.split()[6] == "ppm"
    assert max(map(len, lines)) <= 80
    assert max(len(line) for line in lines if line.endswith(" sigma")) <= 60
