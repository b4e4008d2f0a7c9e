"""What is stated for a day that was not measured holds on such days: points of sessions drawn from known polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imufield.calibrate.model.coverage_factors import student_factor
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.calibrate.temperature.fit import RampBlocks, SessionPoints, TemperatureData, fit_orders, fit_temperature
from imufield.samples import FloatArray

pytestmark = pytest.mark.numerical

REFERENCE_DEGC = 20.0
SIGMA = np.array([1e-3, 2e-5])
"""Of bias and scale of a session."""
DAY = np.array([5e-3, 6e-5])
SLOPE = np.array([2e-3, 4e-5])


def truth(at_degc: FloatArray) -> FloatArray:
    """Return bias and scale of all days, shape (n, 2)."""
    return np.outer(at_degc - REFERENCE_DEGC, SLOPE)


def root_of(rho: float) -> FloatArray:
    """Return the Cholesky root of the covariance of bias and scale of a session."""
    return np.asarray(SIGMA[:, None] * [[1.0, 0.0], [rho, np.sqrt(1 - rho**2)]])


def points(at_degc: FloatArray, rng: np.random.Generator, day: FloatArray, rho: float = 0.0) -> SessionPoints:
    """Return sessions off by their own errors, and by their days, whose bias and scale change independently."""
    m, root = len(at_degc), root_of(rho)
    off = rng.standard_normal((m, 3, 2)) @ root.T + day * rng.standard_normal((m, 3, 2))
    values = truth(at_degc)[:, None] + off
    reference = int(np.argmin(np.abs(at_degc - REFERENCE_DEGC)))
    return SessionPoints(
        temperature_degc=at_degc,
        bias=values[:, :, 0],
        scale=values[:, :, 1],
        covariance=np.broadcast_to(root @ root.T, (m, 3, 2, 2)),
        reference=reference,
    )


def model_of(found: SessionPoints) -> TriadTemperature:
    """Return the straight lines through sessions."""
    return fit_orders(TemperatureData(reference_degc=REFERENCE_DEGC, points=found), 1, 1).temperature


@pytest.mark.statistical
@pytest.mark.parametrize("sessions", [3, 5])
@pytest.mark.parametrize("days", [0.0, 1.0])
@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_a_new_day_is_inside_as_often_as_stated(sessions: int, days: float, rho: float) -> None:
    rng, inside = np.random.default_rng(5), []
    at_degc = np.linspace(-10.0, 50.0, sessions)
    for _ in range(100):
        found = points(at_degc, rng, days * DAY, rho)
        model = model_of(found)
        assert model.new_day is not None
        # Each axis has two unknowns; the error of the reference is in part that of the residuals, which counts in favour.
        assert min(model.new_day.bias_freedom, model.new_day.scale_freedom) > 3 * (sessions - 2)
        inside.append(is_new_day_inside(found, model, days * DAY, rng))
    shares = np.mean(inside, axis=(0, 1))
    # 100 days of three axes know a share of 95 % to 1.3 %. Without a change from day to day the variance that is at least zero
    # makes it safe.
    assert np.all(shares > 0.91)
    assert days == 0.0 or np.all(shares < 0.99)


@pytest.mark.statistical
def test_days_that_differ_by_more_than_the_slope_choose_no_order_of_small_scatter() -> None:
    """With a choice the share was 0.92: where the scatter about a line was small by luck, the line was taken."""
    rng, inside = np.random.default_rng(9), []
    for _ in range(150):
        found = points(np.array([-10.0, 20.0, 50.0]), rng, 40 * DAY)
        model = fit_temperature(TemperatureData(reference_degc=REFERENCE_DEGC, points=found)).temperature
        assert (model.bias.order, model.scale.order) == (1, 1)
        inside.append(is_new_day_inside(found, model, 40 * DAY, rng))
    # 150 days of three axes know a share to 1 %.
    assert np.all(np.abs(np.mean(inside, axis=(0, 1)) - 0.95) < 0.025)


def test_a_ramp_that_shows_no_scale_opens_no_choice_of_its_order() -> None:
    """As of a gyroscope at rest."""
    rng, orders = np.random.default_rng(10), []
    at_degc = np.linspace(-10.0, 50.0, 61)
    for _ in range(20):
        ramp = RampBlocks(
            temperature_degc=at_degc,
            output=truth(at_degc)[:, :1] + 1e-5 * rng.standard_normal((61, 3)),
            sigma=np.full((61, 3), 1e-5),
            direction=np.ones(61),
            specific_force_m_s2=np.zeros(3),
        )
        found = points(np.array([-10.0, 20.0, 50.0]), rng, 40 * DAY)
        orders.append(
            fit_temperature(TemperatureData(reference_degc=REFERENCE_DEGC, points=found, ramps=[ramp])).temperature.scale.order
        )
    assert orders == [1] * 20


def is_new_day_inside(
    found: SessionPoints, model: TriadTemperature, day: FloatArray, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return whether bias and scale of each axis on a new day are inside their stated 95 %, shape (3, 2)."""
    assert model.new_day is not None
    new_degc = rng.uniform(-10.0, 50.0)
    there = truth(np.array([new_degc]))[0] + day * rng.standard_normal((3, 2))
    factor, base = model.change_at(new_degc)
    off = np.column_stack([found.bias[found.reference] + base, found.scale[found.reference] + factor - 1]) - there
    sigma = np.column_stack(model.sigma_there(new_degc, np.full(3, SIGMA[0]), np.full(3, SIGMA[1])))
    freedom = model.new_day.bias_freedom, model.new_day.scale_freedom
    return np.asarray(np.abs(off) <= [student_factor(each) for each in freedom] * sigma)


