import math
from typing import Any

import numpy as np
import pytest

from imufield.guide.events import Accepted, Advice, Hold, Holding, Topic
from imufield.guide.hold.hold_time import AllanMinimum, HoldTarget
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme


def test_a_fixed_time_is_all_that_counts() -> None:
    target = GuideSettings(hold_s=8.0).hold_target
    assert not target.is_met(7.9, 0.0, 1.0)
    assert target.is_met(8.0, math.inf, math.inf)


def test_a_fixed_time_stays_where_there_is_a_target(make_path: Any) -> None:
    samples = make_path(200.0).hold([0, 0, 1], 16).turn([1, 0, 0], 1.5).hold([1, 0, 0], 14).samples(0.03)
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings(hold_s=8.0, target_bias_ug=3000.0))
    events = guide.feed(samples)
    assert any(isinstance(event, Advice) and event.topic is Topic.TIME for event in events)
    lasted_s = [event.duration_s for event in events if isinstance(event, Accepted)]
    assert lasted_s == pytest.approx([8.0, 8.0], abs=0.11)


@pytest.mark.parametrize(
    ("length_s", "sigma", "minimum_s", "enough"),
    [
        (2.9, 0.0, math.inf, False),
        (3.0, 1e-5, math.inf, True),
        (9.0, 1e-2, math.inf, False),
        (9.0, 1e-2, 6.4, True),
        (10.0, 1e-2, math.inf, True),
    ],
)
def test_good_enough_ends_a_hold_and_the_allan_minimum_caps_it(
    length_s: float, sigma: float, minimum_s: float, enough: bool
) -> None:
    assert GuideSettings().hold_target.is_met(length_s, sigma, minimum_s) is enough


def test_a_length_is_met_where_noise_is_white_and_patience_lasts_where_it_is_not() -> None:
    noise = 1e-3
    for length_s, latest_s in ((3.0, 10.0), (8.0, 10.0), (30.0, 30.0)):
        target = HoldTarget.lasting(length_s, noise)
        assert target.expected_s(noise) == pytest.approx(length_s)
        # The sigma of a hold is found larger than that of white noise by chance: without it, it would end a second earlier.
        assert target.is_met(length_s, noise / math.sqrt(length_s - 1.0), math.inf)
        assert not target.is_met(latest_s - 0.1, 2 * noise / math.sqrt(length_s), math.inf)
        assert target.is_met(latest_s, 2 * noise / math.sqrt(length_s), math.inf)


def test_the_allan_minimum_of_white_noise_is_never_seen_and_that_of_flicker_is() -> None:
    rng = np.random.default_rng(0)
    white, bent = AllanMinimum(), AllanMinimum()
    for _ in range(12):
        noise = rng.normal(0, 1e-3, 200)
        white.add(9.8 + noise)
        bent.add(9.8 + noise + np.cumsum(rng.normal(0, 2e-4, 200)))
    assert math.isinf(white.minimum_s)
    assert 0.8 <= bent.minimum_s <= 6.4


@pytest.mark.parametrize(("sigma", "low_s", "high_s"), [(2e-4, 2.9, 3.6), (0.05, 9.4, 10.2)])
def test_holds_end_when_the_mean_is_good_enough(make_path: Any, sigma: float, low_s: float, high_s: float) -> None:
    path = make_path(200.0).hold([0, 0, 1], 14).turn([1, 0, 0], 1.5).hold([1, 0, 0], 13)
    samples = path.samples(sigma)
    guide = Guide(scheme("faces6"), samples.units, settings=GuideSettings())
    events = guide.feed(samples)
    taken = [event for event in events if isinstance(event, Accepted)]
    assert len(taken) == 2
    assert all(low_s <= event.duration_s <= high_s for event in taken)
    # What is left is told to the end that comes, not to the latest one.
    for hold, accepted in zip([event for event in events if isinstance(event, Hold)], taken, strict=True):
        counted = [
            event.remaining_s for event in events if isinstance(event, Holding) and hold.time_s < event.time_s < accepted.time_s
        ]
        assert hold.hold_s == pytest.approx(accepted.duration_s, abs=1.0)
        assert counted[0] <= hold.hold_s
        assert counted[-1] < 1.0
