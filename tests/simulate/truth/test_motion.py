"""Kinematics, held against matrices, hand-made cases and integration."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imufield.calibrate.model.rotation import conjugate, exponential, logarithm, multiply, rotate
from imufield.earth import EARTH_RATE_RAD_S
from imufield.samples import FloatArray
from imufield.simulate.truth.motion import Site, sample_motion, shortest_turn, up_direction

RNG = np.random.default_rng(7)


class Spinning:
    """Constant rate about the body z axis, pivot at rest, sensor off the pivot on x."""

    def __init__(self, rate_rad_s: float, radius_m: float) -> None:
        self.rate_rad_s = rate_rad_s
        self.lever_arm_m = np.array([radius_m, 0.0, 0.0])

    def attitude(self, time_s: FloatArray) -> FloatArray:
        return exponential(np.outer(time_s, [0.0, 0.0, self.rate_rad_s]))

    def acceleration(self, time_s: FloatArray) -> FloatArray:
        return np.zeros((len(time_s), 3))

    def resting_attitude(self, start_s: float, end_s: float) -> FloatArray | None:
        return None


class Resting(Spinning):
    def resting_attitude(self, start_s: float, end_s: float) -> FloatArray | None:
        return np.array([1.0, 0.0, 0.0, 0.0])


def test_quaternions_do_what_rotation_matrices_do() -> None:
    rotation = RNG.standard_normal((50, 3))
    vector = RNG.standard_normal((50, 3))
    angle = np.linalg.norm(rotation, axis=1)
    for q, phi, a, v in zip(exponential(rotation), rotation, angle, vector, strict=True):
        axis = phi / a
        # Rodrigues' formula
        expected = v * math.cos(a) + np.cross(axis, v) * math.sin(a) + axis * (axis @ v) * (1 - math.cos(a))
        np.testing.assert_allclose(rotate(q, v), expected, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-12, 1e-4, 1.0, 3.14])
def test_logarithm_undoes_exponential(size: float) -> None:
    rotation = size * np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(logarithm(exponential(rotation)), rotation, rtol=1e-12, atol=0)


def test_logarithm_takes_the_shorter_way() -> None:
    np.testing.assert_allclose(logarithm(exponential(np.array([0.0, 0.0, 4.0]))), [0.0, 0.0, 4.0 - 2 * math.pi])


def test_product_is_one_turn_after_the_other() -> None:
    left, right = exponential(RNG.standard_normal((2, 3)))
    vector = RNG.standard_normal(3)
    np.testing.assert_allclose(rotate(multiply(left, right), vector), rotate(left, rotate(right, vector)), atol=1e-14)
    np.testing.assert_allclose(multiply(left, conjugate(left)), [1, 0, 0, 0], atol=1e-15)


@pytest.mark.parametrize("target", [[1.0, 2.0, 3.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1e-12, -1.0]])
def test_shortest_turn_arrives(target: list[float]) -> None:
    start, end = np.array([0.0, 0.0, 1.0]), np.array(target) / np.linalg.norm(target)
    turn = shortest_turn(start, end)
    np.testing.assert_allclose(rotate(exponential(turn), start), end, atol=1e-9)
    assert np.linalg.norm(turn) == pytest.approx(math.acos(np.clip(start @ end, -1, 1)), abs=1e-8)


def test_spinning_on_a_turntable() -> None:
    """Rate, gravity and centripetal acceleration of a case that can be written down."""
    rate, radius = 2.0, 0.1
    site = Site(latitude_deg=90.0, gravity_m_s2=9.83)
    motion = sample_motion(Spinning(rate, radius), 0, 400, 1 / 500, site=site)
    # At the pole the Earth turns about "up"; z of the body points down.
    np.testing.assert_allclose(motion.angular_rate, np.tile([0, 0, rate - EARTH_RATE_RAD_S], (400, 1)), atol=1e-12)
    np.testing.assert_allclose(motion.specific_force, np.tile([-(rate**2) * radius, 0, -9.83], (400, 1)), atol=1e-7)


def test_resting_unit_feels_gravity_up_and_the_earth() -> None:
    site = Site(latitude_deg=30.0, gravity_m_s2=9.79)
    motion = sample_motion(Resting(0.0, 0.1), 5, 10, 0.01, site=site)
    general = sample_motion(Spinning(0.0, 0.1), 5, 10, 0.01, site=site)
    np.testing.assert_allclose(motion.specific_force, np.tile([0, 0, -9.79], (10, 1)))
    np.testing.assert_allclose(motion.angular_rate[0], EARTH_RATE_RAD_S * np.array([math.sqrt(0.75), 0, -0.5]), rtol=1e-12)
    np.testing.assert_allclose(general.specific_force, motion.specific_force, atol=1e-9)
    np.testing.assert_allclose(general.angular_rate, motion.angular_rate, atol=1e-13)
    np.testing.assert_allclose(motion.time_s, np.arange(5, 15) * 0.01)


def test_up_is_where_specific_force_points() -> None:
    quaternion = exponential(RNG.standard_normal(3))
    force = rotate(conjugate(quaternion), -Site().gravity_n)
    np.testing.assert_allclose(up_direction(quaternion), force / np.linalg.norm(force), atol=1e-15)
