"""Alignment against the attitude that made the data, its own covariance, and textbook errors."""

from __future__ import annotations

import numpy as np
import pytest
from at_rest import (
    FORCE_DENSITY,
    GRAVITY_M_S2,
    LATITUDE_DEG,
    RATE_DENSITY,
    inputs,
    north_rate,
    phi_of,
    random_attitude,
)

from imufield.deliver.navigation.alignment import NoiseDensity, RestMeans, align, coarse_attitude, rotation
from imufield.errors import RecordingError, UsageError
from imufield.samples import FloatArray

NOISE = NoiseDensity(FORCE_DENSITY, RATE_DENSITY)


def means(attitude: FloatArray, n: int = 600, *, seed: int | None = None) -> RestMeans:
    f, w = inputs(attitude)
    rng = np.random.default_rng(0 if seed is None else seed)
    scale = 0.0 if seed is None else 1.0
    return RestMeans(
        1.0,
        f + scale * FORCE_DENSITY * rng.standard_normal((n, 3)),
        w + scale * RATE_DENSITY * rng.standard_normal((n, 3)),
    )


@pytest.mark.parametrize("seed", range(5))
def test_exact_data_give_the_exact_attitude(seed: int) -> None:
    attitude = random_attitude(seed)
    found = align(means(attitude), LATITUDE_DEG, NOISE).attitude
    assert np.abs(phi_of(found, attitude)).max() < 1e-9


def test_coarse_attitude_of_exact_vectors_is_exact() -> None:
    attitude = random_attitude(7)
    np.testing.assert_allclose(coarse_attitude(*inputs(attitude)), attitude, atol=1e-12)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    attitude = random_attitude(11)
    aligned = [align(means(attitude, seed=seed), LATITUDE_DEG, NOISE) for seed in range(25)]
    errors = np.array([phi_of(one.attitude, attitude) for one in aligned])
    normalised = np.sqrt(np.mean(errors**2, axis=0) / np.diag(aligned[0].covariance))
    assert np.all((normalised > 0.65) & (normalised < 1.35))


def test_heading_is_found_as_well_as_the_mean_rate_allows() -> None:
    aligned = align(means(random_attitude(3), seed=1), LATITUDE_DEG, NOISE)
    bound = RATE_DENSITY / np.sqrt(600) / north_rate()
    assert bound <= np.sqrt(aligned.covariance[2, 2]) < 1.1 * bound


def test_response_is_tilt_by_force_and_heading_by_east_rate() -> None:
    attitude = random_attitude(5)
    aligned = align(means(attitude), LATITUDE_DEG, NOISE)
    to_n = np.kron(np.eye(2), attitude.T)
    response = aligned.response @ to_n
    assert response[0, 1] * GRAVITY_M_S2 == pytest.approx(1.0, abs=2e-3)  # phi north = east error / g
    assert response[1, 0] * GRAVITY_M_S2 == pytest.approx(-1.0, abs=2e-3)
    assert response[2, 4] * north_rate() == pytest.approx(1.0, abs=2e-2)  # heading = east rate error / north rate


def test_slow_settling_is_forgiven_by_the_fine_alignment_only() -> None:
    attitude, n = random_attitude(2), 600
    settled = 200e-6 * (1 - np.exp(-np.arange(n) / 200.0))  # rad, about east
    f, w = inputs(attitude)
    # Tilted by t about east: C_nb = R(t) C, so the body feels C^T R(-t) f_n, and turns by dt/dt about east.
    east = attitude.T @ [0.0, 1.0, 0.0]
    force = np.array([rotation(-t * east) @ f for t in settled])
    rate = w + np.gradient(settled)[:, None] * east
    end = rotation(np.array([0.0, settled[-1], 0.0])) @ attitude
    fine = phi_of(align(RestMeans(1.0, force, rate), LATITUDE_DEG, NOISE).attitude, end)
    coarse = phi_of(coarse_attitude(force.mean(axis=0), rate.mean(axis=0)), end)
    assert abs(coarse[2]) > 5e-3
    assert abs(fine[2]) < 5e-4


def test_pole_is_refused() -> None:
    with pytest.raises(UsageError, match="latitude 89"):
        align(means(random_attitude(0)), 89.0, NOISE)


def test_no_rate_is_refused() -> None:
    with pytest.raises(RecordingError, match="show no level and north"):
        coarse_attitude(np.array([0.0, 0.0, 9.8]), np.zeros(3))
