"""Suspects over a session, hold by hold: which are found, and which stay."""

from dataclasses import replace

import pytest

from imufield.guide.lead.advice import Adviser
from imufield.guide.lead.plan import Plan
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.guide.stillness.scale import RoughScale
from tests.guide.guided import observations

pytestmark = pytest.mark.numerical

SI = RoughScale(accelerometer=1.0, gyroscope=1.0)
BUMP = 1 + 5.8e-3


@pytest.mark.parametrize(
    ("bumped", "at_once"),
    [((11,), ()), ((6, 15), (15,)), ((4, 8), ()), ((9, 14, 19), (19,)), ((14, 15, 16, 17), (15, 16, 17))],
)
def test_several_bumps_are_all_found_and_none_is_exonerated_by_another(
    bumped: tuple[int, ...], at_once: tuple[int, ...]
) -> None:
    """A second bump of the same size makes the first look usual where both stay in the fit."""
    some = observations("mems", 1)
    plan = Plan(scheme("paper24"))
    adviser = Adviser(plan, GuideSettings())
    found: list[int] = []
    for index, observation in enumerate(some):
        mean_raw = observation.mean_raw * (BUMP if index in bumped else 1.0)
        plan.accept(index, replace(observation, mean_raw=mean_raw))
        adviser.fit_again(SI)
        if index in at_once:
            assert index in adviser.suspects
        assert set(found) <= adviser.suspects.keys()
        found = [*adviser.suspects]
    assert sorted(found) == list(bumped)
    # Good ones are compared with good ones.
    good = [one.leave_one_out_m_s2 for index, one in adviser.compared.items() if index not in bumped]
    assert max(map(abs, good)) < 2e-3
    # Measured again, each is one of them.
    for index in bumped:
        plan.accept(index, some[index])
        adviser.fit_again(SI)
        assert index not in adviser.suspects
    assert not adviser.suspects
