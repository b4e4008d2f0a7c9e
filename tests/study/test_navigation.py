from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.deliver.navigation.alignment import coarse_attitude
from imufield.samples import FloatArray
from imufield.study.navigation import DOWN_UP, WhiteNoise, navigate_at_rest, rest_inputs

LATITUDE = 45.0
SILENT = WhiteNoise(0.0, 0.0)


@pytest.fixture(autouse=True)
def pyins() -> None:
    """Skip where it is absent; imported only where a test runs, as it brings Numba."""
    pytest.importorskip("pyins", reason="needs the nav extra")


def rest(heading_deg: float = 0.0) -> tuple[FloatArray, FloatArray]:
    return rest_inputs(LATITUDE, heading_deg)


def test_at_rest_the_unit_feels_gravity_up_and_the_earth() -> None:
    force, rate = rest()
    assert force == pytest.approx([0.0, 0.0, 9.80620], abs=2e-4)
    earth = 7.292115e-5
    assert rate == pytest.approx([earth * math.cos(math.pi / 4), 0.0, earth * math.sin(math.pi / 4)], abs=1e-9)


def test_alignment_finds_the_heading() -> None:
    force, rate = rest(30.0)
    matrix = coarse_attitude(DOWN_UP @ force, DOWN_UP @ rate)
    assert math.degrees(math.atan2(matrix[1, 0], matrix[0, 0])) == pytest.approx(30.0, abs=1e-9)
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)


def test_a_perfect_unit_stays_where_it_is() -> None:
    force, rate = rest(30.0)
    errors = navigate_at_rest(force, rate, LATITUDE, hours=5, noise=SILENT, rng=np.random.default_rng(0))
    assert errors.hours[-1] == pytest.approx(5.0)
    assert errors.position_nmi.max() < 1e-3


def test_an_accelerometer_bias_with_the_attitude_told_swings_with_schuler() -> None:
    # x = b / w^2 (1 - cos(w t)) with w = sqrt(g / R): twice b R / g after half a period of 84.4 min.
    force, rate = rest()
    bias = 1e-3
    errors = navigate_at_rest(
        force + np.array([bias, 0, 0]),
        rate,
        LATITUDE,
        hours=0.703,
        noise=SILENT,
        rng=np.random.default_rng(0),
        attitude_rph_deg=np.zeros(3),
    )
    expected_rad = 2 * bias / 9.8062
    assert math.radians(errors.latitude_deg[-1]) == pytest.approx(expected_rad, rel=0.02)


def test_alignment_hides_an_accelerometer_bias() -> None:
    force, rate = rest()
    told = navigate_at_rest(
        force + np.array([1e-3, 0, 0]),
        rate,
        LATITUDE,
        hours=5,
        noise=SILENT,
        rng=np.random.default_rng(0),
        attitude_rph_deg=np.zeros(3),
    )
    aligned = navigate_at_rest(
        force + np.array([1e-3, 0, 0]), rate, LATITUDE, hours=5, noise=SILENT, rng=np.random.default_rng(0)
    )
    assert aligned.position_nmi.max() < 0.7 * told.position_nmi.max()


def test_alignment_hides_an_east_gyroscope_bias_but_not_a_north_one() -> None:
    # The heading found by alignment turns until the east rate vanishes; 0.01 deg/h to the north makes miles in five hours.
    force, rate = rest()
    bias = np.radians(0.01 / 3600)
    largest = [
        navigate_at_rest(force, rate + offset, LATITUDE, hours=5, noise=SILENT, rng=np.random.default_rng(0)).position_nmi.max()
        for offset in (np.array([0, bias, 0]), np.array([bias, 0, 0]))
    ]
    assert largest[0] < 0.01
    assert 2.0 < largest[1] < 4.0
