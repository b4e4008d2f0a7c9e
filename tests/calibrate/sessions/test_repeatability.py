"""Repeatability against closed forms of balanced sessions, and against how often its intervals hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import chdtri, stdtrit

from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95
from imufield.calibrate.sessions.repeatability import Contrasts, contrasts, reml_variance, repeatability, sigmas, studentised

FLAT = math.inf


def balanced(rng: np.random.Generator, *, sessions: int, axes: int = 3, sigma: float = 1.0, own: float = 0.5) -> Contrasts:
    """Return sessions all of which know each number as well."""
    M = np.tile(np.eye(axes), (sessions, 1))
    y = M @ np.arange(axes) + np.hypot(sigma, own) * rng.standard_normal(sessions * axes)
    return contrasts(y, M, own**2 * np.eye(len(y)))


def test_equal_errors_have_the_estimate_and_the_interval_of_the_analysis_of_variance() -> None:
    rng = np.random.default_rng(1)
    found = balanced(rng, sessions=6, own=0.1)
    by_axis = found.y.reshape(6, 3)
    square = float(np.sum((by_axis - by_axis.mean(axis=0)) ** 2))
    own = repeatability(found)
    assert own.freedom == 15
    assert own.sigma == pytest.approx(math.sqrt(square / 15 - 0.01), rel=1e-6)
    assert own.low == pytest.approx(math.sqrt(square / chdtri(15, 0.025) - 0.01), rel=1e-6)
    assert own.high == pytest.approx(math.sqrt(square / chdtri(15, 0.975) - 0.01), rel=1e-6)


def test_three_axes_of_three_sessions_bound_it_by_the_factors_that_are_told() -> None:
    found = balanced(np.random.default_rng(2), sessions=3, own=1e-6)
    own = repeatability(found)
    assert own.low / own.sigma == pytest.approx(0.64, abs=0.01)
    assert own.high / own.sigma == pytest.approx(2.2, abs=0.01)


def test_sessions_that_scatter_no_more_than_their_errors_show_none() -> None:
    found = balanced(np.random.default_rng(3), sessions=5, sigma=0.0, own=1.0)
    quiet = contrasts(0.3 * (found.y - np.tile(np.arange(3), 5)), found.axes, found.covariance)
    own = repeatability(quiet)
    assert (own.sigma, own.low) == (0.0, 0.0)
    found_sigmas = sigmas(quiet, FLAT, np.zeros(3))
    assert np.all(found_sigmas.day > found_sigmas.mean)


def test_a_precise_contrast_beside_rough_ones_has_the_largest_likelihood() -> None:
    """Its likelihood bends more than twice as much as expected: scoring once ended anywhere between two values."""
    u, own = np.sqrt([0.20, 0.96, 0.33, 0.37, 0.23, 0.07, 4.2]), np.array([11.5, 0.256, 3.4, 8.4, 1.69, 1.38, 5.6])
    found = Contrasts(y=u, axes=np.zeros((7, 0)), covariance=np.diag(own), u=u, own_variance=own)
    variance = np.linspace(0, 2, 20001)[:, None] + own
    best = np.argmin(np.sum(np.log(variance) + u**2 / variance, axis=1)) * 1e-4
    assert reml_variance(found) == pytest.approx(best, abs=1e-4)


def test_a_new_day_is_student_where_the_sessions_have_no_errors() -> None:
    found = balanced(np.random.default_rng(4), sessions=8, own=1e-6)
    mean = found.y.reshape(8, 3).mean(axis=0)
    found_sigmas = sigmas(found, FLAT, mean)
    # With a prior that is flat in s the degrees of freedom are one less than with one that is flat in log s.
    spread = math.sqrt(float(np.sum(found.u**2)) / 20)
    factor = stdtrit(20, 0.975) / NORMAL_FACTOR_95
    assert found_sigmas.day == pytest.approx(factor * spread * math.sqrt(1 + 1 / 8), rel=1e-3)
    assert found_sigmas.mean == pytest.approx(factor * spread * math.sqrt(1 / 8), rel=1e-3)


def test_a_prior_bounds_what_two_sessions_leave_open() -> None:
    found = balanced(np.random.default_rng(5), sessions=2, own=0.1)
    estimate = found.y.reshape(2, 3).mean(axis=0)
    open_ended, bounded, wide = (sigmas(found, scale, estimate).day for scale in (FLAT, 0.3, 1e4))
    assert np.all(bounded < 0.8 * open_ended)
    assert wide == pytest.approx(open_ended, rel=0.01)


@pytest.mark.parametrize(("sessions", "own"), [(3, 0.5), (10, 1.0)])
def test_intervals_hold_as_often_as_they_say(sessions: int, own: float) -> None:
    rng = np.random.default_rng(6)
    inside, days = [], []
    for _ in range(200):
        found = balanced(rng, sessions=sessions, own=own)
        interval = repeatability(found)
        inside.append(interval.low <= 1.0 <= interval.high)
        estimate = found.y.reshape(sessions, 3).mean(axis=0)
        off = np.arange(3) + rng.standard_normal(3) - estimate
        days.append(np.abs(off) <= NORMAL_FACTOR_95 * sigmas(found, FLAT, estimate).day)
    # 95 % of 200 are 190 +- 3.1; the study counts more of them.
    assert 0.90 <= np.mean(inside) <= 0.99
    assert 0.92 <= np.mean(days) <= 0.985


def test_numbers_off_the_others_are_studentised_as_if_they_were_left_out() -> None:
    found = balanced(np.random.default_rng(7), sessions=7, axes=1, own=1e-9)
    off = studentised(found, float(np.var(found.y, ddof=1)))
    others = np.delete(found.y, 2)
    alone = (found.y[2] - others.mean()) / (np.std(others, ddof=1) * math.sqrt(1 + 1 / 6))
    assert off[2] == pytest.approx(alone, rel=1e-6)
