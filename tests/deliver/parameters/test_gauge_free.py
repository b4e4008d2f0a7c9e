"""Gauge-free numbers: the same in every frame, with the sigma that draws of the parameters show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.gyroscope.report import GYROSCOPE_NAMES
from imufield.calibrate.model.gauge import change_gauge, turn_accelerometer, turn_gyroscope
from imufield.calibrate.model.models import from_vector, to_vector
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, Calibration, GyroscopeCalibration, GyroscopeParameters
from imufield.deliver.navigation.uncertain import draw_parameters
from imufield.deliver.parameters.gauge_free import against_accelerometer, numbers_of
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.errors import CalibrationError, Reason
from tests.refused import refused

E = np.array([[0, 1.2e-3, -8e-4], [2.1e-3, 0, 5e-4], [-1.7e-3, 9e-4, 0]])
G = np.array([[3e-6, -1e-6, 2e-6], [0.5e-6, 4e-6, -2e-6], [1e-6, 1.5e-6, -3e-6]])
SCALE = np.array([1.002, 0.998, 1.001])


@pytest.fixture
def whole(calibration: Calibration) -> Calibration:
    """Return a calibration whose gyroscope was estimated whole, with one joint covariance."""
    names = (*ACCELEROMETER_NAMES, *GYROSCOPE_NAMES)
    root = np.random.default_rng(8).normal(scale=2e-5, size=(len(names), len(names)))
    root[names.index("gyroscope.g_sensitivity.xx") :] *= 0.02
    known = np.full((3, 3), 1e-5)
    sigma = GyroscopeParameters(known[0], known, known[0], known)
    gyroscope = GyroscopeCalibration(GyroscopeParameters(SCALE, E, np.zeros(3), G), sigma, "simulated")
    return replace(calibration, gyroscope=gyroscope, covariance_names=names, covariance=root @ root.T)


def with_gyroscope(calibration: Calibration, parameters: GyroscopeParameters) -> Calibration:
    assert calibration.gyroscope is not None
    return replace(calibration, gyroscope=replace(calibration.gyroscope, parameters=parameters))


def turned(calibration: Calibration, gauge: str) -> Calibration:
    rotation = change_gauge(to_vector(calibration.accelerometer), gauge).rotation  # type: ignore[arg-type]
    other = with_gyroscope(calibration, turn_gyroscope(calibration.gyroscope.parameters, rotation))
    return replace(other, accelerometer=turn_accelerometer(calibration.accelerometer, rotation))


@pytest.mark.parametrize("gauge", ["upper", "symmetric"])
def test_another_frame_changes_nothing(whole: Calibration, gauge: str) -> None:
    other = turned(whole, gauge)
    assert np.abs(other.gyroscope.parameters.misalignment_rad - E).max() > 1e-4
    np.testing.assert_allclose(against_accelerometer(other)[0], against_accelerometer(whole)[0], atol=1e-15, rtol=1e-12)


def test_in_the_frame_of_the_accelerometer_they_are_the_parameters(whole: Calibration) -> None:
    values, _ = against_accelerometer(whole)
    np.testing.assert_allclose(values[:6], E[~np.eye(3, dtype=bool)], atol=1e-15)
    np.testing.assert_allclose(values[6:].reshape(3, 3), G / SCALE[:, None], rtol=1e-12)


def test_sigma_is_what_draws_of_the_parameters_show(whole: Calibration) -> None:
    drawn = draw_parameters(whole, 4000, np.random.default_rng(3))
    values = []
    for k in range(4000):
        parameters = GyroscopeParameters(**{name: drawn.gyroscope[name][k] for name in drawn.gyroscope})
        one = replace(with_gyroscope(whole, parameters), accelerometer=from_vector(drawn.vector[k]))
        values.append(against_accelerometer(replace(one, covariance_names=(), covariance=np.empty((0, 0))))[0])
    _, sigma = against_accelerometer(whole)
    # The sigma of a standard deviation of 4000 draws is 1.1 %.
    np.testing.assert_allclose(np.std(values, axis=0), sigma, rtol=0.05)


def test_names_units_and_what_was_not_estimated(whole: Calibration) -> None:
    found = {one.name: one for one in numbers_of(whole)}
    assert found["gyroscope misalignment yx"].value == pytest.approx(2.1)
    deg_per_h_g = np.degrees(3e-6 / 1.002) * 3600 * STANDARD_GRAVITY_M_S2
    assert found["g-sensitivity xx"].value == pytest.approx(deg_per_h_g)
    kept = tuple(name for name in whole.covariance_names if "g_sensitivity" not in name)
    n = len(kept)
    partly = replace(whole, covariance_names=kept, covariance=whole.covariance[:n, :n])
    names = [one.name for one in numbers_of(partly)]
    assert "gyroscope misalignment zy" in names
    assert not any(name.startswith("g-sensitivity") for name in names)


def test_left_handed_axes_are_refused(whole: Calibration) -> None:
    flat = np.array([[0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]])
    bent = replace(whole.accelerometer, misalignment_rad=flat + np.triu(np.full((3, 3), 2.0), 1))
    with refused(CalibrationError, Reason.HANDEDNESS) as caught:
        numbers_of(replace(whole, accelerometer=bent))
    assert caught.value.values["volume"] < 0
