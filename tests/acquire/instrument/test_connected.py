"""What is said of settings that nobody gave."""

from __future__ import annotations

import pytest

from imufield.acquire.instrument.connected import assumed
from imufield.acquire.registry import load_driver


@pytest.mark.parametrize(
    ("driver", "given", "name"),
    [
        # Without the kind of the IMU inside, nothing has a unit.
        ("novatel_oem7", {}, "imu"),
        ("novatel_oem7", {"imu": "hg4930"}, None),
        ("stim300", {}, "accelerometer_range_g"),
        ("stim300", {"accelerometer_range_g": 10}, None),
    ],
)
def test_an_assumed_setting_that_changes_every_number_is_said(driver: str, given: dict[str, object], name: str | None) -> None:
    said = assumed(load_driver(driver).load_protocol(given))
    assert [sentence.values["name"] for sentence in said] == ([] if name is None else [name])  # type: ignore[attr-defined]
