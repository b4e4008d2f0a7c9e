from __future__ import annotations

import pytest

from imufield.samples import SampleUnits


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
