"""Grades and the drawing of instruments."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.simulate.truth.grades import GRADES, TACTICAL, Grade, draw_truth, perfect_instrument


@pytest.mark.parametrize("grade", GRADES.values(), ids=GRADES)
def test_drawn_parameters_spread_as_the_grade_says(grade: Grade) -> None:
    drawn = [draw_truth(grade, np.random.default_rng(seed)) for seed in range(400)]
    bias = np.array([unit.accelerometer.bias_m_s2 for unit in drawn])
    scale = np.array([unit.gyroscope.scale for unit in drawn])
    misalignment = np.array([unit.accelerometer.misalignment_rad for unit in drawn])
    assert bias.std() == pytest.approx(grade.accelerometer.bias, rel=0.08)
    assert scale.std() == pytest.approx(1e-6 * grade.gyroscope.scale_ppm, rel=0.08)
    assert not np.any(misalignment[:, range(3), range(3)])
    assert np.all(np.array([unit.triad_delay_s for unit in drawn]) <= grade.triad_delay_s)


def test_same_seed_same_instrument() -> None:
    one, two = (draw_truth(TACTICAL, np.random.default_rng(4)) for _ in range(2))
    assert np.array_equal(one.accelerometer.quadratic, two.accelerometer.quadratic)
    assert one.clock_error_ppm == two.clock_error_ppm


def test_perfect_instrument_has_no_errors() -> None:
    unit = perfect_instrument(TACTICAL)
    assert unit.accelerometer.scale.tolist() == [1.0] * 3
    assert not np.any(unit.gyroscope.g_sensitivity)
