import math
from typing import Any

import numpy as np
import pytest

from imufield.earth import MICRO_G_M_S2
from imufield.guide.events import Accepted
from imufield.guide.hold.hold_time import AllanMinimum
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme


def test_a_fixed_time_is_all_that_counts() -> None:
    target = GuideSettings(hold_s=8.0).hold_target
    assert not target.is_met(7.9, 0.0, 1.0)
    assert target.is_met(8.0, math.inf, math.inf)


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


def test_a_target_lifts_the_cap() -> None:
    target = GuideSettings(target_bias_ug=1e-4 / MICRO_G_M_S2).hold_target
    assert not target.is_met(30.0, 2e-4, math.inf)
    assert target.is_met(30.0, 1e-4, math.inf)
    assert target.is_met(60.0, 1.0, math.inf)


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
    taken = [event for event in guide.feed(samples) if isinstance(event, Accepted)]
    assert len(taken) == 2
    assert all(low_s <= event.duration_s <= high_s for event in taken)
