"""Gauges: a turn changes no norm, constraints hold, covariances follow."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_truth import GRAVITY, outputs, paper24, random_parameters, tilted

from imufield.calibrate.model.gauge import (
    change_gauge,
    constraint_jacobian,
    intrinsic,
    turn,
    turn_accelerometer,
    turn_gyroscope,
)
from imufield.calibrate.model.models import alignment_matrix, from_vector, norm_derivatives, predict_gyroscope, to_vector
from imufield.calibrate.model.observability import generators
from imufield.calibrate.model.result import Gauge, GyroscopeParameters
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.samples import FloatArray
from tests.refused import refused

pytestmark = pytest.mark.numerical

ALL: tuple[Gauge, ...] = ("lower", "upper", "symmetric", "preset")


def rotation_about(vector: FloatArray) -> FloatArray:
    """Rodrigues' formula, the second route to a rotation matrix."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


@pytest.fixture
def vector() -> FloatArray:
    return to_vector(random_parameters(np.random.default_rng(11), quadratic=0.02))


@pytest.fixture
def preset() -> FloatArray:
    return to_vector(random_parameters(np.random.default_rng(12)))


def test_a_turned_frame_gives_the_same_outputs(vector: FloatArray) -> None:
    R = rotation_about(np.array([0.02, -0.03, 0.05]))
    parameters = from_vector(vector)
    a = GRAVITY * paper24()
    turned = turn_accelerometer(parameters, R)
    assert outputs(turned, a @ R.T) == pytest.approx(outputs(parameters, a), rel=1e-13)


def test_generators_are_the_derivative_of_a_turn(vector: FloatArray) -> None:
    step = 1e-6
    for axis in range(3):
        w = step * np.eye(3)[axis]
        difference = (turn(vector, rotation_about(w))[0] - turn(vector, rotation_about(-w))[0]) / (2 * step)
        assert generators(vector)[:, axis] == pytest.approx(difference, abs=1e-8 * np.abs(vector).max())


def test_norms_do_not_see_the_generators(vector: FloatArray) -> None:
    rng = np.random.default_rng(3)
    raw = outputs(from_vector(vector), GRAVITY * tilted(paper24(), rng, 0.1))
    flat = norm_derivatives(vector, raw).jacobian @ generators(vector)
    assert np.abs(flat).max() < 1e-12


@pytest.mark.parametrize("gauge", ALL)
def test_constraints_hold_and_gauge_free_numbers_stay(vector: FloatArray, preset: FloatArray, gauge: Gauge) -> None:
    change = change_gauge(vector, gauge, preset)
    T = alignment_matrix(change.vector)
    if gauge == "preset":
        unit, target = (A / np.linalg.norm(A, axis=1)[:, None] for A in (T, alignment_matrix(preset)))
        assert np.abs(np.cross(unit, target).sum(axis=0)).max() < 1e-15
    else:
        assert np.abs(constraint_jacobian(change.vector, gauge) @ change.vector).max() < 1e-15
    assert change.rotation @ change.rotation.T == pytest.approx(np.eye(3), abs=1e-14)
    assert intrinsic(change.vector)[0] == pytest.approx(intrinsic(vector)[0], rel=1e-12, abs=1e-15)


def test_preset_gauge_is_nearest_of_many_turns(vector: FloatArray, preset: FloatArray) -> None:
    def distance(candidate: FloatArray) -> float:
        unit, target = (A / np.linalg.norm(A, axis=1)[:, None] for A in map(alignment_matrix, (candidate, preset)))
        return float(np.sum((unit - target) ** 2))

    best = change_gauge(vector, "preset", preset).vector
    rng = np.random.default_rng(4)
    for _ in range(50):
        other = turn(best, rotation_about(rng.normal(0, 1e-3, 3)))[0]
        assert distance(other) > distance(best)


@pytest.mark.parametrize("gauge", ALL)
def test_there_and_back(vector: FloatArray, preset: FloatArray, gauge: Gauge) -> None:
    lower = change_gauge(vector, "lower").vector
    there = change_gauge(lower, gauge, preset).vector
    assert change_gauge(there, "lower").vector == pytest.approx(lower, rel=1e-11, abs=1e-14)


@pytest.mark.parametrize("gauge", ALL)
def test_jacobian_of_the_gauge_map_against_differences(vector: FloatArray, preset: FloatArray, gauge: Gauge) -> None:
    change = change_gauge(vector, gauge, preset)
    for k in range(15):
        step = np.zeros(15)
        step[k] = 1e-5 * max(abs(vector[k]), 0.1)
        ends = [change_gauge(vector + s * step, gauge, preset).vector for s in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * step[k])
        assert change.jacobian[:, k] == pytest.approx(difference, rel=1e-5, abs=1e-6 * np.abs(difference).max())


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_intrinsic_jacobian_against_differences(vector: FloatArray, axes: str) -> None:
    exact = intrinsic(vector, axes)[1]  # type: ignore[arg-type]
    for k in range(15):
        step = np.zeros(15)
        step[k] = 1e-5 * max(abs(vector[k]), 0.1)
        ends = [intrinsic(vector + s * step, axes)[0] for s in (1, -1)]  # type: ignore[arg-type]
        difference = (ends[0] - ends[1]) / (2 * step[k])
        assert exact[:, k] == pytest.approx(difference, rel=1e-5, abs=1e-6 * max(np.abs(difference).max(), 1e-3))


def test_intrinsic_angles_by_hand() -> None:
    # x sensing axis along (1, 0.01, 0), the others along the body axes: only x-y is not square, by -atan(0.01).
    vector = np.zeros(15)
    vector[:3] = 100
    vector[6] = 0.01
    values = intrinsic(vector)[0]
    assert values[0] == pytest.approx(100 * np.hypot(1, 0.01))
    assert values[6:9] == pytest.approx([-np.arctan(0.01), 0, 0])


def test_gyroscope_turns_with_the_accelerometer() -> None:
    rng = np.random.default_rng(8)
    misalignment = rng.normal(0, 0.01, (3, 3))
    np.fill_diagonal(misalignment, 0)
    gyroscope = GyroscopeParameters(np.full(3, 5000.0), misalignment, np.array([10.0, -5, 3]), rng.normal(0, 1, (3, 3)))
    R = rotation_about(np.array([0.03, 0.01, -0.02]))
    rate, a = rng.normal(0, 1, (5, 3)), rng.normal(0, 9, (5, 3))
    turned = turn_gyroscope(gyroscope, R)
    assert np.diag(turned.misalignment_rad) == pytest.approx(np.zeros(3), abs=1e-15)
    assert predict_gyroscope(turned, rate @ R.T, a @ R.T) == pytest.approx(predict_gyroscope(gyroscope, rate, a), rel=1e-12)


def test_left_handed_axes_are_refused() -> None:
    vector = np.zeros(15)
    vector[:3] = 1
    vector[6:12] = (5, 0, 5, 0, 0, 0)  # x and y sensing axes nearly exchanged
    with refused(CalibrationError, Reason.HANDEDNESS, key="gauge.left_handed") as caught:
        change_gauge(vector, "lower")
    assert caught.value.values["volume"] < 0
    assert caught.value.reason is Reason.HANDEDNESS


def test_preset_gauge_needs_a_preset(vector: FloatArray) -> None:
    with refused(UsageError, Reason.USAGE, "--preset", key="gauge.no_preset"):
        change_gauge(vector, "preset")
