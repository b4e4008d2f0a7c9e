"""Units and their scales."""

from __future__ import annotations

import pytest

from imufield.acquire.protocol.units import nominal_scale


def test_nominal_scales() -> None:
    assert nominal_scale("g") == pytest.approx(0.1019716)
    assert nominal_scale("deg/s") == pytest.approx(57.29578)
    assert nominal_scale("m/s") == nominal_scale("rad/s") == 1
    assert nominal_scale("count") is nominal_scale("furlong") is None
