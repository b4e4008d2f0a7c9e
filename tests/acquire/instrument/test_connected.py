"""What is said of an instrument, and of settings that nobody gave."""

from __future__ import annotations

import pytest

from imufield.acquire.instrument.baud_search import driver_candidates
from imufield.acquire.instrument.connected import assumed, say_what_is_known
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


@pytest.mark.parametrize("driver", ["stim300", "aceinna_can"])
def test_what_an_instrument_says_of_itself_is_told_on_every_wire(driver: str) -> None:
    said: list[str] = []
    kind = load_driver(driver)
    say_what_is_known(kind, kind.load_protocol(), {"serial_number": "N7", "firmware": "19.1"}, said.append)
    assert "instrument: serial number N7, firmware 19.1" in said
    said.clear()
    say_what_is_known(kind, kind.load_protocol(), {}, said.append)
    assert not any(each.startswith("instrument") for each in said)


@pytest.mark.parametrize(("driver", "range_g"), [("stim300", 30), ("text", None)])
def test_what_was_read_before_holds_for_the_driver_that_has_it(driver: str, range_g: float | None) -> None:
    (candidate,) = driver_candidates(load_driver(driver), {}, read={"accelerometer_range_g": "30"})
    setting = candidate.protocol.settings.get("accelerometer_range_g")
    assert (setting and (setting.value, setting.origin)) == (range_g and (range_g, "read"))
