"""Older parameter files: converted, told, and held to what their version had."""

from __future__ import annotations

import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from imufield.cli.run import run
from imufield.deliver.parameters.document import VERSION, VERSION_WITHOUT_TEMPERATURE
from imufield.deliver.parameters.file import json_ready, load, parameter_schema
from imufield.deliver.parameters.versions import CONVERTERS, to_current
from imufield.deliver.parameters.write import content_sha256
from imufield.errors import ParameterFileError, Reason
from imufield.sentences import Sentences
from tests.parameter_files import edit
from tests.refused import refused

OLD = Path(__file__).with_name("parameters-version-0.toml")


def rewritten(path: Path, old: str, new: str) -> Path:
    """Write the old file with a change somebody made on purpose."""
    path.write_bytes(OLD.read_bytes())
    return edit(path, old, new)


def test_there_is_a_step_from_every_version_that_is_no_longer_written() -> None:
    assert sorted(CONVERTERS) == list(range(VERSION_WITHOUT_TEMPERATURE))


def test_an_old_file_corrects_as_its_own_numbers_say() -> None:
    loaded = load(OLD)
    assert loaded.version == 0
    assert loaded.is_converted
    stored = tomllib.loads(OLD.read_text(encoding="utf-8"))
    table, rate = stored["accelerometer"], stored["gyroscope"]
    raw = np.array([[0.3, -0.2, 9.7, 0.01, -0.02, 0.03]])
    # Version 0 by hand: a = T^-1 (N / K - b), w = E^-1 (N - e) / K.
    T, E = (np.eye(3) + np.array(one["misalignment_rad"]) for one in (table, rate))
    force = np.linalg.solve(T, raw[0, :3] / table["scale"] - table["bias_m_s2"])
    turning = np.linalg.solve(E, (raw[0, 3:] - rate["bias"]) / rate["scale"])
    np.testing.assert_allclose(loaded.apply(raw)[0], [*force, *turning], rtol=1e-13)


def test_what_comes_out_is_a_whole_file_of_today() -> None:
    loaded = load(OLD)
    jsonschema.validate(json_ready(loaded.document), parameter_schema())
    assert loaded.document["version"] == VERSION_WITHOUT_TEMPERATURE
    assert loaded.document["integrity"]["sha256"] == content_sha256(loaded.document)
    assert not loaded.edited
    sigma = loaded.calibration.accelerometer_sigma
    assert np.isnan(sigma.quadratic).all()
    assert not loaded.calibration.quadratic_fitted


def test_the_file_itself_and_the_document_given_stay_as_they_are() -> None:
    before = OLD.read_bytes()
    document = tomllib.loads(OLD.read_text(encoding="utf-8"))
    to_current(document, 0)
    assert json_ready(document) == json_ready(tomllib.loads(OLD.read_text(encoding="utf-8")))
    load(OLD)
    assert OLD.read_bytes() == before


def test_what_is_no_table_is_left_for_the_schema_to_refuse() -> None:
    broken = {"accelerometer": 3, "integrity": {"sha256": "edited"}}
    assert to_current(broken, 0)["accelerometer"] == 3


def test_the_hash_is_that_of_what_was_written(tmp_path: Path) -> None:
    changed = tmp_path / "p.toml"
    changed.write_text(OLD.read_text(encoding="utf-8").replace("used = true", "used = false", 1), encoding="utf-8")
    with refused(ParameterFileError, Reason.DAMAGED, "p.toml", "sha256", key="read.changed"):
        load(changed)
    edited = load(rewritten(changed, "used = true", "used = false"))
    assert edited.edited
    assert edited.version == 0


@pytest.mark.parametrize(
    ("old", "new", "fact", "reason"),
    [
        ("[accelerometer]", "[accelerometer]\nraw_zero = [0.0, 0.0, 0.0]", "accelerometer.raw_zero", Reason.UNKNOWN_KEY),
        ("[accelerometer]", "[accelerometer]\nquadratic = 5", "accelerometer.quadratic", Reason.UNKNOWN_KEY),
        ("[gyroscope]", "[turntable]", "turntable", Reason.UNKNOWN_KEY),
        ("[accelerometer.intrinsic]", "[accelerometer.other]", "accelerometer.other", Reason.UNKNOWN_KEY),
        ("[quality]", "[[quality]]", "quality", Reason.DAMAGED),
    ],
)
def test_what_the_version_did_not_have_is_refused(tmp_path: Path, old: str, new: str, fact: str, reason: Reason) -> None:
    with refused(ParameterFileError, reason, "p.toml", fact) as caught:
        load(rewritten(tmp_path / "p.toml", old, new))
    assert caught.value.reason is reason


def test_commands_take_it_and_newer_ones_leave_with_5(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out"
    assert run(["export", str(OLD), "--to", "vectornav", "-o", str(output)]) == 0
    newer = rewritten(tmp_path / "newer.toml", "version = 0", f"version = {VERSION + 1}")
    assert run(["export", str(newer), "--to", "vectornav", "-o", str(tmp_path / "none")]) == 5
    told = " ".join(capsys.readouterr().err.split())
    sentence = Sentences("imufield.deliver.parameters")
    assert sentence("read.newer", where=str(newer), version=VERSION + 1, known=VERSION) in told
    assert not (tmp_path / "none").exists()
