"""Rotations against SciPy's, and running products against a plain loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imufield.calibrate.model.rotation import (
    cross,
    exponential,
    from_matrix,
    logarithm,
    matrix,
    misfits_rad,
    multiply,
    one_rotation_matrix,
    product,
    right_jacobian,
    running_turns,
    signed_permutations,
    skew,
    total_turn,
)

pytestmark = pytest.mark.numerical

RNG = np.random.default_rng(5)
VECTORS = np.concatenate([RNG.standard_normal((40, 3)), 1e-9 * RNG.standard_normal((3, 3)), np.zeros((1, 3))])


def test_matrices_agree_with_scipy() -> None:
    assert matrix(exponential(VECTORS)) == pytest.approx(Rotation.from_rotvec(VECTORS).as_matrix(), abs=1e-14)


def test_product_is_that_of_the_matrices() -> None:
    a, b = exponential(VECTORS[:20]), exponential(VECTORS[20:40])
    assert matrix(multiply(a, b)) == pytest.approx(matrix(a) @ matrix(b), abs=1e-14)


def test_product_of_matrices_is_that_of_numpy() -> None:
    left, right = np.random.default_rng(7).standard_normal((2, 5, 4, 3, 3))
    assert product(left, right) == pytest.approx(left @ right, rel=1e-12, abs=1e-12)
    assert product(left, right[0, 0]) == pytest.approx(left @ right[0, 0], rel=1e-12, abs=1e-12)


def test_logarithm_and_from_matrix_come_back() -> None:
    short = VECTORS / np.maximum(np.linalg.norm(VECTORS, axis=1) / 3.1, 1)[:, None]
    assert logarithm(exponential(short)) == pytest.approx(short, abs=1e-12)
    assert logarithm(from_matrix(matrix(exponential(short)))) == pytest.approx(short, abs=1e-7)


@pytest.mark.parametrize("axis", range(3))
def test_from_matrix_half_turns(axis: int) -> None:
    half = np.pi * np.eye(3)[axis]
    assert np.abs(from_matrix(matrix(exponential(half)))) == pytest.approx(np.abs(exponential(half)), abs=1e-15)


def test_cross_and_skew() -> None:
    a, b = VECTORS[:20], VECTORS[20:40]
    assert cross(a, b) == pytest.approx(np.cross(a, b))
    assert (skew(a) @ b[:, :, None])[:, :, 0] == pytest.approx(np.cross(a, b))


def test_right_jacobian_is_the_derivative() -> None:
    step = 1e-6 * RNG.standard_normal(VECTORS.shape)
    forward = multiply(exponential(-VECTORS), exponential(VECTORS + step))
    backward = multiply(exponential(-VECTORS), exponential(VECTORS - step))
    change = (logarithm(forward) - logarithm(backward)) / 2
    assert change == pytest.approx((right_jacobian(VECTORS) @ step[:, :, None])[:, :, 0], abs=1e-14)


@pytest.mark.parametrize("longest", [37, 6000])  # In passes, and in blocks.
def test_running_turns_of_chains_of_any_length(longest: int) -> None:
    lengths = [1, 2, 16, 5, 17, longest]
    turns = exponential(RNG.standard_normal((sum(lengths), 3)))
    first = (np.cumsum(lengths) - lengths).astype(np.int64)
    running = running_turns(turns, first)
    for start, length in zip(first, lengths, strict=True):
        turned = np.array([1.0, 0, 0, 0])
        for k in range(start, start + length):
            turned = multiply(turned, turns[k])
            assert running[k] == pytest.approx(turned, abs=1e-12)
        assert total_turn(turns[start : start + length]) == pytest.approx(turned, abs=1e-12)


def test_products_of_many_chains_at_once() -> None:
    turns = exponential(RNG.standard_normal((2, 3, 7, 3)))
    assert total_turn(turns)[1, 2] == pytest.approx(total_turn(turns[1, 2]), abs=1e-14)


def test_one_rotation_matrix_is_that_of_its_quaternion() -> None:
    for size in (0.0, 1e-9, 0.3, 3.0):
        vector = size * np.array([2.0, -1.0, 2.0]) / 3
        np.testing.assert_allclose(one_rotation_matrix(vector), matrix(exponential(vector)), atol=1e-15)


def test_there_are_48_arrangements_24_of_them_left_handed() -> None:
    found = signed_permutations()
    assert len({tuple(one.ravel()) for one in found}) == 48
    assert (np.linalg.det(found) < 0).sum() == 24
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.tile(np.eye(3), (48, 1, 1)))


def test_misfits_are_those_of_each_arrangement_and_scale() -> None:
    random = np.random.default_rng(8)
    turns, (before, after) = random.standard_normal((4, 6, 3)), random.standard_normal((2, 4, 3))
    before, after = (up / np.linalg.norm(up, axis=1)[:, None] for up in (before, after))
    permutations, scales = signed_permutations(), np.array([1.0, 2.0])
    found = misfits_rad(turns, before, after, permutations=permutations, scales=scales)
    for row, scale in enumerate(scales):
        for column, P in enumerate(permutations):
            carried = matrix(total_turn(exponential(turns @ P.T / scale))).transpose(0, 2, 1) @ before[:, :, None]
            angle = np.arccos(np.sum(carried[:, :, 0] * after, axis=1))
            assert found[row, :, column] == pytest.approx(angle)
