"""The table of grades: one source for simulator, uncertainty and history."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from imufield.calibrate.model.grades import DEFAULT_GRADE, GRADES, Grade, find_grade, grade_by_noise
from imufield.deliver.parameters.schema import parameter_schema
from imufield.earth import MILLI_G_M_S2
from imufield.errors import Reason, UsageError
from tests.refused import refused


def test_each_grade_is_worse_than_the_one_before() -> None:
    for better, worse in itertools.pairwise(GRADES.values()):
        assert better.quadratic < worse.quadratic
        assert better.scatter_m_s2 < worse.scatter_m_s2
        for triad in ("accelerometer", "gyroscope"):
            good, bad = getattr(better, triad), getattr(worse, triad)
            assert good.misalignment_rad < bad.misalignment_rad
            assert good.turn_on < bad.turn_on
        assert better.gyroscope.noise_density < worse.gyroscope.noise_density
        assert better.gyroscope.bias_instability < worse.gyroscope.bias_instability


def test_turning_on_adds_what_data_sheets_say() -> None:
    assert [grade.accelerometer.turn_on / MILLI_G_M_S2 for grade in GRADES.values()] == pytest.approx([0.16, 0.75, 3.0, 10.0])
    deg_h = [math.degrees(grade.gyroscope.turn_on) * 3600 for grade in GRADES.values()]
    assert deg_h == pytest.approx([0.0035, 10.0, 720.0, 3600.0])


@pytest.mark.parametrize("grade", GRADES.values(), ids=GRADES)
def test_the_noise_of_a_gyroscope_tells_its_grade(grade: Grade) -> None:
    for factor in (0.9, 1.0, 1.1):
        assert grade_by_noise("gyroscope", factor * grade.gyroscope.noise_density) is grade


def test_without_noise_the_worst_is_taken() -> None:
    assert grade_by_noise("gyroscope", math.inf) is GRADES[DEFAULT_GRADE]
    assert grade_by_noise("gyroscope", 0.0) is GRADES["navigation"]
    # 0.3 deg/sqrt(h), half-way between two classes.
    assert {grade_by_noise("gyroscope", np.radians(noise) / 60).name for noise in (0.29, 0.31)} == {"tactical", "industrial"}


def test_the_parameter_file_knows_the_grades() -> None:
    listed = parameter_schema()["properties"]["instrument"]["properties"]["grade"]["enum"]
    assert listed == ["", *GRADES]


def test_unknown_grade_names_the_known_ones() -> None:
    with refused(UsageError, Reason.USAGE, "navigation, tactical", key="grades.no_grade") as caught:
        find_grade("stellar")
    assert caught.value.values["grade"] == "stellar"
