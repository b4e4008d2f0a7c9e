import math
from typing import Any

import numpy as np
import pytest

from imufield.guide.stillness.turn_fit import REACH, Sway, cells_of_turn, sway_of

pytestmark = pytest.mark.numerical

Array = np.ndarray[Any, Any]
LEAST = math.radians(0.2)
LENGTH = 150
SWAY = math.radians(1.0)


def swaying(seed: int, count: int = LENGTH) -> Array:
    """Return rates of an arm that sways by 1 degree rms about each axis below 2 Hz, cells of 0.1 s, rad/s, shape (count, 3)."""
    rng = np.random.default_rng(seed)
    hz = np.array([0.2, 0.6, 1.0, 1.4, 1.8])[:, np.newaxis] + rng.uniform(-0.1, 0.1, (5, 3))
    size = SWAY * np.sqrt(2 / np.sum(hz**-2, axis=0)) / hz
    time = 0.1 * np.arange(count + 1)[:, np.newaxis, np.newaxis]
    angle = (size * np.sin(2 * math.pi * hz * time + rng.uniform(0, 2 * math.pi, (5, 3)))).sum(axis=1)
    return np.diff(angle, axis=0) / 0.1


def turning(begin: float, length: float, angle_rad: float, count: int = LENGTH) -> Array:
    """Return the rate of a minimum-jerk turn about an oblique axis that begins after so many cells."""
    share = np.clip((np.arange(count + 1) - begin) / length, 0, 1)
    made = 10 * share**3 - 15 * share**4 + 6 * share**5
    return np.outer(np.diff(made) / 0.1 * angle_rad, [2 / 3, -2 / 3, 1 / 3])


def seen_until(rate: Array, limit_rad_s: float) -> Array:
    """Return the rows before the rate passes a limit: there the detector ends the stretch."""
    fast = np.flatnonzero(np.linalg.norm(rate, axis=1) > limit_rad_s)
    return rate[: fast[0]]


def test_sway_is_the_covariance_and_the_angle_of_a_swing() -> None:
    hz, size = 0.5, 0.02
    time = 0.1 * np.arange(400)
    rate = np.stack([size * np.sin(2 * math.pi * hz * time), np.zeros(400), np.full(400, 0.3)], axis=1)
    sway = sway_of(rate)
    lags = np.arange(REACH)
    # Biased: the sum of n - lag products over n.
    expected = size**2 / 2 * np.cos(2 * math.pi * hz * 0.1 * lags) * (1 - lags / 400)
    np.testing.assert_allclose(sway.covariance[:, 0], expected, atol=0.02 * size**2)
    np.testing.assert_allclose(sway.covariance[:, 1:], 0, atol=1e-12)
    assert 0.1 * sway.angle == pytest.approx(size / (2 * math.pi * hz) / math.sqrt(2), rel=0.02)


@pytest.mark.parametrize("seed", range(12))
def test_the_angle_of_the_sway_is_not_that_of_the_mean_rate(seed: int) -> None:
    """The mean rate of a hold is known only as far as it sways: integrated, it would make a drift of 7 %, or 20 at times."""
    assert 0.1 * sway_of(swaying(seed, 120)).angle == pytest.approx(math.sqrt(3) * SWAY, rel=0.05)


def test_a_slow_turn_that_nearly_halts_again_and_again_is_one_turn() -> None:
    """Cells in which it is slow are as unlike a smooth turn as the fast ones before them."""
    wobble = 0.9 * np.sin(2 * math.pi * 0.15 * np.arange(LENGTH))
    for seed in range(60):
        begin = 120 + 0.37 * (seed % 10)
        turn = turning(begin, 50.0, math.radians(60 + 10 * (seed % 12))) * (1 + np.roll(wobble, seed))[:, np.newaxis]
        rate = seen_until(0.2 * swaying(seed) + turn, math.radians(25))
        found = cells_of_turn(rate[-REACH:] - rate[:110].mean(axis=0), sway_of(rate[:110]), LEAST)
        assert found is not None
        assert begin - 1 <= len(rate) - found <= begin + 7.5


def test_sway_of_a_short_hold_has_no_covariance_beyond_it() -> None:
    covariance = sway_of(swaying(1, REACH - 5)).covariance
    assert covariance.shape == (REACH, 3)
    assert np.all(covariance[REACH - 5 :] == 0)
    assert np.all(covariance[0] > 0)


@pytest.mark.parametrize("seed", range(12))
def test_a_slow_turn_is_found_between_where_it_shows_and_where_it_begins(seed: int) -> None:
    begin, length, angle = 120.0 + 0.37 * seed, 50.0, math.radians(80 + 10 * seed)
    rate = seen_until(swaying(seed) + turning(begin, length, angle), math.radians(25))
    hold = rate[:110]
    found = cells_of_turn(rate[-REACH:] - hold.mean(axis=0), sway_of(hold), LEAST)
    assert found is not None
    # From here on the turn has made more than the three axes sway together.
    made = np.cumsum(np.linalg.norm(turning(begin, length, angle), axis=1)) * 0.1
    hidden = float(np.flatnonzero(made > math.sqrt(3) * SWAY)[0])
    assert begin - 3 <= len(rate) - found <= hidden + 3


@pytest.mark.parametrize("seed", range(12))
def test_sway_alone_is_no_turn(seed: int) -> None:
    rate = swaying(seed)
    assert cells_of_turn(rate[-REACH:] - rate.mean(axis=0), sway_of(rate), LEAST) is None


def test_what_is_below_the_least_rate_is_no_turn() -> None:
    still = np.zeros((REACH, 3))
    assert cells_of_turn(still + 0.3 * LEAST, Sway(still, 0.0), LEAST) is None


def test_the_unit_of_the_rate_does_not_matter() -> None:
    rate = seen_until(swaying(3) + turning(121, 30, 1.2), math.radians(20))
    found = [
        cells_of_turn(unit * rate[-REACH:], sway_of(unit * rate[:110]), unit * LEAST) for unit in (1.0, 180 / math.pi, 1e-6)
    ]
    assert found[0] is not None
    np.testing.assert_allclose(found[1:], found[0], rtol=1e-6)  # type: ignore[arg-type]
