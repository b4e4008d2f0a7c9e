"""The closed-form start: exact without noise, near with it, typed errors where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_truth import GRAVITY, faces, outputs, paper24, random_parameters, tilted

from imufield.calibrate.accelerometer.ellipsoid_start import closed_form_start, find_signs
from imufield.calibrate.model.gauge import change_gauge
from imufield.calibrate.model.models import to_vector
from imufield.errors import CalibrationError, Reason
from tests.refused import refused

pytestmark = pytest.mark.numerical

ONES = np.ones(3)
NO_DIRECTION = np.full((24, 3), np.nan)


@pytest.mark.parametrize("seed", range(5))
def test_exact_data_give_the_exact_ellipsoid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_parameters(rng)
    raw = outputs(truth, GRAVITY * tilted(paper24(), rng, 0.1)) + 32768
    start = closed_form_start(raw, GRAVITY, ONES)
    shifted = to_vector(truth)
    shifted[3:6] += 32768 / truth.scale
    assert start == pytest.approx(change_gauge(shifted, "lower").vector, rel=1e-8, abs=1e-9)


def test_signs_are_kept() -> None:
    rng = np.random.default_rng(3)
    truth = random_parameters(rng)
    raw = outputs(truth, GRAVITY * tilted(paper24(), rng, 0.1)) * (1, 1, -1)
    start = closed_form_start(raw, GRAVITY, np.array([1.0, 1, -1]))
    expected = change_gauge(to_vector(truth), "lower").vector
    expected[2] *= -1
    assert start == pytest.approx(expected, rel=1e-8, abs=1e-9)


def test_six_faces_give_scale_and_bias() -> None:
    raw = np.array([[500, 10, 20], [5, 510, 20], [5, 10, 520], [-490, 10, 20], [5, -490, 20], [5, 10, -480]], dtype=float)
    start = closed_form_start(raw, 10.0, ONES)
    assert start[:3] == pytest.approx([49.5, 50.0, 50.0], rel=1e-3)
    assert start[3:6] == pytest.approx([5 / 49.5, 10 / 50, 20 / 50], rel=1e-2)


def test_noise_moves_it_by_little_more_than_the_noise() -> None:
    rng = np.random.default_rng(1)
    truth = random_parameters(rng)
    raw = outputs(truth, GRAVITY * tilted(paper24(), rng, 0.05)) + 400 * rng.normal(0, 0.01, (24, 3))
    start = closed_form_start(raw, GRAVITY, ONES)
    expected = change_gauge(to_vector(truth), "lower").vector
    assert start[:3] == pytest.approx(expected[:3], rel=3e-3)
    assert start[3:12] == pytest.approx(expected[3:12], abs=0.02)


def test_no_ellipsoid_is_a_typed_error() -> None:
    rng = np.random.default_rng(0)
    hyperboloid = rng.normal(0, 1, (24, 2))
    raw = np.column_stack([hyperboloid, np.sqrt(1 + hyperboloid[:, 0] ** 2 + hyperboloid[:, 1] ** 2)])
    with refused(CalibrationError, Reason.UNOBSERVABLE, key="ellipsoid_start.no_ellipsoid") as caught:
        closed_form_start(raw, GRAVITY, ONES)
    assert caught.value.values["positions"] == 24


def test_signs_from_planned_directions_preset_or_nowhere() -> None:
    raw = 400 * paper24() * (-1, -1, 1) + 100
    assert find_signs(raw, NO_DIRECTION, None).source == "assumed"
    preset = find_signs(raw, NO_DIRECTION, np.array([-400.0, -400, 400]))
    assert (preset.source, preset.sign.tolist()) == ("preset", [-1, -1, 1])
    planned = find_signs(raw, paper24(), None)
    assert (planned.source, planned.sign.tolist()) == ("directions", [-1, -1, 1])


def test_an_instrument_that_reports_gravity_is_taken_as_it_is() -> None:
    assert find_signs(-400 * paper24(), paper24(), None).sign.tolist() == [-1, -1, -1]


def test_swapped_axes_are_refused() -> None:
    with refused(CalibrationError, Reason.HANDEDNESS, key="ellipsoid_start.swapped") as caught:
        find_signs(400 * paper24()[:, (1, 0, 2)], paper24(), None)
    assert caught.value.values["axis"] == "x"
    assert caught.value.values["follows"] == "y"
    assert caught.value.reason is Reason.HANDEDNESS


def test_a_left_handed_triad_is_refused() -> None:
    with refused(CalibrationError, Reason.HANDEDNESS, key="ellipsoid_start.left_handed") as caught:
        find_signs(400 * paper24() * (1, -1, 1), paper24(), None)
    assert caught.value.values["axis"] == "y"
    assert caught.value.reason is Reason.HANDEDNESS


def test_a_preset_of_the_wrong_sign_is_refused() -> None:
    with refused(CalibrationError, Reason.HANDEDNESS, key="ellipsoid_start.opposite_preset") as caught:
        find_signs(400 * paper24(), paper24(), np.array([-400.0, -400, 400]))
    assert caught.value.values["axis"] == "x"


def test_few_planned_directions_decide_nothing() -> None:
    planned = np.full((6, 3), np.nan)
    planned[0] = (1, 0, 0)
    assert find_signs(400 * faces(), planned, None).source == "assumed"
