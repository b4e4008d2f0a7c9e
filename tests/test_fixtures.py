"""The recorded capture in fixtures/ replays to the same events and to the truth it was simulated with."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import to_vector
from imufield.guide.positions import scheme
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.operator import OperatorSettings
from imufield.testing import Replayed

FIXTURE = Path(__file__).resolve().parent.parent / "fixtures" / "stim300-six-faces"
FILES = {"part-001.mcap", "session.toml"}
SEED = 3


@pytest.fixture
def replayed(imufield_replay: Callable[..., Replayed]) -> Replayed:
    return imufield_replay(FIXTURE)


def test_every_side_is_accepted_once(replayed: Replayed) -> None:
    accepted = [event["position"] for event in replayed.events if event["event"] == "accepted"]
    assert sorted(accepted) == sorted(position.name for position in scheme("faces6").positions)
    assert {path.name for path in FIXTURE.iterdir()} - {"session.lock"} == FILES


def test_scale_and_bias_are_those_it_was_simulated_with(replayed: Replayed) -> None:
    habits = OperatorSettings(hold_s=5.0, initial_still_s=8.0)
    source = make_virtual_imu(Emulation(rate_hz=125.0, seed=SEED, directions=scheme("faces6").directions(), operator=habits))
    truth = source.imu.instrument.accelerometer
    true, _ = intrinsic(to_vector(truth))
    found = replayed.parameters.calibration.accelerometer
    # Six sides show neither misalignment nor the quadratic term, which move scale and bias by some 100 ppm and 100 micro-g,
    # and the drift of the session, some 50 micro-g, comes on top.
    np.testing.assert_allclose(found.scale, true[:3], rtol=4e-4)
    np.testing.assert_allclose(found.bias_m_s2, truth.bias_m_s2, atol=3e-3)


def test_replaying_changes_nothing(replayed: Replayed) -> None:
    def digest() -> dict[str, str]:
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in FIXTURE.iterdir()}

    before = digest()
    assert len(replayed.samples) > 5000
    assert replace(replayed).parameters.document["format"] == "imufield-parameters"
    assert digest() == before
