"""What tremor adds to a held mean where everything is at its worst: the same hold with and without it, noise-free."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imufield.earth import MICRO_G_M_S2
from imufield.guide.hold.hand_mean import HandMean, mean_in_hand
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import Samples
from imufield.simulate.truth.motion import Site
from tests.guide.hands import HeldUnit, trembling

TREMOR_DEG = 0.1
ARMS_M = {"none": (0.0, 0.0, 0.0), "along": (0.0, 0.0, 0.1), "across": (0.1, 0.0, 0.0), "oblique": (-0.06, 0.05, -0.06)}
HOLD_S = 5.0
DELAYS_S = (-0.002, 0.0, 0.002)


@cache
def worst(tremor_hz: float, tremor_deg: float, sway_deg: float, arm: str, rate_hz: float, delay_s: float) -> Samples:
    """Samples of a corner; the tremor's frequency is of no matter where there is none."""
    unit = HeldUnit(trembling(4, tremor_hz, tremor_deg, sway_deg), np.array(ARMS_M[arm]))
    return unit.samples(rate_hz, HOLD_S, delay_s)


def held(samples: Samples) -> HandMean:
    found = mean_in_hand(samples, RoughScale(accelerometer=1.0, gyroscope=1.0), np.zeros(6))
    assert found is not None
    return found


@cache
def without_tremor_ug(sway_deg: float, arm: str, rate_hz: float, delay_s: float) -> float:
    return norm_ug(held(worst(10.0, 0.0, sway_deg, arm, rate_hz, delay_s)))


def norm_ug(found: HandMean) -> float:
    return float(np.linalg.norm(found.force_raw)) / MICRO_G_M_S2


def sigma_ug(found: HandMean) -> float:
    along = found.force_raw / np.linalg.norm(found.force_raw)
    return math.sqrt(along @ found.covariance_raw @ along) / MICRO_G_M_S2


@pytest.mark.parametrize("delay_s", DELAYS_S)
@pytest.mark.parametrize("tremor_hz", [8.0, 10.0, 12.0])
def test_tremor_adds_little_in_every_corner(tremor_hz: float, delay_s: float) -> None:
    for sway_deg, arm, rate_hz in itertools.product((0.1, 1.0), ARMS_M, (100.0, 200.0, 500.0)):
        with_it = norm_ug(held(worst(tremor_hz, TREMOR_DEG, sway_deg, arm, rate_hz, delay_s)))
        assert abs(with_it - without_tremor_ug(sway_deg, arm, rate_hz, delay_s)) < 2.0, (sway_deg, arm, rate_hz)


@pytest.mark.parametrize("rate_hz", [300.0, 1000.0, 2000.0])
def test_the_way_in_which_samples_fall_into_steps_does_not_matter(rate_hz: float) -> None:
    with_it = norm_ug(held(worst(12.0, TREMOR_DEG, 0.1, "across", rate_hz, 0.002)))
    assert abs(with_it - without_tremor_ug(0.1, "across", rate_hz, 0.002)) < 2.0


@pytest.mark.parametrize("arm", ["along", "across", "oblique"])
def test_the_mean_of_two_samples_is_carried_to_the_middle_of_its_step(arm: str) -> None:
    """A step of 4 ms takes 0.4 % from a tremor at 12 Hz, and up to 1 ug would be left of it."""
    with_it = norm_ug(held(worst(12.0, TREMOR_DEG, 0.1, arm, 500.0, 0.0)))
    assert abs(with_it - without_tremor_ug(0.1, arm, 500.0, 0.0)) < 0.1


@pytest.mark.parametrize("rate_hz", [100.0, 500.0])
def test_where_the_clock_begins_does_not_matter(rate_hz: float) -> None:
    """Samples on the border of two steps would fall to either side as their stamps are rounded."""
    whole = worst(12.0, TREMOR_DEG, 0.1, "across", rate_hz, 0.002)
    later = replace(whole, time_s=whole.time_s + 1e4 + 0.1 / 3)
    assert abs(norm_ug(held(later)) - norm_ug(held(whole))) < 0.005


@pytest.mark.parametrize(("rate_hz", "in_a_row"), [(100.0, 1), (200.0, 2), (500.0, 4)])
def test_lost_samples_let_no_tremor_through(rate_hz: float, in_a_row: int) -> None:
    """Unbridged, one sample lost at 100 Hz makes up to 160 ug, 10 cm across, of 0.1 deg at 12 Hz."""
    whole = worst(12.0, TREMOR_DEG, 0.1, "oblique", rate_hz, 0.0)
    for first in range(len(whole) // 2, len(whole) // 2 + 12, 3):
        kept = np.delete(np.arange(len(whole)), range(first, first + in_a_row))
        assert abs(norm_ug(held(whole[kept])) - norm_ug(held(whole))) < 4.0


@pytest.mark.parametrize("rate_hz", [800.0, 2000.0])
def test_coarse_stamps_are_borne(rate_hz: float) -> None:
    """Stamps of whole milliseconds at 2000 Hz come in pairs."""
    whole = worst(12.0, TREMOR_DEG, 0.1, "oblique", rate_hz, 0.002)
    coarse = replace(whole, time_s=np.floor(whole.time_s * 1000 + 1e-6) / 1000)
    assert abs(norm_ug(held(coarse)) - norm_ug(held(whole))) < 5.0


def test_stamps_that_stand_still_give_no_mean() -> None:
    whole = worst(12.0, TREMOR_DEG, 0.1, "oblique", 100.0, 0.0)
    assert (
        mean_in_hand(replace(whole, time_s=np.zeros(len(whole))), RoughScale(accelerometer=1.0, gyroscope=1.0), np.zeros(6))
        is None
    )


@pytest.mark.parametrize("gain", [0.98, 0.99, 1.01])
def test_a_wrong_scale_of_the_gyroscope_is_in_the_sigma(gain: float) -> None:
    samples = worst(10.0, TREMOR_DEG, 0.1, "along", 200.0, 0.0)
    found = held(replace(samples, gyroscope=samples.gyroscope * gain))
    error = norm_ug(found) - Site().gravity_m_s2 / MICRO_G_M_S2
    assert abs(error) > 1.5
    assert abs(error) < 2.2 * sigma_ug(found)
