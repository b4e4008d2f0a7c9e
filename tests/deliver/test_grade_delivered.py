"""Grade and range of a calibration: written, read back, and gone by."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from imufield.deliver.parameters.file import Context, Parameters, from_document, load, write_document
from imufield.deliver.parameters.write import EDITED
from imufield.earth import Gravity
from imufield.pipeline.calibration import SolveInput, SolveSettings, calibrate
from imufield.simulate.truth.grades import TACTICAL, perfect_instrument
from imufield.study.answers.means import MeanSession
from tests.told import keys

GRAVITY = Gravity(gravity_m_s2=9.81, sigma_m_s2=1e-5, source="measured")


@pytest.fixture(scope="module")
def measured() -> SolveInput:
    session = MeanSession(instrument=perfect_instrument(TACTICAL), gravity_m_s2=GRAVITY.gravity_m_s2)
    return SolveInput(observations=session.observe(np.random.default_rng(4)).observations, gravity=GRAVITY, context=Context())


@pytest.fixture(scope="module")
def tactical(measured: SolveInput) -> Parameters:
    return calibrate(measured, SolveSettings(grade="tactical"))


def test_the_file_says_whose_priors_it_holds(tactical: Parameters, tmp_path: Path) -> None:
    write_document(tmp_path / "parameters.toml", tactical.document)
    read = load(tmp_path / "parameters.toml")
    assert read.context.instrument.grade == "tactical"
    assert read.document["accelerometer"]["range_m_s2"] == GRAVITY.gravity_m_s2
    assert "calibration.range" in keys(tactical.calibration.quality.reasons)


def test_without_a_word_it_is_the_presets_grade_and_then_the_worst(measured: SolveInput, tactical: Parameters) -> None:
    unnamed = calibrate(measured, SolveSettings())
    assert (unnamed.context.instrument.grade, unnamed.context.instrument.stated_grade) == ("mems", "")
    assert unnamed.document["instrument"]["grade_source"] == "assumed"
    again = calibrate(measured, SolveSettings(preset=tactical))
    assert again.context.instrument.stated_grade == "tactical"
    # An assumption does not become a statement by being handed on.
    twice = calibrate(measured, SolveSettings(preset=unnamed))
    assert twice.document["instrument"]["grade_source"] == "assumed"
    sigma = [found.calibration.accelerometer_sigma.bias_m_s2.max() for found in (unnamed, tactical, again)]
    assert sigma[0] > 1.3 * sigma[1]
    assert sigma[2] == pytest.approx(sigma[1], rel=0.05)


def test_a_file_of_before_knows_neither(tactical: Parameters) -> None:
    document = copy.deepcopy(tactical.document)
    del document["instrument"]["grade"], document["instrument"]["grade_source"], document["accelerometer"]["range_m_s2"]
    document["integrity"] = {"sha256": EDITED}
    assert from_document(document).context.instrument.grade == ""
