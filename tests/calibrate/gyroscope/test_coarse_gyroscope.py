"""A gyroscope whose step is larger than its noise: all stills read one code, and share its error."""

from __future__ import annotations

import numpy as np
import pytest
from gyroscope_sessions import Session, ratios, simulate

from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.moves.moves import cut_moves
from imufield.calibrate.moves.slots import no_slots
from imufield.dataclass import replace
from imufield.simulate.truth.grades import GRADES

pytestmark = pytest.mark.numerical

RATE_HZ = 40.0
SEEDS = range(4)


@pytest.fixture(scope="module", params=[0.05, 0.2])
def sessions(request: pytest.FixtureRequest) -> list[Session]:
    """Sessions of a gyroscope with that noise in steps of its output."""
    mems = GRADES["mems"]
    step = mems.gyroscope.noise_density * np.sqrt(RATE_HZ) / request.param
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(GRADES, "mems", replace(mems, gyroscope=replace(mems.gyroscope, lsb_si=step)))
        return [simulate(seed, rate_hz=RATE_HZ, hold_s=4.0) for seed in SEEDS]


def test_sigma_of_the_bias_holds_the_error_of_the_code(sessions: list[Session]) -> None:
    found = [ratios(session, calibrate_gyroscope(session.given))[9:12] for session in sessions]
    assert 0.3 < np.sqrt(np.mean(np.square(found))) < 1.4


def test_sigma_of_what_moves_show_has_no_rounding_of_the_stills(sessions: list[Session]) -> None:
    """Samples of a turn pass from code to code: what rounding leaves in them averages out."""
    found = [ratios(session, calibrate_gyroscope(session.given))[:9] for session in sessions]
    assert 0.45 < np.sqrt(np.mean(np.square(found))) < 1.4


def test_stills_alone_hold_it_too(sessions: list[Session]) -> None:
    found = []
    for session in sessions:
        alone = replace(
            session.given, moves=cut_moves(no_slots(), np.empty(0), np.empty(0)), nominal_scale=session.truth.scale[0]
        )
        result = calibrate_gyroscope(alone).calibration
        found.append((result.parameters.bias - session.truth.bias) / result.sigma.bias)
    assert 0.3 < np.sqrt(np.mean(np.square(found))) < 1.4
