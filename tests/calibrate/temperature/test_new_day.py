"""What is stated for a day that was not measured holds on such days: points of sessions drawn from known polynomials."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.model.uncertainty import student_factor
from imufield.calibrate.temperature.fit import Evidence, RampBlocks, SessionPoints, fit_orders
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
    """Return sessions off by their own errors and by their days, along the same two directions."""
    m, root = len(at_degc), root_of(rho)
    values = truth(at_degc)[:, None] + (np.hypot(1.0, day / SIGMA) * rng.standard_normal((m, 3, 2))) @ root.T
    reference = int(np.argmin(np.abs(at_degc - REFERENCE_DEGC)))
    return SessionPoints(
        temperature_degc=at_degc,
        bias=values[:, :, 0],
        scale=values[:, :, 1],
        covariance=np.broadcast_to(root @ root.T, (m, 3, 2, 2)),
        reference=reference,
    )


@pytest.mark.parametrize("sessions", [3, 5])
@pytest.mark.parametrize("days", [0.0, 1.0])
@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_a_new_day_is_inside_as_often_as_stated(sessions: int, days: float, rho: float) -> None:
    rng, inside = np.random.default_rng(4), []
    at_degc = np.linspace(-10.0, 50.0, sessions)
    for _ in range(300):
        found = points(at_degc, rng, days * DAY, rho)
        model = fit_orders(Evidence(reference_degc=REFERENCE_DEGC, points=found), 1, 1).temperature
        assert model.new_day is not None
        assert model.new_day.bias_freedom == pytest.approx(3 * (sessions - 2))
        new_degc = rng.uniform(-10.0, 50.0)
        there = truth(np.array([new_degc]))[0] + (days * DAY / SIGMA * rng.standard_normal((3, 2))) @ root_of(rho).T
        factor, base = model.change_at(new_degc)
        off = np.column_stack([found.bias[found.reference] + base, found.scale[found.reference] + factor - 1]) - there
        sigma = np.column_stack(model.sigma_there(new_degc, np.full(3, SIGMA[0]), np.full(3, SIGMA[1])))
        inside.append(np.abs(off) <= student_factor(3 * (sessions - 2)) * sigma)
    shares = np.mean(inside, axis=(0, 1))
    # Without a change from day to day the factor that is at least 1 makes it safe.
    assert np.all(shares >= 0.93)
    # A correlated scale has the scatter of two kinds of rows, and so more degrees of freedom than are stated.
    assert days == 0.0 or np.all(shares <= (0.99 if rho else 0.97))


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_errors_of_the_reference_are_those_of_its_row(rho: float) -> None:
    """u and the coefficients are linear in what sessions found: drawn anew with the scatter found, they vary as is stated."""
    rng, at_degc = np.random.default_rng(7), np.linspace(REFERENCE_DEGC, 60.0, 5)
    found, root = points(at_degc, rng, 2 * DAY, rho), root_of(rho)
    new_day = fit_orders(Evidence(reference_degc=REFERENCE_DEGC, points=found), 1, 1).temperature.new_day
    assert new_day is not None
    # From day to day the variance is root (factor^2 - 1) root^T.
    factors = np.sqrt(1 + np.linalg.solve(root**2, [new_day.bias[0] ** 2, new_day.scale[0] ** 2]))
    drawn = rng.standard_normal((20000, 5, 2)) * factors @ root.T
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
    model = fit_orders(Evidence(reference_degc=REFERENCE_DEGC, points=found, ramps=[ramp]), 1, 1).temperature
    assert model.new_day is not None
    assert np.all(model.new_day.bias > 5 * DAY[0])
    alone = fit_orders(Evidence(reference_degc=REFERENCE_DEGC, ramps=[ramp]), 1, 0).temperature
    assert alone.new_day is None
