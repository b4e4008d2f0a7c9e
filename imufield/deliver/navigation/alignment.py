"""Alignment of an instrument at rest: coarse from two vectors, fine by a Kalman filter of three angles.

Coarse. At rest the specific force points up and the rate is the Earth's: ``down = -f / |f|``, and what the rate has at right
angles to it points north.

Fine. A mean of the rate over the alignment takes every settling of the support for a rotation of the Earth: 5 urad in 600 s
make 0.002 deg/h, as much as a navigation-grade gyroscope may drift. So the attitude is carried along with the gyroscope,
and the accelerometer says how it is tilted. With the computed attitude ``C = (I - [phi x]) C_true``, the Earth's rate
``W`` in the navigation frame (north, east, down), white noise ``n_w`` of the gyroscope and ``n_f`` of the accelerometer::

    d phi / dt = -W x phi - C n_w
    C f = (g phi_E, -g phi_N, -g) + C n_f

The heading error phi_D is seen because ``d phi_E / dt`` holds ``W_N phi_D``: the filter is a gyrocompass that forgives
tilting. Its covariance contains white noise alone; what constant errors of the instrument do is ``response``: an
accelerometer error along north tilts, a gyroscope error along east turns the heading by ``error / (rate cos latitude)``.
Both cannot be told from true attitude at rest, which is why alignment hides the accelerometer.

Known heading. A gyroscope that cannot see the Earth turn finds no north. Where the heading is told (a marked line, a compass,
another system), phi_D is what the teller does not know, nothing is learned about it, and the filter finds the two tilts alone.

References
----------
.. [1] D. H. Titterton, J. L. Weston, "Strapdown Inertial Navigation Technology", 2nd edition, 2004: section 10.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.earth import EARTH_RATE_RAD_S
from imufield.errors import Reason, RecordingError, UsageError
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

STEPS = 100
"""Means the filter works on, at least: a settling slower than a hundredth of the alignment is followed."""
LARGEST_LATITUDE_DEG = 85.0
"""Closer to a pole north has no use and longitude no measure."""
_PASSES = 3  # The filter is linear about the coarse attitude; the second and third pass are linear about the result.
_OPEN = 10.0  # Sigma before anything is known, rad. The coarse attitude comes from the same data and must not count twice.
# Noise-free simulations have none, and a filter without noise divides by zero.
_LEAST_FORCE_DENSITY = 1e-9
_LEAST_RATE_DENSITY = 1e-13
STEEPEST_X_DEG = 80.0
"""Beyond, the horizontal part of the body x axis is too short to have a heading."""
_RESPONSE_STEPS = np.repeat([1e-5, 1e-12], 3)  # m/s^2 and rad/s: far above rounding, far below what makes the response bend.


@dataclass(frozen=True, slots=True)
class RestMeans:
    """Corrected means of equal intervals at rest."""

    interval_s: float
    force: FloatArray
    """Shape (n, 3), m/s^2."""
    rate: FloatArray
    """Shape (n, 3), rad/s."""


@dataclass(frozen=True, slots=True)
class NoiseDensity:
    """White noise of the instrument, one figure a triad: m/s^2 and rad/s per sqrt(Hz)."""

    force: float
    rate: float


@dataclass(frozen=True, slots=True)
class Heading:
    """Direction of the body x axis, seen from above: clockwise from true north, known from elsewhere."""

    angle_rad: float
    sigma_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Alignment:
    """Attitude at the end of an alignment."""

    attitude: FloatArray
    """C_nb: body to north, east, down; shape (3, 3)."""
    covariance: FloatArray
    """Of phi from white noise and a told heading's own uncertainty, shape (3, 3), rad^2."""
    response: FloatArray
    """d phi / d (force error, rate error) in the body frame, shape (3, 6)."""


