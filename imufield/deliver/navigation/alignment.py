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

import numpy as np

from imufield.calibrate.model.rotation import exponential, matrix, skew
from imufield.dataclass import dataclass
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
    """Corrected means of equal intervals at rest; inside this module those of k runs that are aligned together, (n, k, 3)."""

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
    # As measured, and with each error of the instrument added: what that turns is the response.
    errors = np.vstack([np.zeros(6), np.diag(_RESPONSE_STEPS)])
    runs = RestMeans(means.interval_s * factor, force[:, np.newaxis] + errors[:, :3], rate[:, np.newaxis] + errors[:, 3:])
    attitude, covariance = _fine(runs, latitude_deg, noise, heading)
    # turned = I - [phi x]
    turned = attitude[1:] @ attitude[0].T
    phi = np.array([turned[:, i, j] - turned[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))]) / 2
    return Alignment(attitude[0], covariance[0], phi / _RESPONSE_STEPS)


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


def rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrices of rotation vectors, shape (..., 3) -> (..., 3, 3)."""
    return matrix(exponential(vector))


def _fine(means: RestMeans, latitude_deg: float, noise: NoiseDensity, heading: Heading | None) -> tuple[FloatArray, FloatArray]:
    """Return the attitude of each run at the end and the covariance of its phi, shape (k, 3, 3) each."""
    earth = earth_rate(latitude_deg)
    steps = rotation(means.rate * means.interval_s)
    back = rotation(-earth * means.interval_s)
    whole = zip(means.force.mean(axis=0), means.rate.mean(axis=0), strict=True)
    attitude = np.array([level_attitude(force, heading) if heading else coarse_attitude(force, rate) for force, rate in whole])
    learns = np.diag([1.0, 1.0, 0.0 if heading is not None else 1.0])
    covariance = np.eye(3)
    for number in range(_PASSES):
        if number:
            for step in steps[::-1]:
                attitude = back.T @ attitude @ step.swapaxes(1, 2)
        attitude, phi, covariance = _filter(means, attitude, steps, earth, noise=noise, learns=learns)
        attitude = rotation(phi) @ attitude
    if heading is None:
        return _orthonormal(attitude), covariance
    # At rest the heading at the end is the one that was told; what the gyroscope made of it meanwhile is its error.
    covariance[:, 2, 2] = heading.sigma_rad**2
    return np.array([level_attitude(-down, heading) for down in _orthonormal(attitude)[:, 2]]), covariance


def _filter(
    means: RestMeans,
    attitude: FloatArray,
    steps: FloatArray,
    earth: FloatArray,
    *,
    noise: NoiseDensity,
    learns: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Carry attitudes from start to end; return them, phi and its covariance there. ``learns`` has 0 where phi is known."""
    dt = means.interval_s
    back = rotation(-earth * dt)
    # Half an interval before and after each mean, which belongs to its middle.
    half = np.eye(3) - learns @ skew(earth) * dt / 2
    Q = learns * max(noise.rate, _LEAST_RATE_DENSITY) ** 2 * dt / 2
    R = np.eye(2) * max(noise.force, _LEAST_FORCE_DENSITY) ** 2 / dt
    g = np.linalg.norm(means.force, axis=-1)
    sensitivity = np.zeros((*g.shape, 2, 3))
    sensitivity[..., 0, 1], sensitivity[..., 1, 0] = g, -g
    phi, P = np.zeros((3, 1)), learns * _OPEN**2
    for step, force, H in zip(steps, means.force[..., np.newaxis], sensitivity, strict=True):
        after = back @ attitude @ step
        phi, P = half @ phi, half @ P @ half.T + Q
        measured = (attitude + after) @ force / 2
        PH = P @ H.swapaxes(1, 2)
        gain = PH @ np.linalg.inv(H @ PH + R)
        phi = phi + gain @ (measured[:, :2] - H @ phi)
        # Joseph's form: the covariance stays symmetric and positive whatever rounding does to the gain.
        kept = np.eye(3) - gain @ H
        P = kept @ P @ kept.swapaxes(1, 2) + gain @ R @ gain.swapaxes(1, 2)
        phi, P = half @ phi, half @ P @ half.T + Q
        attitude = after
    return attitude, phi[..., 0], P


def _orthonormal(attitude: FloatArray) -> FloatArray:
    # The rotation nearest to the product of thousands, which rounding has bent.
    left, _, right = np.linalg.svd(attitude)
    return np.asarray(left @ right, dtype=np.float64)
