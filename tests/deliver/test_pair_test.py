"""Whether two calibrations differ: the limit by closed forms, and its share of false alarms by drawn pairs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtri, stdtrit

from imufield.calibrate.model.grades import GRADES
from imufield.deliver.pair_test import Change, Family, Shared, family_of, typical_turn_on
from imufield.deliver.parameters.gauge_free import GaugeFree, Number
from imufield.samples import FloatArray

ALL = Shared(gravity=True, setup=True)
pytestmark = pytest.mark.numerical


def side(values: FloatArray, covariance: FloatArray, freedom: float = math.inf, common: float = 0.0) -> GaugeFree:
    sigma = np.sqrt(np.diag(covariance) + common**2)
    numbers = tuple(
        Number(
            name=f"scale {k}",
            unit="",
            value=float(value),
            sigma=float(one),
            common=common,
            freedom=freedom,
            scatter_freedom=freedom,
        )
        for k, (value, one) in enumerate(zip(values, sigma, strict=True))
    )
    return GaugeFree(numbers, covariance, covariance)


def test_independent_numbers_share_the_chance() -> None:
    known = side(np.zeros(9), np.eye(9))
    # Sidak: each of nine has the ninth root of 95 %.
    expected = ndtri(0.5 + 0.95 ** (1 / 9) / 2)
    assert family_of(known, known, ALL).limit_sigma == pytest.approx(expected, rel=0.01)


def test_numbers_that_go_together_are_one() -> None:
    together = side(np.zeros(5), np.ones((5, 5)))
    assert family_of(together, together, ALL).limit_sigma == pytest.approx(ndtri(0.975), rel=0.015)


def test_a_sigma_from_few_residuals_is_students() -> None:
    few, exact = side(np.zeros(1), np.eye(1), freedom=6.0), side(np.zeros(1), np.eye(1) * 1e-12)
    assert family_of(few, exact, ALL).limit_sigma == pytest.approx(stdtrit(6, 0.975), rel=0.02)


def test_without_a_residual_to_spare_nothing_is_tested() -> None:
    family = family_of(side(np.zeros(2), np.eye(2), freedom=0.0), side(np.full(2, 50.0), np.eye(2)), ALL)
    assert family.changes == ()
    assert family.beyond == ()


def test_gravity_of_two_places_moves_all_scales_together() -> None:
    here, there = side(np.ones(3), np.eye(3) * 1e-10, common=1e-3), side(np.ones(3) + 2e-3, np.eye(3) * 1e-10, common=1e-3)
    assert len(family_of(here, there, ALL).beyond) == 3
    apart = family_of(here, there, Shared(gravity=False, setup=True))
    assert apart.beyond == ()
    assert [change.in_sigma for change in apart.changes] == pytest.approx([math.sqrt(2)] * 3, rel=1e-3)
    assert apart.limit_sigma == pytest.approx(ndtri(0.975), rel=0.015)


def test_two_sigmas_of_one_size_are_one_of_both_residuals() -> None:
    # (z_1 + z_2) / sqrt(w_1 + w_2) with six degrees of freedom each is Student's with twelve.
    few = side(np.zeros(1), np.eye(1), freedom=6.0)
    assert family_of(few, few, ALL).limit_sigma == pytest.approx(stdtrit(12, 0.975), rel=0.015)


def test_a_turn_on_is_no_move() -> None:
    tactical = GRADES["tactical"]
    assert typical_turn_on(tactical, "gyroscope bias z") == pytest.approx(10.0)
    small, large = Change("bias x", "mg", 2.0, 0.1), Change("bias x", "mg", 4.0, 0.1)
    family = Family((small, large), 3.0)
    # Two turn-ons of 0.75 mg differ by 1.06 mg, 1 sigma: three of them are 3.2 mg.
    assert [family.exceeds(one, typical_turn_on(tactical, one.name)) for one in (small, large)] == [False, True]
    assert not family.exceeds(Change("angle xy", "mrad", 1e6, 0.1), typical_turn_on(tactical, "angle xy"))