def align(means: RestMeans, latitude_deg: float, noise: NoiseDensity, heading: Heading | None = None) -> Alignment:
    """Align coarsely, then finely; with a heading, only level.

    Raises
    ------
    UsageError
        If the latitude is too near to a pole, or the body x axis too steep to have a heading.
    RecordingError
        If there is no specific force, or no rate at right angles to it.
    """
    if not abs(latitude_deg) <= LARGEST_LATITUDE_DEG:
        raise UsageError(sentence("alignment.latitude", latitude_deg=latitude_deg, limit_deg=LARGEST_LATITUDE_DEG))
    # Longer means, where there are more of them than the filter needs.
    factor = max(1, len(means.force) // STEPS)
    first = len(means.force) % factor
    force, rate = (values[first:].reshape(-1, factor, 3).mean(axis=1) for values in (means.force, means.rate))
    means = RestMeans(means.interval_s * factor, force, rate)
    attitude, covariance = _fine(means, latitude_deg, noise, heading)
    return Alignment(attitude, covariance, _response(means, latitude_deg, noise, attitude, heading=heading))


def coarse_attitude(force: FloatArray, rate: FloatArray) -> FloatArray:
    """Return C_nb from mean specific force and mean rate at rest, shape (3, 3).

    Raises
    ------
    RecordingError
        If one of the vectors is missing, or they point the same way.
    """
    length = float(np.linalg.norm(force))
    # 1e-300 keeps a force of zero from dividing; the check below refuses it.
    north = rate - (rate @ force) / max(length, 1e-300) ** 2 * force
    if not (length > 0 and np.linalg.norm(north) > 0):
        refused = sentence("alignment.no_north", force=force.tolist(), rate=rate.tolist())
        raise RecordingError(refused, Reason.BAD_DATA)
    down = -force / length
    north = north / np.linalg.norm(north)
    return np.array([north, np.cross(down, north), down], dtype=np.float64)


def level_attitude(force: FloatArray, heading: Heading) -> FloatArray:
    """Return C_nb from mean specific force at rest and the heading of the body x axis, shape (3, 3).

    Raises
    ------
    UsageError
        If the body x axis is steeper than ``STEEPEST_X_DEG``.
    RecordingError
        If there is no specific force.
    """
    length = float(np.linalg.norm(force))
    if not length > 0:
        raise RecordingError(sentence("alignment.no_force"), Reason.BAD_DATA)
    down = -force / length
    steep_deg = float(np.degrees(np.arcsin(min(abs(down[0]), 1.0))))
    if steep_deg > STEEPEST_X_DEG:
        raise UsageError(sentence("alignment.steep", steep_deg=steep_deg, limit_deg=STEEPEST_X_DEG))
    ahead: FloatArray = np.array([1.0, 0.0, 0.0]) - down[0] * down
    ahead /= np.linalg.norm(ahead)
    north = np.cos(heading.angle_rad) * ahead - np.sin(heading.angle_rad) * np.cross(down, ahead)
    return np.array([north, np.cross(down, north), down], dtype=np.float64)


def earth_rate(latitude_deg: float) -> FloatArray:
    """Return the Earth's rate in north, east, down, shape (3,), rad/s."""
    latitude = np.radians(latitude_deg)
    return EARTH_RATE_RAD_S * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return [v x], shape (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix of a rotation vector, shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    A = cross_matrix(vector)
    # np.sinc is sin(pi x)/(pi x): both factors are exact at zero.
    half = np.sinc(angle / (2 * np.pi))
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * A + 0.5 * half**2 * (A @ A))


def _fine(means: RestMeans, latitude_deg: float, noise: NoiseDensity, heading: Heading | None) -> tuple[FloatArray, FloatArray]:
    """Return attitude at the end and covariance of phi."""
    earth = earth_rate(latitude_deg)
    steps = [rotation(rate * means.interval_s) for rate in means.rate]
    back = rotation(-earth * means.interval_s)
    force = means.force.mean(axis=0)
    attitude = coarse_attitude(force, means.rate.mean(axis=0)) if heading is None else level_attitude(force, heading)
    learns = np.diag([1.0, 1.0, 0.0 if heading is not None else 1.0])
    covariance = np.eye(3)
    for number in range(_PASSES):
        if number:
            for step in reversed(steps):
                attitude = back.T @ attitude @ step.T
        attitude, phi, covariance = _filter(means, attitude, steps, earth, noise=noise, learns=learns)
        attitude = rotation(phi) @ attitude
    if heading is None:
        return _orthonormal(attitude), covariance
    # At rest the heading at the end is the one that was told; what the gyroscope made of it meanwhile is its error.
    covariance[2, 2] = heading.sigma_rad**2
    return level_attitude(-_orthonormal(attitude)[2], heading), covariance


def _filter(
    means: RestMeans,
    attitude: FloatArray,
    steps: list[FloatArray],
    earth: FloatArray,
    *,
    noise: NoiseDensity,
    learns: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Carry an attitude from start to end; return it, phi and its covariance there. ``learns`` has 0 where phi is known."""
    dt = means.interval_s
    back = rotation(-earth * dt)
    # Half an interval before and after each mean, which belongs to its middle.
    half = np.eye(3) - learns @ cross_matrix(earth) * dt / 2
    Q = learns * max(noise.rate, _LEAST_RATE_DENSITY) ** 2 * dt / 2
    R = np.eye(2) * max(noise.force, _LEAST_FORCE_DENSITY) ** 2 / dt
    phi, P = np.zeros(3), learns * _OPEN**2
    for step, force in zip(steps, means.force, strict=True):
        after = back @ attitude @ step
        phi, P = half @ phi, half @ P @ half.T + Q
        measured = (attitude + after) @ force / 2
        g = float(np.linalg.norm(force))
        H = np.array([[0.0, g, 0.0], [-g, 0.0, 0.0]])
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        phi = phi + gain @ (measured[:2] - H @ phi)
        # Joseph's form: the covariance stays symmetric and positive whatever rounding does to the gain.
        kept = np.eye(3) - gain @ H
        P = kept @ P @ kept.T + gain @ R @ gain.T
        phi, P = half @ phi, half @ P @ half.T + Q
        attitude = after
    return attitude, phi, P


def _response(
    means: RestMeans, latitude_deg: float, noise: NoiseDensity, attitude: FloatArray, *, heading: Heading | None
) -> FloatArray:
    """Return d phi / d instrument errors by running the filter on data with each error added."""
    response = np.zeros((3, 6))
    for k, size in enumerate(_RESPONSE_STEPS):
        error = np.zeros(6)
        error[k] = size
        changed = RestMeans(means.interval_s, means.force + error[:3], means.rate + error[3:])
        turned = _fine(changed, latitude_deg, noise, heading)[0] @ attitude.T
        # turned = I - [phi x]
        phi = np.array([turned[1, 2] - turned[2, 1], turned[2, 0] - turned[0, 2], turned[0, 1] - turned[1, 0]]) / 2
        response[:, k] = phi / size
    return response


def _orthonormal(matrix: FloatArray) -> FloatArray:
    # The rotation nearest to the product of thousands, which rounding has bent.
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right, dtype=np.float64)
