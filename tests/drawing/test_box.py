"""The box that stands for the instrument."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.drawing.box import HALF_SIZE, ONLOOKER, turn_shortest, visible_faces
from imufield.guide.positions import cube_directions

DIRECTIONS = cube_directions()


@pytest.mark.parametrize("name", DIRECTIONS)
def test_the_box_is_turned_so_that_up_is_up_and_stays_a_rotation(name: str) -> None:
    attitude = np.eye(3)
    for up in (*DIRECTIONS.values(), DIRECTIONS[name]):
        attitude = turn_shortest(attitude, up)
    np.testing.assert_allclose(attitude @ DIRECTIONS[name], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(attitude @ attitude.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(attitude) > 0


def test_a_small_turn_moves_the_box_little() -> None:
    before = turn_shortest(np.eye(3), np.array([1.0, 0, 0]))
    after = turn_shortest(before, np.array([np.cos(0.01), np.sin(0.01), 0]))
    assert np.abs(after - before).max() < 0.011


@pytest.mark.parametrize("name", DIRECTIONS)
def test_sides_that_are_seen_bear_their_names_and_say_how_far_up_they_look(name: str) -> None:
    attitude = turn_shortest(np.eye(3), DIRECTIONS[name])
    faces = list(visible_faces(attitude))
    assert 2 <= len(faces) <= 3
    for face in faces:
        assert face.up == pytest.approx(float(attitude[2] @ DIRECTIONS[face.name]))
        # Every corner of the box belongs to three sides, so the middle of a side is its own.
        np.testing.assert_allclose(
            face.corners.mean(axis=0), ONLOOKER @ attitude @ (DIRECTIONS[face.name] * HALF_SIZE), atol=1e-12
        )