@pytest.mark.statistical
@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_the_change_from_day_to_day_is_none_of_the_errors_within_sessions(rho: float) -> None:
    """Bias and scale of a session may be correlated as they like: how much days differ is found on the average."""
    rng, at_degc, day = np.random.default_rng(6), np.linspace(-10.0, 50.0, 5), np.array([1.0, 2.0]) * SIGMA
    models = [model_of(points(at_degc, rng, day, rho)).new_day for _ in range(100)]
    squares = np.mean([[model.bias[0] ** 2, model.scale[0] ** 2] for model in models if model is not None], axis=0)
    # A variance of zero at least is above its expectation where it is small.
    np.testing.assert_allclose(squares / day**2, 1.0, atol=0.25)


def test_variances_of_sessions_that_count_alike_are_those_of_the_squares() -> None:
    """Straight lines through sessions of one covariance: the mean square less what the sessions' own errors make of it."""
    rng, at_degc = np.random.default_rng(8), np.linspace(-10.0, 50.0, 6)
    found = points(at_degc, rng, 3 * DAY)
    model = model_of(found).new_day
    assert model is not None
    V = np.column_stack([np.ones(6), at_degc])
    for values, own, day in ((found.bias, SIGMA[0], model.bias), (found.scale / (1 + found.scale), SIGMA[1], model.scale)):
        residual = values - V @ np.linalg.lstsq(V, values, rcond=None)[0]
        np.testing.assert_allclose(day**2, np.sum(residual**2) / (3 * 4) - own**2, rtol=1e-5)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_errors_of_the_reference_are_those_of_its_row(rho: float) -> None:
    """u and the coefficients are linear in what sessions found: drawn anew with the scatter found, they vary as is stated."""
    rng, at_degc = np.random.default_rng(7), np.linspace(REFERENCE_DEGC, 60.0, 5)
    found, root = points(at_degc, rng, 2 * DAY, rho), root_of(rho)
    new_day = model_of(found).new_day
    assert new_day is not None
    of_day = np.diag([new_day.bias[0] ** 2, new_day.scale[0] ** 2])
    drawn = rng.standard_normal((20000, 5, 2)) @ np.linalg.cholesky(root @ root.T + of_day).T
    d = at_degc - REFERENCE_DEGC
    x = d - d.mean()
    u, slope = drawn[:, found.reference], np.einsum("m,nmq->nq", x / (x @ x), drawn)
    for quantity, stated in enumerate((new_day.bias_covariance, new_day.scale_covariance)):
        pair = np.cov(u[:, quantity], slope[:, quantity])
        sizes = np.sqrt(np.diag(pair))
        np.testing.assert_allclose(stated[0] / np.outer(sizes, sizes), pair / np.outer(sizes, sizes), atol=0.03)


def test_a_quiet_ramp_does_not_hide_how_days_differ() -> None:
    rng, at_degc = np.random.default_rng(1), np.linspace(-10.0, 50.0, 61)
    ramp = RampBlocks(
        temperature_degc=at_degc,
        output=(9.0 + truth(at_degc)[:, :1] + 9.0 * truth(at_degc)[:, 1:]) + 1e-5 * rng.standard_normal((61, 3)),
        sigma=np.full((61, 3), 1e-5),
        direction=np.ones(61),
        specific_force_m_s2=np.full(3, 9.0),
    )
    found = points(np.array([-10.0, 20.0, 50.0]), rng, 20 * DAY)
    model = fit_orders(TemperatureData(reference_degc=REFERENCE_DEGC, points=found, ramps=[ramp]), 1, 1).temperature
    assert model.new_day is not None
    assert np.all(model.new_day.bias > 5 * DAY[0])
    alone = fit_orders(TemperatureData(reference_degc=REFERENCE_DEGC, ramps=[ramp]), 1, 0).temperature
    assert alone.new_day is None
