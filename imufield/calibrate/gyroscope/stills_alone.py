"""The gyroscope from still positions alone: its bias, and, where it sees the Earth turn, all of its linear model.

Beside moves, stills are rows of ``residuals``, and what is known of the Earth's rate is prior knowledge of ``fit``.

Bias as a mean
--------------
A still gyroscope feels the Earth's rate (7.292e-5 rad/s) alone. Of it the vertical part, ``rate sin(latitude)`` along "up", is
known in the body frame where latitude and specific force are; it is taken off each position. The horizontal part has an
unknown heading: in a body axis with the component ``u`` along up it has the variance ``(rate cos(latitude))^2 (1 - u^2) / 2``.
Headings need not differ from position to position, so it is not averaged down. Without a latitude the whole rate
counts as pointing anywhere: variance ``rate^2 / 3`` in each axis.

Norm of the Earth's rate
------------------------
With ``w = A n - b`` (see ``move_integration``) and ``u`` the direction of the specific force, whatever the heading::

    norm         |w| - rate                            ([1]_ eq. 7, weighted)
    invariant    u . w - rate sin(latitude)            the specific force times the Earth's rate, over g

The norm alone leaves the frame of A free; the invariant ties it to the accelerometer's. Two readings of one still share its
noise: their covariance is ``B C B^T`` with the rows of ``B`` the directions of w and u. Bias is known to 0.01 or 0.02 deg/h
after 10 s a position at 0.003 deg/sqrt(h); scale only to some 1e-3, so it is left at the preset unless asked for.

The invariant also checks the latitude: with it left free, ``sin(latitude) = v / rate``.

References
----------
.. [1] Y. Liu et al., "A New Norm-Observed Calibration Method Based on Improved Differential Evolution Algorithm for SINS",
   2021.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from imufield.calibrate.gyroscope.residual_covariance import Covariances, Scatter, next_scatter, random_walk
from imufield.calibrate.model.models import PARAMETERS as ACCELEROMETER_PARAMETERS
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import GyroscopeCalibration, GyroscopeParameters
from imufield.calibrate.model.rotation import unit_vectors
from imufield.calibrate.model.uncertainty import block_diagonal
from imufield.dataclass import dataclass
from imufield.earth import EARTH_RATE_RAD_S
from imufield.samples import FloatArray, median
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)


def static_bias(
    observations: Observations,
    scale: FloatArray | float | None,
    *,
    misalignment_rad: FloatArray | None = None,
    up: FloatArray | None = None,
    latitude_deg: float | None = None,
) -> GyroscopeCalibration:
    """Return the bias from the position means; scale and misalignment are taken as they are.

    Parameters
    ----------
    observations : Observations
        At least two positions, all with a gyroscope mean.
    scale : float or ndarray, shape (3,), optional
        Raw unit per rad/s, from the preset or the driver. None: not known; the bias then has no allowance for the Earth's rate
        and no value in rad/s.
    misalignment_rad : ndarray, shape (3, 3), optional
        E - I of the preset; default zero.
    up : ndarray, shape (m, 3), optional
        Direction of the specific force in the body frame (need not be unit). Default: the planned directions.
    latitude_deg : float, optional

    Returns
    -------
    GyroscopeCalibration
        Sigma of the bias from the scatter between positions; scale and misalignment as given, their sigma NaN.
    """
    m = len(observations)
    K = np.full(3, np.nan if scale is None else scale, dtype=np.float64)
    misalignment = np.zeros((3, 3)) if misalignment_rad is None else misalignment_rad
    if up is None:
        up = observations.direction
    earth_known = np.zeros_like(up)
    if latitude_deg is None:
        key = "stills_alone.bias_no_latitude"
    elif not np.isfinite(up).all():
        key = "stills_alone.bias_no_attitude"
    else:
        key = "stills_alone.bias"
        earth_known = EARTH_RATE_RAD_S * math.sin(math.radians(latitude_deg)) * unit_vectors(up)
    if scale is None:
        key = "stills_alone.bias_no_scale"
    gain = np.nan_to_num(K)
    values = observations.gyroscope_mean_raw - gain * (earth_known @ (np.eye(3) + misalignment).T)
    # The scatter between positions contains g-sensitivity and drift, and nothing that is the same in all of them.
    rounding = np.diag(observations.gyroscope_rounding().reshape(m, 3, m, 3).mean(axis=(0, 2)))
    shared = rounding + (gain * unknown_earth_rate(up, latitude_deg)) ** 2
    sigma = np.sqrt(values.var(axis=0, ddof=1) / m + shared)
    not_estimated = np.full((3, 3), np.nan)
    return GyroscopeCalibration(
        parameters=GyroscopeParameters(K, misalignment, values.mean(axis=0), np.zeros((3, 3))),
        sigma=GyroscopeParameters(np.full(3, np.nan), not_estimated, sigma, not_estimated),
        path=sentence(key, positions=m),
        raw_unit=observations.units.gyroscope_rate_unit,
    )


def unknown_earth_rate(up: FloatArray, latitude_deg: float | None) -> FloatArray:
    """Return 1 sigma of what is not known of the mean of the Earth's rate over m stills, rad/s, shape (3,)."""
    if latitude_deg is None or not np.isfinite(up).all():
        return np.full(3, EARTH_RATE_RAD_S / math.sqrt(3))
    # The horizontal part at an unknown heading.
    shares = np.sqrt(np.mean((1 - unit_vectors(up) ** 2) / 2, axis=0))
    return np.asarray(EARTH_RATE_RAD_S * math.cos(math.radians(latitude_deg)) * shares)


