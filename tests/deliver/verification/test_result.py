"""Requirements, and the file beside the parameters."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.deliver.navigation.drift import Drift
from imufield.deliver.navigation.rest import RestNoise
from imufield.deliver.navigation.static_navigation import CheckSettings, NavigationResult
from imufield.deliver.parameters.context import Context
from imufield.deliver.parameters.file import Parameters, from_document
from imufield.deliver.parameters.file import to_document as parameter_document
from imufield.deliver.verification.left_out import LeftOutPositions
from imufield.deliver.verification.result import (
    Requirement,
    Verification,
    judge,
    parse_requirements,
    read_verification,
    to_document,
    verification_note,
    verification_path,
    verification_text,
    write_verification,
)
from imufield.errors import Reason, UsageError
from tests.commands.told import says
from tests.refused import refused
from tests.told import key_of

pytestmark = pytest.mark.numerical

MICRO_G = 9.80665e-6


@pytest.fixture
def loaded(calibration: Calibration, observations: Observations, context: Context) -> Parameters:
    return from_document(parameter_document(calibration, observations, context))


@pytest.fixture
def left_out() -> LeftOutPositions:
    residual = 40 * MICRO_G * np.array([1.0, -1.0, 1.0])
    sigma = np.full(3, 45 * MICRO_G)
    up = np.eye(3)
    return LeftOutPositions(
        name=("+x", "+y", "+z"),
        up=up,
        residual_m_s2=residual,
        before_m_s2=np.full(3, np.nan),
        sigma_m_s2=sigma,
        misfit=0.8,
        misfit_limit=3.0,
        how="3 positions of another session",
    )


@pytest.fixture
def navigation() -> NavigationResult:
    time_s = np.linspace(0, 3600, 3601)
    still = np.zeros(3601)
    drift = Drift(
        time_s=time_s,
        latitude_deg=time_s * 1e-6,
        longitude_deg=still,
        north_velocity_m_s=still,
        east_velocity_m_s=still,
        true_latitude_deg=45.0,
    )
    noise = RestNoise(np.ones(6), np.full(6, np.nan))
    return NavigationResult(
        drifts={"after": drift},
        forecast=None,
        settings=CheckSettings(latitude_deg=45.0),
        navigated_s=3600.0,
        samples=3601,
        lost=0,
        noise=noise,
        notes=("no forecast: why",),
    )


def test_requirements_are_read() -> None:
    assert parse_requirements("residual-ug=50, nav-nmi-per-h=1") == {"residual-ug": 50.0, "nav-nmi-per-h": 1.0}
    assert parse_requirements(None) == {}


@pytest.mark.parametrize(
    ("text", "key", "facts"),
    [
        ("residual=5", "requirement", ("'residual=5'", "nav-nmi-per-h")),
        ("residual-ug=x", "limit", ("residual-ug", "'x'")),
        ("residual-ug=-1", "limit", ("residual-ug", "'-1'")),
        ("residual-ug=1,residual-ug=2", "twice", ("residual-ug", "1", "2")),
    ],
)
def test_wrong_requirements_are_refused(text: str, key: str, facts: tuple[str, ...]) -> None:
    with refused(UsageError, Reason.USAGE, "--require", *facts, key=f"result.{key}"):
        parse_requirements(text)


def test_what_was_not_measured_is_not_met(left_out: LeftOutPositions) -> None:
    found = judge({"residual-ug": 50.0, "nav-nmi-per-h": 1.0}, left_out, None)
    assert [one.passed for one in found] == [True, False]
    assert found[0].measured == pytest.approx(40.0)


def test_text_has_the_verdict_last(loaded: Parameters, left_out: LeftOutPositions, navigation: NavigationResult) -> None:
    requirements = judge({"residual-ug": 30.0}, left_out, navigation)
    text = verification_text(
        Verification(parameters=loaded, session="s", left_out=left_out, navigation=navigation, requirements=requirements)
    )
    assert text.endswith("Requirement residual-ug <= 30: 40, NOT MET\nVerdict: FAIL\n")
    assert "0.80" in text
    assert says(text, "deliver.verification", "result.correlated")
    # Of another session nothing is held out.
    assert text.startswith("Positions: ")
    assert "drift after: 0.216 nmi/h" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("has_preset", [True, False])
def test_what_stands_before_is_named(loaded: Parameters, left_out: LeftOutPositions, has_preset: bool) -> None:
    own = replace(left_out, is_own=True, before_m_s2=left_out.residual_m_s2)
    text = verification_text(Verification(parameters=loaded, session="s", left_out=own, has_preset=has_preset))
    assert text.startswith("Held-out positions: ")
    assert ("with the preset" in text, "with the nominal scale" in text) == (has_preset, not has_preset)


def test_file_keeps_the_other_check_of_the_same_parameters(
    tmp_path: Path, loaded: Parameters, left_out: LeftOutPositions, navigation: NavigationResult
) -> None:
    path = verification_path(tmp_path / "parameters.toml")
    assert path.name == "parameters.verification.json"
    first = to_document(Verification(parameters=loaded, session="positions", left_out=left_out))
    write_verification(path, first)
    write_verification(path, to_document(Verification(parameters=loaded, session="rest", left_out=None, navigation=navigation)))
    document = read_verification(path, first["parameters_sha256"])
    assert document is not None
    assert document["positions"]["session"] == "positions"
    assert document["positions"]["before_m_s2"] == [None] * 3
    assert document["navigation"]["drift"]["after"]["position_nmi"][0] == 0
    assert len(document["navigation"]["drift"]["after"]["time_s"]) == 600
    assert read_verification(path, "0" * 64) is None


def test_file_keeps_requirements_and_objections_until_they_are_checked_again(
    tmp_path: Path, loaded: Parameters, left_out: LeftOutPositions, navigation: NavigationResult
) -> None:
    path = tmp_path / "parameters.verification.json"
    contradicted = replace(left_out, objection="not of this session")

    def write(*requirements: Requirement, **checks: Any) -> tuple[object, list[float], list[str]]:
        verified = Verification(parameters=loaded, session="s", requirements=requirements, **checks)
        joined = write_verification(path, to_document(verified))
        assert read_verification(path, joined["parameters_sha256"]) is not None
        return joined["passed"], [one["limit"] for one in joined["requirement"]], joined["objections"]

    assert write(left_out=contradicted) == (False, [], ["not of this session"])
    assert write(Requirement("nav-nmi-per-h", 1.0, 9.0), navigation=navigation) == (False, [1.0], ["not of this session"])
    assert write(left_out=contradicted) == (False, [1.0], ["not of this session"])
    assert write(left_out=left_out) == (False, [1.0], [])
    assert write(Requirement("residual-ug", 50.0, 40.0), left_out=left_out) == (False, [1.0, 50.0], [])
    assert write(Requirement("nav-nmi-per-h", 10.0, 9.0), navigation=navigation) == (True, [10.0, 50.0], [])


def test_results_of_an_earlier_version_of_the_program_are_joined(
    tmp_path: Path, loaded: Parameters, left_out: LeftOutPositions, navigation: NavigationResult
) -> None:
    """They name no session of a requirement, and do not say what positions hide."""
    path = tmp_path / "parameters.verification.json"
    found = Verification(
        parameters=loaded, session="s", left_out=left_out, requirements=(Requirement("residual-ug", 5.0, 9.0),)
    )
    earlier = to_document(found)
    del earlier["positions"]["hidden"], earlier["requirement"][0]["session"]
    write_verification(path, earlier)
    joined = write_verification(path, to_document(Verification(parameters=loaded, session="t", navigation=navigation)))
    assert (joined["passed"], [one["name"] for one in joined["requirement"]]) == (False, ["residual-ug"])


def test_a_verdict_that_was_edited_is_none(tmp_path: Path, loaded: Parameters, left_out: LeftOutPositions) -> None:
    path = verification_path(tmp_path / "parameters.toml")
    document = to_document(
        Verification(
            parameters=loaded,
            session="s",
            left_out=left_out,
            navigation=None,
            requirements=(Requirement("residual-ug", 5.0, 9.0),),
        )
    )
    sha256 = document["parameters_sha256"]
    assert verification_note(path, sha256) == ""
    write_verification(path, document)
    assert verification_note(path, sha256) == ""
    path.write_text(path.read_text().replace('"passed": false', '"passed": true'))
    assert read_verification(path, sha256) is None
    assert key_of(verification_note(path, sha256)) == "result.left_out"
    assert "parameters.verification.json" in verification_note(path, sha256)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "other"}', '{"format": "imufield-verification", "version": 2}'])
def test_what_is_no_verification_is_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "parameters.verification.json"
    path.write_text(text)
    assert read_verification(path, "0" * 64) is None


def test_document_is_json(loaded: Parameters, left_out: LeftOutPositions, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_verification(path, to_document(Verification(parameters=loaded, session="s", left_out=left_out)))
    json.loads(path.read_text(), parse_constant=pytest.fail)
