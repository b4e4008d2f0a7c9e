"""Flicker noise and random walk by their Allan deviation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.simulate.truth.drift import BiasDrift


def allan(values: np.ndarray, group: int) -> float:
    """Overlapping Allan deviation of all channels together, ``group`` values to a mean."""
    total = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), values]), axis=0)
    means = (total[group:] - total[:-group]) / group
    return float(np.sqrt(0.5 * np.mean((means[group:] - means[:-group]) ** 2)))


def read(instability: float, walk: float, duration_s: float, seed: int = 1, channels: int = 8) -> np.ndarray:
    drift = BiasDrift(np.full(channels, instability), np.full(channels, walk), np.random.default_rng(seed))
    return drift.at(np.arange(0.0, duration_s, 0.5))


@pytest.mark.parametrize("tau_s", [5, 20, 100])
def test_flicker_has_the_floor_of_the_standard(tau_s: int) -> None:
    values = read(1.0, 0.0, 20000.0)
    # IEEE Std 952: sqrt(2 ln 2 / pi) B at every tau well inside the band of the time constants
    assert allan(values, 2 * tau_s) == pytest.approx(math.sqrt(2 * math.log(2) / math.pi), rel=0.1)


@pytest.mark.parametrize("tau_s", [10, 100])
def test_random_walk_rises_with_the_root_of_time(tau_s: int) -> None:
    values = read(0.0, 1e-3, 20000.0)
    assert allan(values, 2 * tau_s) == pytest.approx(1e-3 * math.sqrt(tau_s / 3), rel=0.1)


def test_reading_in_pieces_changes_nothing() -> None:
    time_s = np.arange(0.0, 60.0, 0.013)
    whole = BiasDrift(np.ones(2), np.ones(2), np.random.default_rng(1)).at(time_s)
    drift = BiasDrift(np.ones(2), np.ones(2), np.random.default_rng(1))
    parts = [drift.at(part) for part in np.array_split(time_s, 37)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_it_is_continuous() -> None:
    values = BiasDrift(np.ones(3), np.zeros(3), np.random.default_rng(1)).at(np.arange(0.0, 30.0, 1e-3))
    assert np.abs(np.diff(values, axis=0)).max() < 0.05
