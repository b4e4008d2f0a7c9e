"""Means, stillness and noise of an instrument at rest."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.deliver.navigation.rest import IntervalMeans, allan_variance, fill_gaps, measure_noise, moving_seconds
from imufield.samples import FloatArray
from imufield.simulate.truth.drift import BiasDrift

pytestmark = pytest.mark.numerical

RNG_SEED = 3


def test_means_do_not_depend_on_how_the_stream_is_cut() -> None:
    time_s = np.arange(0, 20, 0.03)
    values = np.random.default_rng(RNG_SEED).normal(size=(len(time_s), 6))
    slot = np.floor(time_s).astype(int)
    expected = np.array([values[slot == k].mean(axis=0) for k in range(19)])
    for size in (1, 7, 1000):
        means = IntervalMeans(0.0)
        for first in range(0, len(time_s), size):
            means.feed(time_s[first : first + size], values[first : first + size])
        np.testing.assert_allclose(means.finish(), expected, atol=1e-12)


def test_a_second_without_samples_is_not_a_number_and_is_filled() -> None:
    means = IntervalMeans(0.0)
    time_s = np.array([0.1, 0.2, 2.5, 3.5])
    means.feed(time_s, np.repeat(time_s[:, None], 6, axis=1))
    found = means.finish()
    assert np.isnan(found[1]).all()
    np.testing.assert_allclose(fill_gaps(found)[1], (0.15 + 2.5) / 2)


def rest(n: int = 2000, seed: int = RNG_SEED) -> FloatArray:
    sigma = np.repeat([5e-5, 6e-7], 3)
    return np.array([0, 0, 9.8, 1e-5, 5e-5, 0]) + sigma * np.random.default_rng(seed).standard_normal((n, 6))


def test_rest_is_still_and_a_turn_is_not() -> None:
    means = rest()
    assert not moving_seconds(means).any()
    means[700:703, 3] += 1.0
    means[703:, :3] = [0, 9.8, 0]
    moving = np.flatnonzero(moving_seconds(means))
    assert moving.min() == 700
    assert moving.max() < 715


@pytest.mark.parametrize(("sway_deg", "moves"), [(1.0, True), (0.0, False)])
def test_a_hand_all_the_time_is_no_noise(sway_deg: float, moves: bool) -> None:
    rng = np.random.default_rng(RNG_SEED)
    # Beside the poorest noise of an instrument, the tilt of an arm from second to second.
    sigma = np.repeat([0.015, np.radians(0.08)], 3)
    tilt = np.radians(sway_deg) * rng.standard_normal((600, 2))
    means = np.array([0, 0, 9.8, 0, 0, 0]) + sigma * rng.standard_normal((600, 6))
    means[:, :2] += 9.8 * tilt
    means[1:, 3:5] += np.diff(tilt, axis=0)
    assert (np.count_nonzero(moving_seconds(means)) > 60) == moves
    assert moves or not moving_seconds(means).any()


def test_noise_density_is_that_of_the_second_means() -> None:
    noise = measure_noise(rest())
    np.testing.assert_allclose(noise.density, np.repeat([5e-5, 6e-7], 3), rtol=0.06)
    assert noise.triads().force == pytest.approx(5e-5, rel=0.04)
    assert noise.triads().rate == pytest.approx(6e-7, rel=0.04)


def test_instability_is_that_of_the_flicker_and_not_of_the_floor() -> None:
    flicker = np.repeat([30e-6, 2e-8], 3)
    found = []
    for seed in range(4):
        drift = BiasDrift(flicker, np.zeros(6), np.random.default_rng(seed)).at(np.arange(18_000.0))
        found.append(measure_noise(rest(18_000, seed=seed) + drift).instability / flicker)
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0, abs=0.1)


def test_instability_of_white_noise_is_what_could_be_overlooked() -> None:
    means = rest(18_000)
    floor = 0.3 * np.sqrt(allan_variance(means)[1].min(axis=0))
    found = measure_noise(means).instability
    assert np.all((found > 0) & (found < 10 * floor))
    assert np.isnan(measure_noise(means[:500]).instability).all()


def test_allan_variance_is_that_of_the_definition() -> None:
    means = rest(700)
    tau_s, variance = allan_variance(means)
    assert tau_s[-1] == 128.0
    m = 32
    averages = np.array([means[k : k + m].mean(axis=0) for k in range(len(means) - m + 1)])
    expected = np.mean((averages[m:] - averages[:-m]) ** 2, axis=0) / 2
    np.testing.assert_allclose(variance[list(tau_s).index(m)], expected, rtol=1e-9)
    assert measure_noise(np.ones((700, 6))).instability.tolist() == [0.0] * 6
