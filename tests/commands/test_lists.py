"""Commands that list what there is: instruments and one of them, export targets, studies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from imufield.acquire.registry import driver_names, load_driver
from imufield.cli.run import run
from imufield.deliver.exports import TARGETS
from imufield.errors import Reason
from imufield.study.run import STUDIES
from tests.commands.told import fails, missing


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert run([*arguments]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", driver_names())
def test_one_instrument_with_settings_and_wiring(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    driver = load_driver(name)
    facts: dict[str, Any] = json.loads(printed(capsys, "devices", name, "--json"))
    assert (facts["name"], facts["wire"], facts["bauds"][0]) == (name, driver.wire, driver.default_baud)
    assert facts["settings"].keys() == driver.load_protocol().settings.keys()
    shown = printed(capsys, "devices", name)
    assert max(map(len, shown.splitlines())) <= 80
    assert not missing(shown, driver.title, driver.status, driver.manual, *map(str, driver.bauds), *driver.abilities)
    for key, setting in facts["settings"].items():
        # What a setting is for and what it may be is in its protocol.
        assert not missing(shown, key, setting["meaning"], setting["allowed"])
        assert setting["meaning"]
        assert setting["allowed"]
    assert "``" not in shown
    assert "==" not in shown


def test_the_list_of_instruments_is_as_it_was(capsys: pytest.CaptureFixture[str]) -> None:
    listed = json.loads(printed(capsys, "devices", "--json"))["drivers"]
    assert [driver["name"] for driver in listed] == driver_names()
    assert listed[0].keys() == {"name", "title", "default_baud", "status", "abilities"}
    assert "imufield devices NAME" in printed(capsys, "devices")


def test_an_instrument_that_is_not_known() -> None:
    fails("devices stim30", 2, Reason.UNKNOWN_DRIVER, "stim30", "stim300", key="registry.unknown")


@pytest.mark.parametrize("arguments", ["export", "export nowhere.toml"])
def test_targets(arguments: str, capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, *arguments.split())
    assert not missing(shown, *TARGETS, *(target.title for target in TARGETS.values()))
    listed = json.loads(printed(capsys, *arguments.split(), "--json"))["targets"]
    assert [target["name"] for target in listed] == [*TARGETS]


def test_a_target_alone_asks_for_its_file() -> None:
    fails("export --to px4", 2, Reason.USAGE, "px4", "parameters.toml", key="export.which")
    fails("export --to nobody", 2, Reason.USAGE, "nobody", "px4", key="registry.target")


def test_studies(capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, "study")
    assert [line.split()[0] for line in shown.splitlines()] == [*STUDIES]
    assert max(map(len, shown.splitlines())) <= 80
    assert "{" not in shown


def test_a_study_that_is_not_known_makes_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    fails(["study", "bsas-table9", "-o", str(folder)], 2, Reason.USAGE, "bsas-table9", *STUDIES, key="run.no_study")
    assert not folder.exists()
