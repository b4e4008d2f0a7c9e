"""Draws of parameters against the covariance they come from and the models they go through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from at_rest import perfect

from imufield.calibrate.model.models import from_vector, predict, recover, to_vector
from imufield.calibrate.model.result import ACCELEROMETER_NAMES
from imufield.deliver.navigation.uncertain import draw_parameters

pytestmark = pytest.mark.numerical

FORCE, RATE = np.array([1.0, -2.0, 9.5]), np.array([1e-5, 2e-5, -3e-5])


def test_draws_have_the_covariance_they_come_from() -> None:
    root = np.random.default_rng(1).normal(size=(15, 15)) * np.logspace(-9, -3, 15)[:, None]
    calibration = replace(perfect(), covariance_names=ACCELEROMETER_NAMES, covariance=root @ root.T)
    drawn = draw_parameters(calibration, 20_000, np.random.default_rng(2))
    offsets = drawn.vector - to_vector(calibration.accelerometer)
    found = np.cov(offsets.T)
    sigma = np.sqrt(np.diag(calibration.covariance))
    np.testing.assert_allclose(found / np.outer(sigma, sigma), calibration.covariance / np.outer(sigma, sigma), atol=0.03)


def test_error_of_the_force_is_that_of_the_model() -> None:
    calibration = replace(perfect(), covariance_names=ACCELEROMETER_NAMES, covariance=np.eye(15) * 1e-8)
    drawn = draw_parameters(calibration, 3, np.random.default_rng(3))
    raw = predict(calibration.accelerometer, FORCE)
    for vector, error in zip(drawn.vector, drawn.errors(FORCE, RATE), strict=True):
        np.testing.assert_allclose(error[:3], recover(from_vector(vector), raw[None])[0] - FORCE, atol=1e-15)


def test_every_gyroscope_name_reaches_its_parameter() -> None:
    names = ("gyroscope.bias.y", "gyroscope.misalignment_rad.zx", "gyroscope.g_sensitivity.xz", "gyroscope.scale.x")
    for name in names:
        calibration = replace(perfect(), covariance_names=(name,), covariance=np.array([[1e-12]]))
        errors = draw_parameters(calibration, 4, np.random.default_rng(4)).errors(FORCE, RATE)
        assert errors[:, :3] == pytest.approx(0, abs=1e-12)
        moved = np.abs(errors[:, 3:]).max(axis=0) > 1e-15
        assert moved.tolist() == [axis == {"y": "y", "zx": "z", "xz": "x", "x": "x"}[name.rpartition(".")[2]] for axis in "xyz"]


def test_the_middle_of_a_converter_changes_no_error() -> None:
    calibration = perfect(1e-3, 1e-6)
    gyroscope = calibration.gyroscope
    assert gyroscope is not None
    counted = replace(
        calibration, gyroscope=replace(gyroscope, parameters=replace(gyroscope.parameters, raw_zero=np.full(3, 8.0)))
    )
    plain, about = (draw_parameters(each, 5, np.random.default_rng(6)).errors(FORCE, RATE) for each in (calibration, counted))
    np.testing.assert_allclose(about, plain, atol=1e-14)


def test_triads_left_out_stay_as_they_are() -> None:
    drawn = draw_parameters(perfect(1e-3, 1e-6), 5, np.random.default_rng(5), triads=("gyroscope",))
    errors = drawn.errors(FORCE, RATE)
    assert errors[:, :3] == pytest.approx(0, abs=1e-12)
    assert np.abs(errors[:, 3:]).max() > 1e-7


@pytest.mark.filterwarnings("error")
def test_a_covariance_rounded_to_below_zero_is_drawn_without_it() -> None:
    """Of numbers that are one and the same but for the digits written: their difference does not vary."""
    covariance = np.array([[1.0, 1.0 + 1e-6], [1.0 + 1e-6, 1.0]]) * 1e-8
    calibration = replace(perfect(), covariance_names=ACCELEROMETER_NAMES[3:5], covariance=covariance)
    drawn = draw_parameters(calibration, 100, np.random.default_rng(7))
    offsets = drawn.vector - to_vector(calibration.accelerometer)
    assert np.ptp(offsets[:, 3] - offsets[:, 4]) < 1e-12
    assert np.std(offsets[:, 3]) == pytest.approx(1e-4, rel=0.3)
