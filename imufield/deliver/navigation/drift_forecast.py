"""The drift to be expected of an instrument at rest: Monte-Carlo over everything that is not known of it.

Errors of an INS that stands still obey linear equations with constant coefficients. With ``x = (latitude, longitude, north and
east velocity, phi)``, the Earth's rate ``W``, latitude ``L``, radii of curvature ``R_n`` and ``R_e``, specific-force error
``df`` and rate error ``dw`` in north, east, down [1]_::

    latitude'  = v_n / R_n                     longitude' = v_e / (R_e cos L)
    v_n' =  g phi_e + df_n - 2 W sin L v_e     v_e' = -g phi_n + df_e + 2 W sin L v_n
    phi' = -W x phi + (v_e / R_e, -v_n / R_n, -v_e tan L / R_e) + dW/dL latitude - dw

They are carried on by the exact transition matrix of a step in which the errors are constant; a thousand instruments take the
step together. In it are: parameters drawn from the calibration's joint covariance, white noise (random walk), flicker as the
sum of first-order processes a factor sqrt(10) apart in time, a turn-on bias, and the alignment, which shares its errors with
the navigation after it: white noise by the filter's own covariance, constant errors by its response to them.

References
----------
.. [1] D. H. Titterton, J. L. Weston, "Strapdown Inertial Navigation Technology", 2nd edition, 2004: section 12.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from imufield.calibrate.model.result import Calibration
from imufield.calibrate.model.rotation import from_matrix, logarithm, skew
from imufield.dataclass import dataclass, field
from imufield.deliver.navigation.alignment import Alignment, earth_rate
from imufield.deliver.navigation.drift import QUANTITIES, Drift
from imufield.deliver.navigation.uncertain import DrawnParameters, draw_parameters
from imufield.earth import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS_M
from imufield.samples import FloatArray

RUNS = 1000  # The 95 % limit has 50 runs above it and is known to 3 %.
SOURCES = ("accelerometer calibration", "gyroscope calibration", "white noise", "bias instability", "turn-on bias")
_STEPS = 300  # Of any duration: 5 h in steps of a minute, short against the 84 minutes of Schuler.
_SHORTEST_STEP_S = 1.0
_SPACING = math.sqrt(10.0)
# 50 s to 5000 s: faster flicker averages out in a step, slower looks like a turn-on bias.
_TIME_CONSTANTS_S = 50.0 * _SPACING ** np.arange(5)
_TURNED_RAD = 1e-3  # A turn of the body by less leaves its errors what they were.


@dataclass(frozen=True, slots=True)
class RandomErrors:
    """Errors that no calibration takes off, 1 sigma of each axis, shape (6,): three m/s^2, three rad/s."""

    density: FloatArray
    """White noise, per sqrt(Hz)."""
    instability: FloatArray
    turn_on: FloatArray
    """Bias that is new at each power-on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Where and how the instrument stood."""

    latitude_deg: float
    height_m: float
    gravity_m_s2: float
    alignment: Alignment
    time_s: FloatArray
    """Shape (n,), from the end of the alignment."""
    attitudes: FloatArray
    """C_nb at these times, shape (n, 3, 3)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftForecast:
    """Bands in which the errors lie with 95 % probability, arrays of shape (n,)."""

    time_s: FloatArray
    low: dict[str, FloatArray]
    """By quantity of ``QUANTITIES``."""
    high: dict[str, FloatArray]
    position_median_nmi: FloatArray
    position_95_nmi: FloatArray
    rate_median_nmi_per_h: float
    rate_95_nmi_per_h: float
    runs: int
    heading_sigma_rad: float
    """Of the alignment."""
    sources: dict[str, float] = field(default_factory=dict)
    """95 % drift in nmi/h from each source alone."""

    def holds(self, drift: Drift) -> bool:
        """Whether a measured drift is one of the 95 of 100 it should be."""
        return drift.rate_nmi_per_h <= self.rate_95_nmi_per_h


