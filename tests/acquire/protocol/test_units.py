"""Units and their scales."""

from __future__ import annotations

import math

import pytest

from imufield.acquire.protocol.units import TO_SI, nominal_scale, unit_name
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
    ("text", "unit"),
    [
        ("m/s²", "m/s^2"),
        ("m/s/s", "m/s^2"),
        ("[m/s^2]", "m/s^2"),
        ("G", "g"),
        ("°/s", "deg/s"),
        ("Deg/Sec", "deg/s"),
        ("rad/s", "rad/s"),
        ("°C", "degC"),
        ("rps", None),
        ("", None),
    ],
)
def test_spellings_of_units(text: str, unit: str | None) -> None:
    assert unit_name(text) == unit
