"""Rigid-body kinematics: from a path of attitude and acceleration to what an ideal IMU feels.

Quaternions are ``[w, x, y, z]``, unit, and ``quaternion_nb`` takes body vectors to the local level frame (north, east,
down), which is fixed to the Earth and turns with it.

The angular rate of a sample is the *mean* rate over the interval of one sample centred on its time, the logarithm of the
turn made in it; so the product of ``exp(rate * interval)`` gives the attitude at the interval edges exactly, whatever
the path does in between. The specific force is taken at the sample's time: both triads of a sample belong to one instant.

With the sensor at ``r`` from the pivot (body frame), its acceleration is that of the pivot plus the second derivative of
``C_nb(t) r``, which holds the tangential and the centripetal part. That derivative is a five-point central difference on
a grid of half the sample interval: its relative error is (2 pi f interval / 2)^4 / 90, 4e-5 for 10 Hz tremor at 125 Hz.
The Coriolis term of a hand moving at 1 m/s (15 ug) is left out.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from imufield.calibrate.model.rotation import conjugate, exponential, logarithm, multiply, rotate
from imufield.dataclass import dataclass
from imufield.earth import EARTH_RATE_RAD_S, normal_gravity
from imufield.samples import FloatArray


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """What n samples of an ideal IMU feel.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        True time.
    quaternion_nb : ndarray, shape (n, 4)
    angular_rate : ndarray, shape (n, 3)
        Body frame relative to inertial space, rad/s, mean over the interval centred on ``time_s``.
    specific_force : ndarray, shape (n, 3)
        Body frame, m/s^2, +g along the axis that points up when still.
    """

    time_s: FloatArray
    quaternion_nb: FloatArray
    angular_rate: FloatArray
    specific_force: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, slots=True)
class Site:
    """Where the simulation takes place."""

    latitude_deg: float = 45.0
    gravity_m_s2: float = normal_gravity(45.0)

    @property
    def gravity_n(self) -> FloatArray:
        """Gravity in the local level frame, shape (3,), m/s^2."""
        return np.array([0.0, 0.0, self.gravity_m_s2])

    @property
    def earth_rate_n(self) -> FloatArray:
        """Rotation of the Earth in the local level frame, shape (3,), rad/s."""
        latitude = math.radians(self.latitude_deg)
        return np.array([math.cos(latitude), 0.0, -math.sin(latitude)]) * EARTH_RATE_RAD_S


class Path(Protocol):
    """Attitude and acceleration as functions of true time."""

    lever_arm_m: FloatArray
    """Sensor from the pivot of rotation, body frame, shape (3,)."""

    def attitude(self, time_s: FloatArray) -> FloatArray:
        """Return ``quaternion_nb``, shape (n, 4)."""
        ...

    def acceleration(self, time_s: FloatArray) -> FloatArray:
        """Return the acceleration of the pivot in the local level frame, shape (n, 3), m/s^2."""
        ...

    def resting_attitude(self, start_s: float, end_s: float) -> FloatArray | None:
        """Return the quaternion if nothing moves from ``start_s`` to ``end_s``, otherwise None."""


def up_direction(quaternion_nb: FloatArray) -> FloatArray:
    """Return the direction of "up" in the body frame, shape (..., 3)."""
    return rotate(conjugate(quaternion_nb), np.array([0.0, 0.0, -1.0]))


def shortest_turn(from_direction: ArrayLike, to_direction: ArrayLike) -> FloatArray:
    """Return the shortest rotation vector that takes one unit vector to another, shape (3,).

    For opposite vectors every axis at right angles is as short; one of them is taken.
    """
    a, b = np.asarray(from_direction, dtype=float), np.asarray(to_direction, dtype=float)
    axis: FloatArray = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine > 1e-9:
        axis *= math.atan2(sine, cosine) / sine
        return axis
    if cosine > 0:
        return np.zeros(3)
    sideways: FloatArray = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
    sideways *= math.pi / np.linalg.norm(sideways)
    return sideways


def sample_motion(path: Path, first: int, count: int, interval_s: float, *, site: Site) -> TrueMotion:
    """Return what an ideal IMU feels at samples ``first`` to ``first + count - 1``.

    The result depends on the sample numbers only, not on how a session is cut into calls.
    """
    half = interval_s / 2
    grid_s: FloatArray = np.arange(2 * first - 2, 2 * (first + count) + 1, dtype=np.float64) * half
    resting = path.resting_attitude(float(grid_s[0]), float(grid_s[-1]))
    time_s = grid_s[2:-2:2]
    if resting is not None:
        # Nothing moves: f = -C_bn g and the rate is the Earth's, the same in all samples.
        inverse, shape = conjugate(resting), (count, 3)
        rate = np.broadcast_to(rotate(inverse, site.earth_rate_n), shape)
        force = np.broadcast_to(rotate(inverse, -site.gravity_n), shape)
        return TrueMotion(time_s, np.broadcast_to(resting, (count, 4)), rate, force)
    quaternion = path.attitude(grid_s)
    # The body turns against inertial space: its own turn in the interval and that of the Earth.
    earth_turn = exponential(site.earth_rate_n * interval_s)
    turn = multiply(conjugate(quaternion[1:-2:2]), multiply(earth_turn, quaternion[3::2]))
    centre = quaternion[2:-2:2]
    # Sensor from the pivot, C_nb r; its second derivative has the tangential and the centripetal acceleration.
    arm = rotate(quaternion, path.lever_arm_m)
    # f'' = (-f[-2] + 16 f[-1] - 30 f[0] + 16 f[1] - f[2]) / (12 h^2), error h^4 f^(6) / 90, at every second inner point.
    far, near = arm[0:-4:2] + arm[4::2], arm[1:-3:2] + arm[3:-1:2]
    acceleration = path.acceleration(time_s) + (16 * near - far - 30 * arm[2:-2:2]) / (12 * half * half)
    # Specific force f = C_bn (a - g).
    force = rotate(conjugate(centre), acceleration - site.gravity_n)
    return TrueMotion(time_s, centre, logarithm(turn) / interval_s, force)
