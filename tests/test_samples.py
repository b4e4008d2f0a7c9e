from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from imufield.samples import SampleUnits, median


@pytest.mark.parametrize(
    ("units", "accelerometer", "gyroscope"),
    [
        (SampleUnits(), "m/s^2", "rad/s"),
        (
            SampleUnits(
                accelerometer="m/s",
                gyroscope="rad",
                accelerometer_is_increment=True,
                gyroscope_is_increment=True,
                interval_s=0.01,
            ),
            "m/s^2",
            "rad/s",
        ),
        (
            SampleUnits(
                accelerometer="count",
                gyroscope="pulse",
                accelerometer_is_increment=True,
                gyroscope_is_increment=True,
                interval_s=0.01,
            ),
            "count/s",
            "pulse/s",
        ),
        (SampleUnits(accelerometer="count", gyroscope="count"), "count", "count"),
        (
            SampleUnits(accelerometer="pulse", gyroscope="rad/s", accelerometer_is_increment=True, interval_s=0.01),
            "pulse/s",
            "rad/s",
        ),
    ],
)
def test_units_of_rates(units: SampleUnits, accelerometer: str, gyroscope: str) -> None:
    assert (units.accelerometer_rate_unit, units.gyroscope_rate_unit) == (accelerometer, gyroscope)


@pytest.mark.parametrize(
    "values",
    [
        [3.0, 1.0, 2.0],
        [4, 1, 3, 2],
        [1.0, np.nan, 2.0],
        [np.inf, -np.inf, 1.0, 2.0],
        [7.0],
        [True, False, True],
        np.random.default_rng(3).standard_normal((9, 4)),
        np.random.default_rng(4).standard_normal((10, 3, 2)),
    ],
    ids=repr,
)
def test_a_median_is_that_of_numpy(values: Any) -> None:
    before = np.array(values)
    np.testing.assert_array_equal(median(values), np.median(values, axis=0))
    np.testing.assert_array_equal(values, before)


def test_the_median_of_nothing_is_nan() -> None:
    assert np.isnan(median([]))
    assert np.isnan(median(np.empty((0, 3)))).tolist() == [True] * 3
