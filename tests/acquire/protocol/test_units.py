"""Units and their scales."""

from __future__ import annotations

import math

import pytest

from imufield.acquire.protocol.units import SECONDS, TO_DEGC, TO_SI, UNITS_OF, nominal_scale, unit_name
from imufield.earth import STANDARD_GRAVITY_M_S2


def test_nominal_scales() -> None:
    assert nominal_scale("g") == pytest.approx(0.1019716)
    assert nominal_scale("deg/s") == pytest.approx(57.29578)
    assert nominal_scale("m/s") == nominal_scale("rad/s") == 1
    assert nominal_scale("count") is nominal_scale("furlong") is None


def test_factors_are_the_nearest_numbers() -> None:
    assert TO_SI["g"][1] == TO_SI["g*s"][1] == STANDARD_GRAVITY_M_S2
    assert TO_SI["mg"][1] == STANDARD_GRAVITY_M_S2 / 1e3
    assert TO_SI["deg/s"][1] == TO_SI["deg"][1] == math.pi / 180
    assert TO_SI["arcsec"][1] == math.pi / 648000


@pytest.mark.parametrize(
    ("quantity", "text", "unit"),
    [
        ("accelerometer", "m/s²", "m/s^2"),
        ("accelerometer", "m/s/s", "m/s^2"),
        ("accelerometer", "[m/s^2]", "m/s^2"),
        ("accelerometer", "m s-2", "m/s^2"),
        ("accelerometer", "G", "g"),
        ("accelerometer", "g*s", "g*s"),
        ("accelerometer", "Gs", None),
        ("accelerometer", "m*s^-2", "m/s^2"),
        ("accelerometer", "m·s⁻²", "m/s^2"),
        ("accelerometer", "meters/sec^2", "m/s^2"),
        ("accelerometer", "ms", None),
        ("gyroscope", "°/s", "deg/s"),
        ("gyroscope", "º/s", "deg/s"),
        ("gyroscope", "Deg/Sec", "deg/s"),
        ("gyroscope", "degrees/second", "deg/s"),
        ("gyroscope", "°·s⁻¹", "deg/s"),
        ("gyroscope", "rad s^-1", "rad/s"),
        ("gyroscope", "deg/h", "deg/h"),
        ("gyroscope", "rad/s", "rad/s"),
        ("gyroscope", "m/s^2", None),
        ("gyroscope", "rps", None),
        ("temperature", "°C", "degC"),
        ("temperature", "degF", "degF"),
        ("temperature", "℃", "degC"),
        ("time", "msec", "ms"),
        ("time", "\u03bcs", "us"),
        ("time", "\u00b5s", "us"),
        ("time", "10us", None),
        ("time", "", None),
    ],
)
def test_spellings_of_units(quantity: str, text: str, unit: str | None) -> None:
    assert unit_name(text, quantity) == unit


def test_every_unit_is_its_own_spelling() -> None:
    for part, units in UNITS_OF.items():
        names = {name for name, (si, _) in TO_SI.items() if si in units} if part != "temperature" else TO_DEGC
        assert all(unit_name(name, part) == name for name in names)
    assert all(unit_name(name, "time") == name for name in SECONDS)


def test_temperatures_are_those_of_their_scales() -> None:
    # Where Fahrenheit and Celsius agree, the boiling point of water, and absolute zero.
    for unit, value, degc in (("degF", -40.0, -40.0), ("degF", 212.0, 100.0), ("K", 0.0, -273.15), ("degC", 20.0, 20.0)):
        factor, offset = TO_DEGC[unit]
        assert factor * value + offset == pytest.approx(degc, abs=1e-12)
