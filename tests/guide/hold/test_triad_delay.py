"""The delay between the triads, as a trembling hold shows it, against the simulated truth."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.guide.hold.triad_delay import USUAL_S, TriadDelay, triad_delay
from imufield.samples import IntArray, Samples
from tests.guide.hands import HeldUnit, trembling

pytestmark = pytest.mark.numerical

DELAYS_S = (-0.002, -0.0007, 0.0, 0.0013, 0.002)
ARM_M = (0.03, -0.04, 0.05)


def estimate(samples: Samples, rows: slice | IntArray = slice(None)) -> TriadDelay:
    time_s, force, rate = samples.time_s[rows], samples.accelerometer[rows], samples.gyroscope[rows]
    return triad_delay(time_s, force, rate, np.ones(len(time_s)))


def trembling_samples(
    delay_s: float, rate_hz: float = 200.0, duration_s: float = 10.0, seed: int = 1, sway_deg: float = 0.5
) -> Samples:
    return HeldUnit(trembling(seed, 10.0, 0.05, sway_deg), np.array(ARM_M)).samples(rate_hz, duration_s, delay_s)


@pytest.mark.parametrize("delay_s", DELAYS_S)
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 250.0])
def test_the_delay_is_found(rate_hz: float, delay_s: float) -> None:
    assert estimate(trembling_samples(delay_s, rate_hz)).delay_s == pytest.approx(delay_s, abs=10e-6)


@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_a_short_hold_finds_it_too(delay_s: float) -> None:
    assert estimate(trembling_samples(delay_s, duration_s=3.0)).delay_s == pytest.approx(delay_s, abs=20e-6)


def test_without_an_arm_gravity_alone_shows_it() -> None:
    unit = HeldUnit(trembling(2, 9.0, 0.05, 0.3), np.zeros(3))
    assert estimate(unit.samples(200.0, 10.0, 0.001)).delay_s == pytest.approx(0.001, abs=40e-6)


def test_the_gains_of_the_triads_do_not_turn_the_phase() -> None:
    samples = trembling_samples(0.0015)
    for force, rate in ((1.0, 1.03), (0.97, 1.0), (16384.0, 1.0)):
        found = triad_delay(samples.time_s, samples.accelerometer * force, samples.gyroscope * rate, np.ones(len(samples)))
        assert found.delay_s == pytest.approx(0.0015, abs=20e-6)


@pytest.mark.parametrize(("force_sigma", "rate_sigma"), [(0.005, 5e-4), (0.05, 5e-3), (0.5, 5e-3)])
def test_noise_is_in_the_sigma_and_shrinks_the_delay(force_sigma: float, rate_sigma: float) -> None:
    delay_s, samples = 0.001, trembling_samples(0.001)
    rng = np.random.default_rng(3)
    found = []
    for _ in range(60):
        force = samples.accelerometer + force_sigma * rng.standard_normal(samples.accelerometer.shape)
        rate = samples.gyroscope + rate_sigma * rng.standard_normal(samples.gyroscope.shape)
        found.append(triad_delay(samples.time_s, force, rate, np.ones(len(samples))))
    errors = np.array([one.delay_s - delay_s for one in found])
    sigmas = np.array([one.sigma_s for one in found])
    assert 0.5 < np.sqrt(np.mean((errors / sigmas) ** 2)) < 1.4
    # Never worse than to know nothing but the usual size.
    assert np.all(sigmas <= USUAL_S)
    assert np.sqrt(np.mean(errors**2)) < 1.1 * delay_s


def test_what_sway_adds_beside_the_lines_of_tremor_is_in_the_sigma() -> None:
    """In three seconds its sidebands lie under the tremor, while most of the band is empty; without them the ratio is 2.5."""
    ratio = []
    for seed in range(20):
        found = estimate(trembling_samples(0.001, duration_s=3.0, seed=seed))
        ratio.append((found.delay_s - 0.001) / found.sigma_s)
    assert 0.5 < np.sqrt(np.mean(np.square(ratio))) < 1.6


@pytest.mark.parametrize("late", [-3, -2, 3, 4])
def test_a_delay_of_no_instrument_is_none(late: int) -> None:
    """Motion all over the band shows one of 12 to 18 ms as well, sharply; it is not that of a filter."""
    rng = np.random.default_rng(6)
    time_s, rate = np.arange(1000) / 200.0, 0.05 * rng.standard_normal((1000, 3))
    turned = np.cumsum(rate, axis=0) / 200.0
    force = np.array([0.0, 0.0, 9.8]) + np.cross([0.0, 0.0, 9.8], np.roll(turned, late, axis=0))
    assert triad_delay(time_s, force, rate, np.ones(1000)) == TriadDelay(0.0, USUAL_S)


def test_a_unit_at_rest_shows_none() -> None:
    rng = np.random.default_rng(4)
    time_s = np.arange(2000) / 200.0
    force = np.array([0.0, 0.0, 9.8]) + 0.01 * rng.standard_normal((2000, 3))
    found = triad_delay(time_s, force, 1e-5 * rng.standard_normal((2000, 3)), np.ones(2000))
    assert abs(found.delay_s) < found.sigma_s
    assert found.sigma_s > 0.5 * USUAL_S


@pytest.mark.parametrize("n", [20, 60])
def test_too_few_lines_show_none(n: int) -> None:
    assert estimate(trembling_samples(0.002)[:n]) == TriadDelay(0.0, USUAL_S)


def test_no_motion_and_no_weight_show_none() -> None:
    samples = trembling_samples(0.002)
    nothing = np.zeros((len(samples), 3))
    assert triad_delay(samples.time_s, nothing, nothing, np.ones(len(samples))).delay_s == 0
    assert triad_delay(samples.time_s, samples.accelerometer, samples.gyroscope, np.zeros(len(samples))).delay_s == 0


def test_triads_that_do_not_belong_together_have_no_delay() -> None:
    force, rate = trembling_samples(0.0), trembling_samples(0.0, seed=9)
    found = triad_delay(force.time_s, force.accelerometer, rate.gyroscope, np.ones(len(force)))
    assert abs(found.delay_s) < 3 * USUAL_S
    assert found.sigma_s > 0.1 * USUAL_S


def test_lost_samples_and_a_hole_change_little() -> None:
    samples = trembling_samples(0.002, rate_hz=500.0)
    keep = np.random.default_rng(5).random(len(samples)) > 0.002
    keep[2000:2010] = False
    assert estimate(samples, np.flatnonzero(keep)).delay_s == pytest.approx(0.002, abs=20e-6)
