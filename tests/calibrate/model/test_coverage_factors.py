"""Student's, the F and the chi squared distribution against SciPy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.special

from imufield.calibrate.model.coverage_factors import (
    chi_squared_quantile,
    chi_squared_tail,
    degrees_of_freedom,
    f_limit_95,
    f_quantile,
    f_tail,
    sigma_of_mixture,
    student_factor,
    student_quantile,
)

pytestmark = pytest.mark.numerical


@pytest.mark.parametrize("freedom", [0.3, 1, 2, 2.5, 7, 24.3, 100, 999.99, 1000, 1e4, 1e9])
def test_student(freedom: float) -> None:
    for p in (0.6, 0.9, 0.975, 0.999, 1 - 0.05 / 600):
        assert student_quantile(freedom, p) == pytest.approx(float(scipy.special.stdtrit(freedom, p)), rel=1e-10)
    if freedom < 1e4:
        assert degrees_of_freedom(student_quantile(freedom, 0.975)) == pytest.approx(freedom, rel=1e-9)


@pytest.mark.parametrize("numerator", [1, 2, 3, 12, 40])
@pytest.mark.parametrize("denominator", [0.5, 1, 3, 9, 60, 1000, 1e5])
def test_f(numerator: float, denominator: float) -> None:
    for value in (0.0, 1e-3, 0.5, 1.0, 1.5, 10.0, 1e6):
        expected = float(scipy.special.fdtrc(numerator, denominator, value))
        assert f_tail(numerator, denominator, value) == pytest.approx(expected, rel=1e-9, abs=1e-290)
    expected = float(scipy.special.fdtri(numerator, denominator, 0.95))
    assert f_quantile(numerator, denominator, 0.95) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("freedom", [1, 2, 3, 8, 27, 150, 1381, 5000])
def test_chi_squared(freedom: int) -> None:
    for value in (0.0, 1e-3, 0.5, 5.0, 40.0, 400.0):
        expected = float(scipy.special.chdtrc(freedom, value))
        assert chi_squared_tail(freedom, value) == pytest.approx(expected, rel=1e-9, abs=1e-290)
    for p in (0.025, 0.5, 0.975):
        assert chi_squared_quantile(freedom, p) == pytest.approx(float(scipy.special.chdtri(freedom, 1 - p)), rel=1e-12)


def test_the_limit_of_a_mixture_holds_95_percent() -> None:
    weight, rng = np.array([0.3, 0.6, 0.1]), np.random.default_rng(3)
    size = 10.0 ** rng.uniform(-8, 3, 20)
    shift, sigma = size * rng.uniform(-4, 4, (3, 20)), size * rng.uniform(0.1, 2, (3, 20))
    limit = 1.959964 * sigma_of_mixture(weight, shift, sigma)
    inside = weight @ (scipy.special.ndtr((limit - shift) / sigma) - scipy.special.ndtr((-limit - shift) / sigma))
    np.testing.assert_allclose(inside, 0.95, rtol=1e-6)


def test_the_limit_of_one_shift_and_of_known_numbers() -> None:
    shift, sigma = np.array([[0.0, 3.0, -40.0, 3.0, 0.0]]), np.array([[1.5, 0.0, 2.0, 1e-3, 0.0]])
    expected = [1.5, 3 / 1.959964, (40 + 1.644854 * 2) / 1.959964, (3 + 1.644854e-3) / 1.959964, 0.0]
    np.testing.assert_allclose(sigma_of_mixture(np.ones(1), shift, sigma)[:], expected, rtol=1e-6)
    # One in ten is zero exactly, as a term that a model leaves out: the others have to make up for it.
    found = sigma_of_mixture(np.array([0.1, 0.9]), np.zeros((2, 1)), np.array([[0.0], [1.0]]))[0]
    assert 2 * scipy.special.ndtr(-1.959964 * found) == pytest.approx(0.05 / 0.9)


def test_where_there_is_no_chance() -> None:
    assert math.isnan(f_tail(3, 0, 1.0))
    assert math.isnan(f_tail(3, 5, math.nan))
    assert f_tail(3, 5, np.inf) == 0.0


def test_quantiles_against_tables() -> None:
    assert student_factor(12) == pytest.approx(2.179, abs=5e-4)
    assert np.isnan(student_factor(0))
    assert f_limit_95(3, 12) == pytest.approx(3.49, abs=5e-3)
    assert f_limit_95(3, 0) == np.inf
