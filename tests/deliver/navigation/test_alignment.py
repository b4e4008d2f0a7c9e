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

from imufield.deliver.navigation.alignment import Heading, NoiseDensity, RestMeans, align, coarse_attitude, rotation
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import FloatArray
from tests.refused import refused

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
    aligned = [align(means(attitude, seed=seed), LATITUDE_DEG, NOISE) for seed in range(15)]
    errors = np.array([phi_of(one.attitude, attitude) for one in aligned])
    normalised = np.sqrt(np.mean(errors**2, axis=0) / np.diag(aligned[0].covariance))
    # 15 seeds know a sigma to 18 %.
    assert np.all((normalised > 0.55) & (normalised < 1.45))


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
    with refused(UsageError, Reason.USAGE, "85 deg", key="alignment.latitude") as caught:
        align(means(random_attitude(0)), 89.0, NOISE)
    assert caught.value.values["latitude_deg"] == 89


def test_no_rate_is_refused() -> None:
    with refused(RecordingError, Reason.BAD_DATA, "m/s^2", "rad/s", key="alignment.no_north"):
        coarse_attitude(np.array([0.0, 0.0, 9.8]), np.zeros(3))


def heading_of(attitude: FloatArray) -> float:
    """Direction of the body x axis in the north-east plane."""
    return float(np.arctan2(attitude[1, 0], attitude[0, 0]))


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_told_heading_gives_the_exact_attitude_without_any_rate(seed: int) -> None:
    attitude = random_attitude(seed)
    force, _ = inputs(attitude)
    spinless = RestMeans(1.0, np.tile(force, (300, 1)), np.zeros((300, 3)))
    told = Heading(heading_of(attitude))
    # Without the Earth's rate the filter takes its absence for a tilting of 15 deg/h, and the accelerometer takes that off.
    assert np.abs(phi_of(align(spinless, LATITUDE_DEG, NOISE, told).attitude, attitude)).max() < 2e-3
    exact = align(means(attitude), LATITUDE_DEG, NOISE, told)
    assert np.abs(phi_of(exact.attitude, attitude)).max() < 1e-9


def test_a_told_heading_is_as_uncertain_as_its_teller() -> None:
    attitude = rotation(np.array([0.1, -0.2, 0.9]))
    aligned = align(means(attitude, seed=3), LATITUDE_DEG, NOISE, Heading(heading_of(attitude), 0.01))
    assert aligned.covariance[2, 2] == pytest.approx(1e-4)
    assert np.sqrt(aligned.covariance[0, 0]) < 1e-5
    to_n = np.kron(np.eye(2), attitude.T)
    # An error of the east gyroscope would turn a found heading by 1 / north rate = 2e4 rad per rad/s.
    assert abs((aligned.response @ to_n)[2, 4]) < 1e-2 / north_rate()


def test_a_told_heading_of_a_vertical_axis_is_refused() -> None:
    attitude = rotation(np.array([0.0, np.radians(-85), 0.0]))
    with refused(UsageError, Reason.USAGE, "80 deg", "--heading", key="alignment.steep") as caught:
        align(means(attitude), LATITUDE_DEG, NOISE, Heading(0.0))
    assert caught.value.values["steep_deg"] == pytest.approx(85)
