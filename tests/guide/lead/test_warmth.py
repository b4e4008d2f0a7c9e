from typing import Any

import numpy as np
import pytest

from imufield.guide.lead.stream_watch import Warmth
from tests.guide.guided import cells_of


def slope(make_path: Any, temperature: Any, seconds: float = 30.0) -> float:
    samples = make_path(50.0).hold([0, 0, 1], seconds).samples()
    samples.temperature_degc[:] = temperature(samples.time_s)
    warmth = Warmth()
    for cells in cells_of([samples]):
        for row in range(len(cells)):
            warmth.follow(cells, row)
    return warmth.slope_degc_min


@pytest.mark.parametrize("rate", [-1.5, 0.8, 3.0])
def test_a_slope_is_measured(make_path: Any, rate: float) -> None:
    assert slope(make_path, lambda time_s: 25 + rate / 60 * time_s) == pytest.approx(rate, rel=0.02)


def test_steps_of_the_sensor_are_no_slope(make_path: Any) -> None:
    assert abs(slope(make_path, lambda time_s: np.where(time_s > 15, 25.0625, 25.0))) < 0.3
    rng = np.random.default_rng(0)
    assert abs(slope(make_path, lambda time_s: 25 + rng.normal(0, 0.1, len(time_s)))) < 0.2


def test_a_temperature_that_comes_once_a_second_has_the_same_slope(make_path: Any) -> None:
    seldom = slope(make_path, lambda time_s: np.where(np.arange(len(time_s)) % 50 == 7, 25 + 2 / 60 * time_s, np.nan))
    assert seldom == pytest.approx(2.0, rel=0.02)


def test_what_is_not_known_is_no_slope(make_path: Any) -> None:
    assert slope(make_path, lambda time_s: np.full(len(time_s), np.nan)) == 0
    assert slope(make_path, lambda time_s: 25 + time_s, seconds=3.0) == 0