def forecast(
    calibration: Calibration, scene: Scene, random: RandomErrors, rng: np.random.Generator, *, runs: int = RUNS
) -> DriftForecast:
    """Return the drift to be expected, and how much of it each source makes alone."""
    # A stream for each source: what one draws does not move the numbers of another.
    seed = rng.spawn(1 + len(SOURCES))
    drift, phi = simulate(calibration, scene, random, seed[0], runs=runs)
    rates = _rates(drift)
    values = {name: getattr(drift, name) for name in QUANTITIES}
    low, high = ({name: np.quantile(value, q, axis=0) for name, value in values.items()} for q in (0.025, 0.975))
    alone = {
        source: float(
            np.quantile(_rates(simulate(calibration, scene, random, own, runs=runs // 4, sources=(source,))[0]), 0.95)
        )
        for source, own in zip(SOURCES, seed[1:], strict=True)
    }
    median, most = np.quantile(drift.position_nmi, [0.5, 0.95], axis=0)
    rate_median, rate_most = np.quantile(rates, [0.5, 0.95])
    return DriftForecast(
        time_s=drift.time_s,
        low=low,
        high=high,
        position_median_nmi=median,
        position_95_nmi=most,
        rate_median_nmi_per_h=float(rate_median),
        rate_95_nmi_per_h=float(rate_most),
        runs=runs,
        heading_sigma_rad=float(phi[:, 2].std()),
        sources=alone,
    )


def simulate(
    calibration: Calibration,
    scene: Scene,
    random: RandomErrors,
    rng: np.random.Generator,
    *,
    runs: int,
    sources: Sequence[str] = SOURCES,
) -> tuple[Drift, FloatArray]:
    """Return the drift of many instruments, arrays of shape (runs, n), and phi after the alignment, shape (runs, 3)."""
    triads = [name.partition(" ")[0] for name in sources if name.endswith("calibration")]
    parameters = draw_parameters(calibration, runs, rng, triads)
    white, flicker, turn_on = (name in sources for name in SOURCES[2:])
    slow = _Slow(random, rng, runs, flicker=flicker, turn_on=turn_on)
    density = random.density if white else np.zeros(6)
    # Equal steps from zero to the end, and the attitude at each.
    end_s = float(scene.time_s[-1])
    time_s = np.linspace(0.0, end_s, max(2, min(_STEPS, int(end_s / _SHORTEST_STEP_S))) + 1)
    attitudes = scene.attitudes[np.minimum(np.searchsorted(scene.time_s, time_s), len(scene.time_s) - 1)]
    step_s = float(time_s[1])
    forward, gain = transition(scene, step_s)
    x = np.zeros((runs, 7))
    constant, evaluated = _errors(parameters, scene, attitudes[0], attitudes[0], step_s=step_s), attitudes[0]
    # Alignment takes constant errors for tilt and heading, and averages white noise down to what its filter states.
    phi = (constant + slow.value) @ scene.alignment.response.T
    if white:
        # By eigenvalues: rounding can leave a covariance that has no Cholesky factor.
        phi = phi + rng.multivariate_normal(np.zeros(3), scene.alignment.covariance, len(phi), method="eigh")
    x[:, 4:] = phi
    states = [x]
    for before, after in pairwise(attitudes):
        if max(_angle(before, after), _angle(evaluated, before)) > _TURNED_RAD:
            constant, evaluated = _errors(parameters, scene, before, after, step_s=step_s), before
            if _angle(before, after) > _TURNED_RAD:
                evaluated = np.zeros((3, 3))  # the turn is over after this step
        body = constant + slow.value + density / math.sqrt(step_s) * rng.standard_normal((runs, 6))
        force, rate = body[:, :3] @ before.T, body[:, 3:] @ before.T
        x = x @ forward.T + np.hstack([force[:, :2], rate]) @ gain.T
        states.append(x)
        slow.advance(step_s)
    latitude, longitude, north, east = np.array(states).transpose(2, 1, 0)[:4]
    drift = Drift(
        time_s=time_s,
        latitude_deg=np.degrees(latitude),
        longitude_deg=np.degrees(longitude),
        north_velocity_m_s=north,
        east_velocity_m_s=east,
        true_latitude_deg=scene.latitude_deg,
    )
    return drift, phi


def transition(scene: Scene, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return d x / d x and d x / d (df_n, df_e, dw) over one step, shapes (7, 7) and (7, 5)."""
    from scipy.linalg import expm  # slow to load, and only a check needs it

    A = np.zeros((12, 12))
    A[:7, :7], A[:7, 7:] = system(scene.latitude_deg, scene.height_m, scene.gravity_m_s2)
    total = expm(A * step_s)
    return total[:7, :7], total[:7, 7:]


def system(latitude_deg: float, height_m: float, gravity_m_s2: float) -> tuple[FloatArray, FloatArray]:
    """Return F and G of x' = F x + G (df_n, df_e, dw), shapes (7, 7) and (7, 5)."""
    latitude = math.radians(latitude_deg)
    shape = 1 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    east_m = SEMI_MAJOR_AXIS_M / math.sqrt(shape)
    north_m = east_m * (1 - ECCENTRICITY_SQUARED) / shape + height_m
    east_m += height_m
    W = earth_rate(latitude_deg)
    F, G = np.zeros((7, 7)), np.zeros((7, 5))
    F[0, 2], F[1, 3] = 1 / north_m, 1 / (east_m * math.cos(latitude))
    F[2, 5], F[2, 3], F[3, 4], F[3, 2] = gravity_m_s2, 2 * W[2], -gravity_m_s2, -2 * W[2]
    F[4, 3], F[5, 2], F[6, 3] = 1 / east_m, -1 / north_m, -math.tan(latitude) / east_m
    F[4:, 4:] = -skew(W)
    F[4, 0], F[6, 0] = W[2], -W[0]
    G[2, 0] = G[3, 1] = 1.0
    G[4:, 2:] = -np.eye(3)
    return F, G


class _Slow:
    """Biases of many instruments that wander, shape (runs, 6)."""

    def __init__(self, random: RandomErrors, rng: np.random.Generator, runs: int, *, flicker: bool, turn_on: bool) -> None:
        self._rng = rng
        instability = np.nan_to_num(random.instability) * flicker
        # Processes a factor apart in time add up to flicker of the stated instability: variance ln(factor) / pi each.
        self._stationary = instability * math.sqrt(math.log(_SPACING) / math.pi)
        self._states = self._stationary * rng.standard_normal((len(_TIME_CONSTANTS_S), runs, 6))
        self._constant = random.turn_on * turn_on * rng.standard_normal((runs, 6))

    @property
    def value(self) -> FloatArray:
        return np.asarray(self._constant + self._states.sum(axis=0))

    def advance(self, step_s: float) -> None:
        if not self._stationary.any():
            return
        decay = np.exp(-step_s / _TIME_CONSTANTS_S)[:, None, None]
        shocks = self._stationary * self._rng.standard_normal(self._states.shape)
        self._states = decay * self._states + np.sqrt(1 - decay**2) * shocks


def _errors(parameters: DrawnParameters, scene: Scene, before: FloatArray, after: FloatArray, *, step_s: float) -> FloatArray:
    """Return the errors of corrected values in a step from one attitude to another, shape (m, 6)."""
    force = before.T @ np.array([0.0, 0.0, -scene.gravity_m_s2])
    turn_rad = logarithm(from_matrix(before.T @ after))
    rate = before.T @ earth_rate(scene.latitude_deg) + turn_rad * (np.linalg.norm(turn_rad) >= _TURNED_RAD) / step_s
    return parameters.errors(force, rate)


def _angle(first: FloatArray, second: FloatArray) -> float:
    return float(np.linalg.norm(first - second)) / math.sqrt(2)


def _rates(drift: Drift) -> FloatArray:
    """Return ``Drift.rate_nmi_per_h`` of each run, shape (m,)."""
    return np.asarray(drift.position_nmi.max(axis=1) / (drift.time_s[-1] / 3600))
