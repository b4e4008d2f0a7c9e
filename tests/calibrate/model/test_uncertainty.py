"""Weights, scatter between positions and covariances, each against a second route."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_truth import GRAVITY, campaign, random_parameters

from imufield.calibrate.accelerometer.ellipsoid_start import closed_form_start
from imufield.calibrate.accelerometer.fit import FitData, column_basis, fit
from imufield.calibrate.model.coverage_factors import student_factor
from imufield.calibrate.model.models import PARAMETERS, from_vector, norm_derivatives, predict, recover, to_vector
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS
from imufield.calibrate.model.uncertainty import (
    between_position_sigma,
    bounded_cross_covariance,
    distinguishing_digits,
    estimated_share,
    gravity_sensitivity,
    inverse_root,
    known_covariance,
    within_variance,
)

pytestmark = pytest.mark.numerical

LINEAR = LOWER_GAUGE_COLUMNS[:9]


@pytest.mark.parametrize("size", [0, 1, 32, 33, 101, 188])
def test_the_inverse_root_whitens(size: int) -> None:
    noise = np.random.default_rng(size).normal(size=(size, 2 * size + 1)) * np.geomspace(1, 1e-8, size)[:, None]
    root = inverse_root(noise @ noise.T)
    assert np.array_equal(root, np.tril(root))
    assert root @ noise @ noise.T @ root.T == pytest.approx(np.eye(size), abs=1e-9)


def test_what_has_no_root_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        inverse_root(np.diag([1.0, -1.0]))


def test_between_position_sigma_by_hand() -> None:
    # Mean of 3 values 0, 1, 2 with equal within variance w: chi^2 = 2 / (w + tau^2) = 2 degrees of freedom.
    residual, jacobian = np.array([0.0, 1.0, 2.0]), np.ones((3, 1))
    assert between_position_sigma(residual, jacobian, np.full(3, 0.19)) == pytest.approx(0.9)
    assert between_position_sigma(residual, jacobian, np.full(3, 1.5)) == 0
    assert between_position_sigma(residual, jacobian, np.zeros(3)) == pytest.approx(1.0)
    assert between_position_sigma(residual[:1], jacobian[:1], np.ones(1)) == 0


def test_between_position_sigma_makes_chi_squared_its_expectation() -> None:
    rng = np.random.default_rng(2)
    within = rng.uniform(0.1, 3, 30) ** 2
    jacobian = rng.normal(0, 1, (30, 5))
    residual = rng.normal(0, np.sqrt(within + 2))
    tau = between_position_sigma(residual, jacobian, within)
    weight = 1 / np.sqrt(within + tau**2)
    rest = np.linalg.lstsq(jacobian * weight[:, None], residual * weight, rcond=None)[1]
    assert rest[0] == pytest.approx(25, rel=1e-6)


def test_scatter_between_positions_is_found() -> None:
    taus = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        observations = campaign(random_parameters(rng), rng, between_m_s2=2e-3)
        start = closed_form_start(observations.mean_raw, GRAVITY, np.ones(3))
        data = FitData(
            raw=observations.mean_raw,
            covariance_raw=observations.covariance_raw,
            gravity_m_s2=GRAVITY,
            quadratic_axes="sensing",
        )
        taus.append(fit(data, start, column_basis(start, LINEAR, GRAVITY)).tau_m_s2)
    assert np.mean(taus) == pytest.approx(2e-3, rel=0.1)


def test_within_variance_against_a_sample_of_outputs() -> None:
    rng = np.random.default_rng(0)
    truth = random_parameters(rng, 0.02)
    raw = predict(truth, GRAVITY * np.array([[0.6, 0.0, 0.8]]))
    root = rng.normal(0, 1, (3, 3))
    draws = raw + rng.normal(0, 1, (200_000, 3)) @ root.T
    norms = np.linalg.norm(recover(truth, draws), axis=1)
    gradient = norm_derivatives(to_vector(truth), raw).raw_gradient
    assert within_variance(gradient, (root @ root.T)[None]) == pytest.approx(norms.var(), rel=0.02)


def test_gravity_sensitivity_against_scaled_parameters() -> None:
    truth = random_parameters(np.random.default_rng(5), 0.02)
    vector, step = to_vector(truth), 1e-4
    raw = predict(truth, GRAVITY * np.eye(3))
    moved = from_vector(vector + step * gravity_sensitivity(vector, GRAVITY))
    assert np.linalg.norm(recover(moved, raw), axis=1) == pytest.approx(np.full(3, GRAVITY + step), abs=1e-8)


def test_known_covariance() -> None:
    good = np.broadcast_to(np.eye(3), (4, 3, 3)).copy()
    assert known_covariance(good) is good
    for bad in (0.0, -1.0, np.nan):
        damaged = good.copy()
        damaged[2] *= bad
        assert known_covariance(damaged) is None


def test_a_covariance_that_is_not_known_is_left_as_it_is() -> None:
    """A parameter that cannot be seen has none; the others' are not touched beside it."""
    cross = np.array([[np.nan, np.nan], [0.5, 2.0]])
    theirs = np.diag([np.nan, 1.0])
    np.testing.assert_array_equal(bounded_cross_covariance(cross, np.eye(2), theirs), cross)


def test_two_numbers_are_shown_with_the_digits_that_tell_them_apart() -> None:
    assert distinguishing_digits(3.14, 2.01) == ("3.1", "2.0")
    assert distinguishing_digits(2.03, 2.01) == ("2.03", "2.01")
    assert distinguishing_digits(2.0, 2.0) == ("2.0000", "2.0000")


def test_what_is_known_beforehand_has_no_degrees_of_freedom_to_lose() -> None:
    # Half of the variance of each parameter is gravity's or typical, half is told by five residuals.
    told, gravity, typical = np.full(PARAMETERS, 0.5), np.zeros(PARAMETERS), np.zeros((PARAMETERS, PARAMETERS))
    gravity[:6] = np.sqrt(0.5) * 0.01
    typical[range(6, PARAMETERS), range(6, PARAMETERS)] = np.sqrt(0.5)
    step = np.append(gravity, 1e-4)
    covariance = np.outer(step, step) / 1e-4
    covariance[:PARAMETERS, :PARAMETERS] += np.diag(told) + typical @ typical.T
    share = estimated_share(covariance, typical)
    assert share == pytest.approx(0.5)
    rng = np.random.default_rng(4)
    error = np.sqrt(0.5) * (rng.standard_normal(100_000) + rng.standard_normal(100_000))
    sigma = np.sqrt(0.5 * (1 + rng.chisquare(5, 100_000) / 5))
    inside = [np.mean(np.abs(error) < student_factor(freedom) * sigma) for freedom in (5 / share**2, 5)]
    assert inside[0] == pytest.approx(0.95, abs=0.01)
    assert inside[1] > 0.97