StaticFree = Literal["bias", "all"]
SEES_EARTH = 0.1
"""Sigma of a position mean over the Earth's rate below which an instrument sees the Earth turn."""
CONTRADICTED = 4.0
"""Sigmas between the vertical Earth rate of the latitude and the one that is observed: once in 16 000 good sessions."""
# Steps before it says that it did not converge; Gauss-Newton on a nearly linear problem, the scatters settle last.
_ITERATIONS = 40
_SETTLED = 1e-10  # Sum of squared changes in sigma at which it stops: a hundred-thousandth of a sigma.
# Of the Earth's rate, 1 sigma, in each row: at the pole its two directions are one, and their covariance singular.
_AT_POLE = 1e-4


@dataclass(frozen=True, slots=True)
class StaticData:
    """s still positions.

    Attributes
    ----------
    rate_raw : ndarray, shape (s, 3)
        Mean outputs less the output at rest.
    covariance_raw : ndarray, shape (3 s, 3 s)
    up : ndarray, shape (s, 3)
    time_s : ndarray, shape (s,)
    """

    rate_raw: FloatArray
    covariance_raw: FloatArray
    up: FloatArray
    time_s: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticFit:
    """``x`` holds A row by row (9), then b (3)."""

    start: FloatArray
    """A, b and v where the fit began, shape (13,)."""
    columns: list[int]
    """Which of A and b were fitted."""
    x: FloatArray
    shares: dict[str, FloatArray]
    """What its covariance is the sum of, by name, shape (12, 12), zero where not fitted."""
    scatter: Scatter
    vertical_rad_s: float
    vertical_sigma_rad_s: float
    """u . w as the stills show it with the latitude left free."""
    converged: bool


def latitude_figures(latitude_deg: float, vertical_rad_s: float, sigma_rad_s: float) -> dict[str, float]:
    """Return the numbers of the sentences about a latitude that was given, and of the vertical Earth rate that is seen.

    Near a pole a rate has no sigma as a latitude: what is compared are rates, of Earth's 15 deg/h.
    """
    return {
        "latitude_deg": latitude_deg,
        "observed_deg": math.degrees(math.asin(float(np.clip(vertical_rad_s / EARTH_RATE_RAD_S, -1, 1)))),
        "found_deg_h": math.degrees(vertical_rad_s) * 3600,
        "sigma_deg_h": math.degrees(sigma_rad_s) * 3600,
        "expected_deg_h": math.degrees(EARTH_RATE_RAD_S * math.sin(math.radians(latitude_deg))) * 3600,
    }


def contradicts(latitude_deg: float, vertical_rad_s: float, sigma_rad_s: float) -> bool:
    """Whether a vertical Earth rate is not that of a latitude."""
    return abs(vertical_rad_s - EARTH_RATE_RAD_S * math.sin(math.radians(latitude_deg))) > CONTRADICTED * sigma_rad_s


def latitude_words(latitude_deg: float, vertical_rad_s: float, sigma_rad_s: float) -> Sentence:
    """Return what u . w says about the latitude that was given."""
    is_contradicted = contradicts(latitude_deg, vertical_rad_s, sigma_rad_s)
    key = "stills_alone.latitude_contradicted" if is_contradicted else "stills_alone.latitude_seen"
    return sentence(key, **latitude_figures(latitude_deg, vertical_rad_s, sigma_rad_s))


def sees_earth(covariance_raw: FloatArray, A: FloatArray) -> bool:
    """Whether the position means (covariance (s, 3, 3)) are known well below the Earth's rate."""
    # Median of the positions: one that was touched must not hide the Earth from the others.
    variance = np.trace(A @ covariance_raw @ A.T, axis1=1, axis2=2) / 3
    return bool(np.sqrt(median(variance)) < SEES_EARTH * EARTH_RATE_RAD_S)


