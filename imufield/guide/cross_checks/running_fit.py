"""The running fit to the positions measured so far: residuals, suspects, forecast, and the position that helps most.

A maximum a posteriori fit of the norm model in the lower gauge with wide priors (the spread of uncalibrated units), so that
there is a result from the fourth observation on and every parameter has a forecast from the first. The priors weigh nothing
once the positions tell more. This is for leading the operator; the numbers that are delivered come from ``calibrate``.

Disagreement is judged by the residual of a fit without the position over its sigma (externally studentised), where the
scatter between positions is estimated from the others and from an expectation of ``EXPECTED_SCATTER_M_S2``. The fit has that
expectation as its weight: a weight by the scatter found would count the bad position among the scatter, and hide it while few
positions tell otherwise. The forecast has the scatter found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from imufield.calibrate.model.aliasing import open_terms
from imufield.calibrate.model.coverage_factors import student_quantile
from imufield.calibrate.model.grades import Grade
from imufield.calibrate.model.models import PARAMETERS, norm_derivatives
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS, observe
from imufield.calibrate.model.rotation import unit_vectors
from imufield.calibrate.model.uncertainty import gravity_sensitivity
from imufield.dataclass import dataclass, replace
from imufield.earth import MICRO_G_M_S2, STANDARD_GRAVITY_M_S2, Gravity
from imufield.errors import CalibrationError
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray, every, median

FEWEST = 4  # Fewer observations leave every residual to the priors.
LINEAR = 9
"""Free parameters without the quadratic terms."""
SHOWS_SCATTER = LINEAR + 2
"""Fewer observations say nothing of the scatter between positions, and nothing checks a result of them."""
EXPECTED_SCATTER_M_S2 = 1e-4 * STANDARD_GRAVITY_M_S2  # Between positions: what good instruments repeat to.
EXPECTED_FREEDOM = 2.0  # Weight of that expectation, as if it came from this number of residuals.
_LEAST_VARIANCE = 0.05  # Of the expected one: positions that agree by chance make no suspects of the others.
_SUSPECT_SIGMAS = 5.0  # A position that the others contradict by this much is a suspect, where there are many.
# Share of good positions that may become suspects in one fit: a session of 24 makes some hundred fits, to much the same data.
SUSPECT_SHARE = 3e-5
SUSPECT_M_S2 = 3e-4 * STANDARD_GRAVITY_M_S2  # And by this much: less does no harm that another hold would cure.
_TOLD_SHARE = 0.5  # A sigma of more than this share of the prior's was assumed rather than measured.
_STEPS = 8  # Of Gauss-Newton at most: with priors it converges in four.
_LEAST_STEP = 1e-12  # Of the sigma of a prior: rounding makes steps of that size.
_LEAST_FREEDOM = 0.05  # Of a residual: a position that the others say nothing of would weigh without bound.
_MEDIAN_OF_SQUARES = 0.455  # Of a normal variable with sigma 1.
# Spread of uncalibrated instruments: scale as a share, bias in m/s^2, misalignment in rad, quadratic term per m/s^2 of scale.
_SCALE_SPREAD = 0.03
_SCALE_SPREAD_LEARNED = 0.2  # A scale learned from one still has its bias in it.
_BIAS_SPREAD_M_S2 = 0.5
_MISALIGNMENT_SPREAD_RAD = 0.02
_QUADRATIC_SPREAD = 5e-4


class Measured(Protocol):
    """What is fitted of an observation: the mean of a hold with the covariance of that mean, raw rates."""

    @property
    def name(self) -> str:
        """Of the position."""
        ...

    @property
    def mean_raw(self) -> FloatArray:
        """Shape (3,)."""
        ...

    @property
    def covariance_raw(self) -> FloatArray:
        """Shape (3, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Disagreement of a position with the fit to the others.

    ``limit_sigmas`` is larger while few positions show what a usual disagreement is.
    """

    name: str
    leave_one_out_m_s2: float
    sigmas: float
    limit_sigmas: float

    @property
    def is_suspect(self) -> bool:
        """Whether the others contradict this position."""
        return abs(self.sigmas) > self.limit_sigmas and abs(self.leave_one_out_m_s2) > SUSPECT_M_S2


@dataclass(frozen=True, kw_only=True)
class RunningFit:
    """The fit; columns are those of ``LOWER_GAUGE_COLUMNS`` (12), rows the observations, then the priors."""

    names: tuple[str, ...]
    vector: FloatArray
    scale: RoughScale
    residual_m_s2: FloatArray
    expected_m_s2: FloatArray
    """1 sigma of each norm by which it was weighted: of its mean, and expected between positions."""
    sigma_m_s2: FloatArray
    """The same by the scatter that the positions show."""
    jacobian: FloatArray
    """Of the norms, shape (m, 12)."""
    up: FloatArray
    """Where up is in the body, unit vectors, shape (m, 3)."""
    prior_sigma: FloatArray
    gravity_sigma: FloatArray
    """1 sigma of each parameter by gravity alone, which no position shows."""
    rank: int
    condition: float

    @cached_property
    def covariance(self) -> FloatArray:
        """Forecast covariance, priors included, shape (12, 12)."""
        weighted = np.vstack([self.jacobian / self.sigma_m_s2[:, None], np.diag(1 / self.prior_sigma)])
        return np.asarray(np.linalg.inv(weighted.T @ weighted), dtype=np.float64)

    def unseen(self, grade: Grade) -> FloatArray:
        """Return what is typical of a grade and no residual shows: d norm / d term times 1 sigma of each term, (m, k)."""
        return open_terms(self.up, grade, np.zeros(6, dtype=np.bool_))

    def forecast(self, unseen: FloatArray | None = None) -> dict[str, float]:
        """Return 1 sigma of the groups of parameters, the largest axis of each, in the units people use, with gravity's.

        A group that the positions do not show yet, whose sigma is still that of the prior, is left out. With what is unseen
        it includes that, as the result does.
        """
        shown = np.sqrt(self.covariance.diagonal())
        scale, bias, angles, square = (shown / self.prior_sigma).reshape(4, 3).max(axis=1) < _TOLD_SHARE
        sigma = np.hypot(shown, self.gravity_sigma)
        if unseen is not None:
            alias = self.covariance @ (self.jacobian / self.sigma_m_s2[:, None] ** 2).T @ unseen
            sigma = np.hypot(sigma, np.linalg.norm(alias, axis=1))
        K = np.abs(self.vector[:3])
        known = {
            "bias_ug": (bias, sigma[3:6].max() / MICRO_G_M_S2),
            "scale_ppm": (scale, (sigma[:3] / K).max() * 1e6),
            "misalignment_urad": (angles, sigma[6:9].max() * 1e6),
            "quadratic_ug_per_g2": (square, (sigma[9:] / K).max() * STANDARD_GRAVITY_M_S2**2 / MICRO_G_M_S2),
        }
        return {name: float(value) for name, (told, value) in known.items() if told}

    def of(self, rows: list[int]) -> RunningFit:
        """Return the fit as it is to some of the observations where all agree."""
        parts = (self.residual_m_s2, self.expected_m_s2, self.sigma_m_s2, self.jacobian, self.up)
        residual, expected, sigma, jacobian, up = (part[rows] for part in parts)
        names = tuple(self.names[row] for row in rows)
        return replace(
            self, names=names, residual_m_s2=residual, expected_m_s2=expected, sigma_m_s2=sigma, jacobian=jacobian, up=up
        )

    def expecting(self, within_m_s2: float, scatter_m_s2: float) -> RunningFit:
        """Return the fit as it is where means are known to this much, 1 sigma, and positions turn out to differ by that.

        With few positions the usual scatter is assumed, unless theirs is larger.
        """
        expected = np.full(len(self.names), math.hypot(within_m_s2, EXPECTED_SCATTER_M_S2))
        sigma = np.maximum(_with_scatter(expected, scatter_m_s2**2), math.hypot(within_m_s2, scatter_m_s2))
        return replace(self, expected_m_s2=expected, sigma_m_s2=sigma)

    def common_scale(self) -> tuple[float, float]:
        """Return the mean of the sensing axes' scales, raw rate per m/s^2, and its relative 1 sigma; free of the gauge."""
        T = _axes(self.vector)
        K = np.abs(self.vector[:3])
        share = np.zeros(12)
        share[:3] = 1 / (3 * self.vector[:3])
        sigma = math.sqrt(float(share @ self.covariance @ share))
        return float(np.exp(np.mean(np.log(K * np.linalg.norm(T, axis=1))))), sigma

    def disagreements(self) -> list[Disagreement]:
        """Return the disagreement of each position with the others, in their order."""
        leverage = np.minimum(_leverage(self.jacobian, self.expected_m_s2, self.prior_sigma), 1 - 1e-6)
        ratio = self.residual_m_s2 / self.expected_m_s2
        without = ratio / (1 - leverage)
        squares = ratio**2 / (1 - leverage)
        freedom = EXPECTED_FREEDOM + max(float((1 - leverage).sum()) - 1, 0.0)
        # Few degrees of freedom leave large ratios to chance.
        limit = max(_SUSPECT_SIGMAS, student_quantile(freedom, 1 - SUSPECT_SHARE / 2))
        found = []
        for k, name in enumerate(self.names):
            others = max(float(ratio @ ratio - squares[k]), 0.0)
            variance = (EXPECTED_FREEDOM + others) / freedom
            sigmas = without[k] * math.sqrt(1 - leverage[k]) / math.sqrt(max(variance, _LEAST_VARIANCE))
            found.append(Disagreement(name, float(without[k] * self.expected_m_s2[k]), float(sigmas), limit))
        return found

    def gain(self, directions: FloatArray) -> FloatArray:
        """Return the shrinking of the ellipsoid by a hold in each of the directions (n, 3): log det, D-optimal."""
        s = STANDARD_GRAVITY_M_S2 * directions @ _axes(self.vector).T
        raw = self.vector[:3] * (s + self.vector[3:6]) + self.vector[12:] * s**2
        rows = norm_derivatives(self.vector, raw).jacobian[:, LOWER_GAUGE_COLUMNS]
        sigma = float(median(self.sigma_m_s2))
        gain: FloatArray = np.log1p(np.einsum("ni,ij,nj->n", rows, self.covariance, rows) / sigma**2)
        return gain

    def quadratic_sigmas(self) -> float:
        """Return the largest quadratic term over its sigma."""
        sigma = np.sqrt(np.diag(self.covariance))[9:]
        return float(np.max(np.abs(self.vector[12:]) / sigma))


def _axes(vector: FloatArray) -> FloatArray:
    """Return the sensing axes of a parameter vector in rows, shape (3, 3)."""
    T = np.eye(3)
    T[[0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]] = vector[6:12]
    return T


def running_fit(observations: Sequence[Measured], scale: RoughScale, gravity: Gravity) -> RunningFit | None:
    """Fit the observations so far; None while they are too few or where the fit does not converge.

    Parameters
    ----------
    observations : sequence of Measured
    scale : RoughScale
        Nominal scale and mid-scale: where the fit starts, and the centre of the priors.
    gravity : Gravity
        A wrong value changes the common scale only.
    """
    gravity_m_s2 = gravity.gravity_m_s2
    if len(observations) < FEWEST or not scale.accelerometer:
        return None
    raw = np.array([observation.mean_raw for observation in observations]) - scale.raw_zero
    within = np.array([observation.covariance_raw for observation in observations])
    start = np.zeros(PARAMETERS)
    start[:3] = scale.accelerometer
    # In the order of ``LOWER_GAUGE_COLUMNS``.
    prior = np.repeat(
        [
            (_SCALE_SPREAD_LEARNED if scale.learned else _SCALE_SPREAD) * scale.accelerometer,
            _BIAS_SPREAD_M_S2,
            _MISALIGNMENT_SPREAD_RAD,
            _QUADRATIC_SPREAD * scale.accelerometer / STANDARD_GRAVITY_M_S2,
        ],
        3,
    )
    sigma = np.full(len(raw), EXPECTED_SCATTER_M_S2)
    try:
        vector, residual, jacobian, across = _minimise(start, raw, sigma, prior, gravity_m_s2=gravity_m_s2)
        own = np.einsum("mi,mij,mj->m", across, within, across)
        # The first fit tells how sure each mean is along its norm.
        expected = np.sqrt(np.maximum(own, 0.0) + EXPECTED_SCATTER_M_S2**2)
        # The norm grows along the force, but for misalignment.
        up = across * vector[:3]
        vector, residual, jacobian, _ = _minimise(start, raw, expected, prior, gravity_m_s2=gravity_m_s2)
        observability = observe(norm_derivatives(vector, raw), vector, gravity_m_s2, quadratic=True)
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    return RunningFit(
        names=tuple(observation.name for observation in observations),
        vector=vector,
        scale=scale,
        residual_m_s2=residual,
        expected_m_s2=expected,
        sigma_m_s2=_sigma(residual, jacobian, expected, prior),
        jacobian=jacobian,
        up=unit_vectors(up),
        prior_sigma=prior,
        gravity_sigma=np.abs(gravity_sensitivity(vector, gravity_m_s2)[list(LOWER_GAUGE_COLUMNS)]) * gravity.sigma_m_s2,
        rank=observability.rank,
        condition=observability.condition,
    )


def _minimise(
    start: FloatArray, raw: FloatArray, sigma: FloatArray, prior: FloatArray, *, gravity_m_s2: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return vector (15,), residuals (m,), Jacobian (m, 12) and d norm / d raw (m, 3): Gauss-Newton with priors."""
    columns = list(LOWER_GAUGE_COLUMNS)
    vector = start.copy()
    for _ in range(_STEPS):
        derivatives = norm_derivatives(vector, raw)
        rows = np.vstack([derivatives.jacobian[:, columns] / sigma[:, None], np.diag(1 / prior)])
        residual = derivatives.norm - gravity_m_s2
        goal = -np.concatenate([residual / sigma, (vector - start)[columns] / prior])
        if not every(np.isfinite(rows)):
            # LAPACK would say so as well, on the screen of the guide.
            raise np.linalg.LinAlgError
        step = np.linalg.lstsq(rows, goal, rcond=None)[0]
        vector[columns] += step
        if np.abs(step / prior).max() < _LEAST_STEP:
            break
    found = norm_derivatives(vector, raw)
    return vector, found.norm - gravity_m_s2, found.jacobian[:, columns], found.raw_gradient


def _leverage(jacobian: FloatArray, sigma: FloatArray, prior: FloatArray) -> FloatArray:
    """Return how much each norm determines its own fit, shape (m,)."""
    weighted = np.vstack([jacobian / sigma[:, None], np.diag(1 / prior)])
    leverage: FloatArray = np.einsum("mi,im->m", weighted, np.linalg.pinv(weighted))[: len(sigma)]
    return leverage


def _sigma(residual: FloatArray, jacobian: FloatArray, expected: FloatArray, prior: FloatArray) -> FloatArray:
    """Return 1 sigma of each norm: of its mean, and between positions.

    The variance between positions is what the residuals show beyond that of the means, pulled towards the expected one while
    there are few. The median keeps one bad position from raising the sigma of all.
    """
    spare = np.maximum(1 - _leverage(jacobian, expected, prior), _LEAST_FREEDOM)
    shown = float(median(residual**2 / spare)) / _MEDIAN_OF_SQUARES
    within = float(np.mean(expected**2)) - EXPECTED_SCATTER_M_S2**2
    return _with_scatter(expected, max(shown - within, 0.0))


def _with_scatter(expected: FloatArray, variance: float) -> FloatArray:
    """Return 1 sigma of each norm where the positions show this variance between them, in m^2/s^4."""
    freedom = max(len(expected) - LINEAR, 0)
    usual = EXPECTED_SCATTER_M_S2**2
    between = (
        usual
        if len(expected) < SHOWS_SCATTER
        else (EXPECTED_FREEDOM * usual + freedom * variance) / (EXPECTED_FREEDOM + freedom)
    )
    result: FloatArray = np.sqrt(expected**2 - usual + between)
    return result
