"""The models against the equation written out by hand, and derivatives against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_truth import GRAVITY, outputs, paper24, random_parameters

from imufield.calibrate.model.models import (
    from_vector,
    norm_derivatives,
    predict,
    predict_gyroscope,
    recover,
    recover_vectors,
    to_vector,
)
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, AccelerometerParameters, GyroscopeParameters, QuadraticAxes
from imufield.errors import CalibrationError, Reason
from tests.refused import refused

pytestmark = pytest.mark.numerical

BOTH: tuple[QuadraticAxes, ...] = ("sensing", "body")


@pytest.fixture(params=BOTH)
def parameters(request: pytest.FixtureRequest) -> AccelerometerParameters:
    rng = np.random.default_rng(5)
    return replace(
        random_parameters(rng, quadratic=0.02), raw_zero=np.array([32768.0, 100.0, -5.0]), quadratic_axes=request.param
    )


def test_vector_has_the_order_of_the_names() -> None:
    misalignment = np.array([[0, 7, 8], [9, 0, 10], [11, 12, 0]], dtype=float)
    parameters = AccelerometerParameters(
        scale=np.array([1.0, 2, 3]),
        bias_m_s2=np.array([4.0, 5, 6]),
        misalignment_rad=misalignment,
        quadratic=np.array([13.0, 14, 15]),
    )
    assert to_vector(parameters).tolist() == list(range(1, 16))
    assert ACCELEROMETER_NAMES[6:12] == tuple(
        f"accelerometer.misalignment_rad.{p}" for p in ("xy", "xz", "yx", "yz", "zx", "zy")
    )
    back = from_vector(to_vector(parameters))
    assert np.array_equal(back.misalignment_rad, misalignment)


def test_predict_is_the_measurement_equation(parameters: AccelerometerParameters) -> None:
    a = GRAVITY * paper24()
    assert predict(parameters, a) == pytest.approx(outputs(parameters, a), rel=1e-14)


def test_one_axis_by_hand() -> None:
    # K = 100, b = 0.5, K2 = 2 at s = 3: 100 * 3.5 + 2 * 9
    one = AccelerometerParameters(
        scale=np.full(3, 100.0), bias_m_s2=np.full(3, 0.5), misalignment_rad=np.zeros((3, 3)), quadratic=np.full(3, 2.0)
    )
    assert predict(one, np.full((1, 3), 3.0)).tolist() == [[368.0] * 3]


def test_recover_undoes_predict(parameters: AccelerometerParameters) -> None:
    a = GRAVITY * paper24()
    assert recover(parameters, outputs(parameters, a)) == pytest.approx(a, abs=1e-12 * GRAVITY * 100)


def test_negative_scale_takes_the_root_near_the_linear_one() -> None:
    reversed_axis = AccelerometerParameters(
        scale=np.array([-400.0, 400, 400]),
        bias_m_s2=np.full(3, 0.2),
        misalignment_rad=np.zeros((3, 3)),
        quadratic=np.array([0.05, -0.05, 0.0]),
    )
    a = GRAVITY * paper24()
    assert recover(reversed_axis, outputs(reversed_axis, a)) == pytest.approx(a, abs=1e-12)


def test_recover_of_navigation_grade_on_body_axes_is_exact() -> None:
    rng = np.random.default_rng(2)
    fine = replace(random_parameters(rng, quadratic=1e-4), quadratic_axes="body")
    a = GRAVITY * paper24()
    assert np.abs(recover(fine, outputs(fine, a)) - a).max() < 1e-13


def test_no_real_root_is_a_typed_error() -> None:
    bent = AccelerometerParameters(
        scale=np.full(3, 100.0), bias_m_s2=np.zeros(3), misalignment_rad=np.zeros((3, 3)), quadratic=np.array([0.0, -10.0, 0.0])
    )
    with refused(CalibrationError, Reason.BOUNDS, "5000", key="models.turning_point") as caught:
        recover(bent, np.array([[0.0, 0.0, 0.0], [0.0, 5000.0, 0.0]]))
    assert caught.value.values["axis"] == "y"
    assert caught.value.values["row"] == 1
    assert caught.value.reason is Reason.BOUNDS


def test_no_contraction_is_a_typed_error() -> None:
    wild = AccelerometerParameters(
        scale=np.full(3, 100.0),
        bias_m_s2=np.zeros(3),
        misalignment_rad=np.zeros((3, 3)),
        quadratic=np.full(3, 30.0),
        quadratic_axes="body",
    )
    with refused(CalibrationError, Reason.NOT_CONVERGED, "2000.0", key="models.no_inverse") as caught:
        recover(wild, np.full((1, 3), 2000.0))
    assert caught.value.reason is Reason.NOT_CONVERGED


def test_nan_samples_stay_nan_and_raise_nothing(parameters: AccelerometerParameters) -> None:
    raw = outputs(parameters, GRAVITY * paper24())
    raw[3] = np.nan
    a = recover(parameters, raw)
    assert np.isnan(a[3]).all()
    assert np.isfinite(np.delete(a, 3, axis=0)).all()


def test_a_population_is_evaluated_at_once(parameters: AccelerometerParameters) -> None:
    rng = np.random.default_rng(0)
    vector = to_vector(parameters)
    population = vector + rng.normal(0, 1e-3, (7, 15)) * np.abs(vector)
    raw = outputs(parameters, GRAVITY * paper24()) - parameters.raw_zero
    together = recover_vectors(population, raw, parameters.quadratic_axes)
    for candidate, a in zip(population, together, strict=True):
        assert a == pytest.approx(recover(from_vector(candidate, None, parameters.quadratic_axes), raw), abs=1e-12)


def test_jacobian_against_central_differences(parameters: AccelerometerParameters) -> None:
    vector = to_vector(parameters)
    raw = outputs(parameters, GRAVITY * paper24()) - parameters.raw_zero
    exact = norm_derivatives(vector, raw, parameters.quadratic_axes)
    for k in range(15):
        step = np.zeros(15)
        step[k] = 1e-5 * max(abs(vector[k]), 1e-2)
        norms = [np.linalg.norm(recover_vectors(vector + s * step, raw, parameters.quadratic_axes), axis=1) for s in (1, -1)]
        differences = (norms[0] - norms[1]) / (2 * step[k])
        assert exact.jacobian[:, k] == pytest.approx(differences, abs=2e-6 * np.abs(exact.jacobian[:, k]).max())


def test_gradient_by_output_against_central_differences(parameters: AccelerometerParameters) -> None:
    vector = to_vector(parameters)
    raw = outputs(parameters, GRAVITY * paper24()) - parameters.raw_zero
    exact = norm_derivatives(vector, raw, parameters.quadratic_axes).raw_gradient
    for axis in range(3):
        step = 1e-2 * np.eye(3)[axis]
        norms = [np.linalg.norm(recover_vectors(vector, raw + s * step, parameters.quadratic_axes), axis=1) for s in (1, -1)]
        assert exact[:, axis] == pytest.approx((norms[0] - norms[1]) / 2e-2, abs=1e-9)


def test_gyroscope_by_hand() -> None:
    parameters = GyroscopeParameters(
        np.array([1000.0, 2000, 3000]),
        np.array([[0, 0.01, 0], [0, 0, 0.02], [0.03, 0, 0]]),
        np.array([1.0, 2, 3]),
        np.diag([0.5, 0.25, 0.125]),
    )
    rate, a = np.array([[1.0, 2, 3]]), np.array([[2.0, 4, 8]])
    by_hand = [[1000 * 1.02 + 1 + 1, 2000 * 2.06 + 2 + 1, 3000 * 3.03 + 3 + 1]]
    assert predict_gyroscope(parameters, rate, a) == pytest.approx(np.array(by_hand), rel=1e-15)
