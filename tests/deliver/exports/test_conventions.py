from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.models import predict
from imufield.calibrate.model.result import AccelerometerParameters
from imufield.deliver.exports.conventions import Correction, linearised, rotation_times_triangle, rotation_to

pytestmark = pytest.mark.numerical

RNG = np.random.default_rng(3)
CORRECTION = Correction(np.eye(3) + RNG.normal(scale=0.01, size=(3, 3)), RNG.normal(size=3))
RAW = RNG.uniform(-20, 20, (30, 3))


def test_the_four_conventions_say_the_same() -> None:
    u = np.array([CORRECTION.matrix @ (raw - CORRECTION.offset) for raw in RAW])
    K, R = CORRECTION.split_rows()
    T, Kt = CORRECTION.split_columns()
    np.testing.assert_allclose(CORRECTION.apply(RAW), u, atol=1e-13)
    np.testing.assert_allclose(RAW @ CORRECTION.matrix.T - CORRECTION.output_offset, u, atol=1e-13)
    np.testing.assert_allclose(u @ CORRECTION.error_matrix.T + CORRECTION.offset, RAW, atol=1e-13)
    np.testing.assert_allclose(u @ (K @ R).T + CORRECTION.offset, RAW, atol=1e-13)
    np.testing.assert_allclose((RAW - CORRECTION.offset) @ (T @ Kt).T, u, atol=1e-13)


def test_scaled_raw_values() -> None:
    zero = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(CORRECTION.of_scaled(4.0, zero).apply((RAW - zero) / 4), CORRECTION.apply(RAW), atol=1e-12)


@pytest.mark.parametrize("triangle", ["lower", "upper"])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, -1), (-1, 1, 1)])
def test_rotation_times_triangle(triangle: str, signs: tuple[int, int, int]) -> None:
    matrix = CORRECTION.matrix * np.array(signs)
    Q, L = rotation_times_triangle(matrix, triangle)  # type: ignore[arg-type]
    np.testing.assert_allclose(Q @ L, matrix, atol=1e-14)
    np.testing.assert_allclose(Q @ Q.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(Q) == pytest.approx(1)
    assert np.linalg.norm(Q - np.eye(3)) < 0.1
    np.testing.assert_allclose(np.triu(L, 1) if triangle == "lower" else np.tril(L, -1), 0, atol=1e-15)


def test_rotation_times_triangle_far_from_the_identity() -> None:
    swapped = CORRECTION.matrix[[1, 0, 2]] * np.array([1, -1, 1])[:, None]
    Q, L = rotation_times_triangle(swapped, "lower")
    np.testing.assert_allclose(Q @ L, swapped, atol=1e-14)
    assert np.linalg.det(Q) == pytest.approx(1)


@pytest.mark.parametrize("axes", ["sensing", "body"])
def test_linearised_is_the_least_squares_line_over_all_directions(axes: str) -> None:
    """Against a regression on 200000 random directions, and the rest against the closed figure 0.298 K2 / K g^2."""
    p = AccelerometerParameters(
        scale=np.array([2.0, -1.0, 1.5]),
        bias_m_s2=RNG.normal(size=3),
        misalignment_rad=np.zeros((3, 3)),
        quadratic=np.array([1e-3, 2e-3, -3e-3]),
    )
    p = replace(p, quadratic_axes=axes, misalignment_rad=np.array([[0, 0.01, 0], [0, 0, 0.02], [0.03, 0, 0]]))  # type: ignore[arg-type]
    up = np.random.default_rng(4).normal(size=(200000, 3))
    force = 9.8 * up / np.linalg.norm(up, axis=1, keepdims=True)
    linear = linearised(p, 9.8)
    assert not linear.quadratic.any()
    difference = predict(p, force) - predict(linear, force)
    np.testing.assert_allclose(difference.mean(axis=0) / np.abs(p.quadratic * 9.8**2), 0, atol=3e-3)
    rms = np.sqrt(np.mean(difference**2, axis=0))
    np.testing.assert_allclose(rms, np.abs(p.quadratic) * 9.8**2 * np.sqrt(1 / 5 - 1 / 9), rtol=0.01)


@pytest.mark.parametrize("frame", ["file", "lower", "upper", "symmetric", "sensor"])
def test_frames_are_rotations(frame: str) -> None:
    p = AccelerometerParameters(
        scale=np.ones(3), bias_m_s2=np.zeros(3), misalignment_rad=np.array([[0, 0.01, 0], [0, 0, 0.02], [0.03, 0, 0]])
    )
    R = rotation_to(p, frame)  # type: ignore[arg-type]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)