def fit_static(data: StaticData, A: FloatArray, latitude_deg: float, free: StaticFree = "bias") -> StaticFit:
    """Fit the bias, or all of A and b, to still positions.

    Parameters
    ----------
    data : StaticData
    A : ndarray, shape (3, 3)
        (K E)^-1 of the preset.
    latitude_deg : float
    free : {"bias", "all"}
    """
    columns = [9, 10, 11] if free == "bias" else list(range(12))
    vertical_rad_s = EARTH_RATE_RAD_S * math.sin(math.radians(latitude_deg))
    # The horizontal part averages out over headings, near enough to start from.
    bias = (data.rate_raw @ A.T - vertical_rad_s * data.up).mean(axis=0)
    start = np.concatenate([A.ravel(), bias, [vertical_rad_s]])
    fitted = _fit(data, start, columns)
    latitude_free = _fit(data, fitted.p, [*columns, 12])

    def in_all(part: FloatArray) -> FloatArray:
        full = np.zeros((12, 12))
        full[np.ix_(columns, columns)] = part
        return full

    return StaticFit(
        start=start,
        columns=columns,
        x=fitted.p[:12],
        shares={name: in_all(part) for name, part in fitted.shares.items()},
        scatter=fitted.scatter,
        vertical_rad_s=float(latitude_free.p[12]),
        vertical_sigma_rad_s=math.sqrt(latitude_free.covariance[-1, -1]),
        converged=fitted.converged,
    )


class _Fitted(NamedTuple):
    """The end of a fit of k of the 13 numbers A, b and v."""

    p: FloatArray
    """All 13."""
    covariance: FloatArray
    """Of the k, shape (k, k)."""
    shares: dict[str, FloatArray]
    """What it is the sum of, by name."""
    scatter: Scatter
    converged: bool


def _fit(data: StaticData, start: FloatArray, columns: list[int]) -> _Fitted:
    p, scatter = start.copy(), Scatter(0.3 * EARTH_RATE_RAD_S, 0.0, 0.0)
    left = _ITERATIONS
    while True:
        residual, jacobian, parts = linearise_static(p, data)
        J = jacobian[:, columns]
        inverse = np.linalg.inv(parts.total(scatter))
        size = np.sqrt(np.maximum(np.einsum("ij,ik,kj->j", J, inverse, J), 1e-300))
        information = (J / size).T @ inverse @ (J / size)
        change = -np.linalg.solve(information, (J / size).T @ inverse @ residual)
        p[columns] += change / size
        before, scatter = scatter, next_scatter(scatter, residual, J, parts)
        steady = abs(before.drift_rad_s - scatter.drift_rad_s) <= 1e-3 * before.drift_rad_s + 1e-12
        converged = steady and float(change @ information @ change) < _SETTLED
        left -= 1
        if converged or not left:
            covariance = np.asarray(np.linalg.inv(information) / np.outer(size, size), dtype=np.float64)
            gain = covariance @ J.T @ inverse
            shares = {name: gain @ part @ gain.T for name, part in parts.shares(before).items()}
            return _Fitted(p=p, covariance=covariance, shares=shares, scatter=scatter, converged=converged)


def linearise_static(p: FloatArray, data: StaticData) -> tuple[FloatArray, FloatArray, Covariances]:
    """Return, at A, b and v (13), residuals (2 s), derivatives by A, b and v (2 s, 13), and the parts of their covariance."""
    A, b, v = p[:9].reshape(3, 3), p[9:12], p[12]
    s = len(data.rate_raw)
    w = data.rate_raw @ A.T - b
    norm = np.linalg.norm(w, axis=1)
    B = np.stack([w / norm[:, None], data.up], axis=1)
    # [1]_ eq. 7, and the specific force times the Earth's rate over g.
    residual = np.stack([norm - EARTH_RATE_RAD_S, np.sum(w * data.up, axis=1) - v], axis=1)
    jacobian = np.zeros((s, 2, 13))
    jacobian[:, :, :9] = (B[:, :, :, None] * data.rate_raw[:, None, None, :]).reshape(s, 2, 9)
    jacobian[:, :, 9:12] = -B
    jacobian[:, 1, 12] = -1.0
    # Norm and invariant share the noise of their still: B C B^T, block by block.
    to_rates = np.kron(np.eye(s), A)
    spread, noise = block_diagonal(B), to_rates @ data.covariance_raw @ to_rates.T
    at_pole = np.eye(2 * s) * (_AT_POLE * EARTH_RATE_RAD_S) ** 2
    wander = spread @ np.kron(random_walk(data.time_s), np.eye(3)) @ spread.T
    parts = Covariances(
        known={"gyroscope_within_hold": spread @ noise @ spread.T, "earth_rate": at_pole},
        drift=spread @ spread.T,
        wander=wander,
        turn=np.zeros_like(at_pole),
        with_accelerometer=np.zeros((2 * s, ACCELEROMETER_PARAMETERS + 1)),
    )
    return residual.ravel(), jacobian.reshape(2 * s, 13), parts
