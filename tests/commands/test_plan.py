"""What a plan assumes of the instrument."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from imufield.acquire.registry import load_driver, shipped_names
from imufield.cli.run import run
from imufield.errors import Reason
from tests.commands.told import fails


def planned(capsys: pytest.CaptureFixture[str], *options: str) -> dict[str, object]:
    assert run(["plan", "--json", *options]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_the_driver_of_the_folder_tells_the_grade(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert planned(capsys)["grade"] == "mems"
    Path("imufield.toml").write_text('driver = "stim300"\n')
    from_folder = planned(capsys)
    assert from_folder["grade"] == load_driver("stim300").load_protocol().nominal.grade == "tactical"
    assert from_folder == planned(capsys, "--grade", "tactical") == planned(capsys, "--driver", "kvh_17xx")
    # Nobody need be asked for a grade that is known.
    assert "--grade" not in str(from_folder["assumed"])
    assert planned(capsys, "--grade", "navigation")["grade"] == "navigation"
    # What was measured tells more than what a driver says of a whole family.
    assert planned(capsys, "--noise-ug", "300")["grade"] == "mems"


@pytest.mark.parametrize("name", shipped_names())
def test_every_driver_can_be_planned_with(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert planned(capsys, "--driver", name)["grade"] == (load_driver(name).load_protocol().nominal.grade or "mems")


@pytest.mark.parametrize("more", ["", " --grade mems", " --noise-ug 100"])
def test_a_driver_that_is_none_is_refused(more: str) -> None:
    fails(f"plan --driver stim3000{more}", 2, Reason.UNKNOWN_DRIVER, "stim300", key="registry.unknown")
