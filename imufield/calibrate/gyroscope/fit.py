"""Fit of a gyroscope's bias, scale, misalignment and g-sensitivity, and the covariance of what is fitted.

Gauss-Newton on the residuals of ``residuals`` with their full covariance ``S`` of ``residual_covariance``, the Earth's rate as
prior knowledge. The three scatters of S (drift, wander and turn) are estimated along the way. Half of a step is tried where
the whole one does not help.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.gyroscope.move_integration import PARAMETERS
from imufield.calibrate.gyroscope.residual_covariance import Covariances, Scatter, covariances, next_scatter
from imufield.calibrate.gyroscope.residuals import FIRST_HORIZONTAL, VERTICAL, Evaluation, GyroscopeData, evaluate
from imufield.calibrate.model.uncertainty import inverse_root
from imufield.calibrate.solvers.base import SolverResult, SolverStatus
from imufield.dataclass import dataclass
from imufield.earth import EARTH_RATE_RAD_S
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray, IntArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_ITERATIONS = 60  # Steps before it says that it did not converge; the scatters settle last.
_SETTLED = 1e-8  # Sum of squared changes in sigma at which it stops: a ten-thousandth of a sigma.
# The same below which a step is taken whole: derivatives of first order miss the least cost by a hundredth of a sigma.
_WHOLE = 1e-4
_NEAR = 1.0  # The same from which on only the scatters are left to be found, and the Earth's heading is seen or not: a sigma.
_SCATTER_SETTLED = 1e-3  # Relative change of each scatter at which it stops: 24 stills tell a scatter to a tenth.
_HALVINGS = 6  # Shares of a step that are tried, 1 to 1/32; the last is taken as it is, and the next step is another.
_SESSION_ROOT_S = 20.0  # Root of the length of a session, sqrt(s), to start from: 400 s, 24 positions of 17 s.
HEADING_SEEN = 0.2
"""Sigma of the horizontal Earth rate over its length below which its length is taken as known and one azimuth is fitted."""
_LENGTH_SIGMA = 1e-4  # Of the Earth's rate: how strictly the known length is kept.


@dataclass(frozen=True, slots=True, kw_only=True)
class JointFit:
    """The end of a fit."""

    p: FloatArray
    """See ``residuals``."""
    free: IntArray
    """Which of ``p`` were fitted."""
    covariance: FloatArray
    """Of the free ones."""
    gain: FloatArray
    """d free / d residual: minus this times the noise is the error, shape (free, rows)."""
    evaluation: Evaluation
    parts: Covariances
    scatter: Scatter
    solved: SolverResult
    heading_fitted: bool

    @property
    def shares(self) -> dict[str, FloatArray]:
        """What ``covariance`` is the sum of, by name, of the same shape."""
        told = {name: self.gain @ part @ self.gain.T for name, part in self.parts.shares(self.scatter).items()}
        # What the residuals do not move: that of the prior rows, which is of the Earth's rate.
        return told | {"earth_rate": self.covariance - np.sum([*told.values()], axis=0)}

    @property
    def degrees_of_freedom(self) -> int:
        """Residuals less parameters of the instrument."""
        return int(len(self.evaluation.residual) - np.count_nonzero(self.free < PARAMETERS))


@dataclass(frozen=True, slots=True)
class _Prior:
    """Rows (p - mean) / sigma for the Earth's rate, and the known length of its horizontal part."""

    mean: FloatArray
    sigma: FloatArray  # inf where nothing is known.
    length_rad_s: float | None

    def rows(self, p: FloatArray, free: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals and derivatives in units of sigma."""
        known = np.flatnonzero(np.isfinite(self.sigma))
        known = known[np.isin(known, free)]
        jacobian = np.zeros((len(known), len(p)))
        jacobian[range(len(known)), known] = 1 / self.sigma[known]
        residual = (p[known] - self.mean[known]) / self.sigma[known]
        if self.length_rad_s is not None:
            h = p[FIRST_HORIZONTAL:].reshape(-1, 2)
            size = np.maximum(np.linalg.norm(h, axis=1), 1e-30)
            sigma = _LENGTH_SIGMA * EARTH_RATE_RAD_S
            rows = np.zeros((len(h), len(p)))
            columns = FIRST_HORIZONTAL + np.arange(h.size).reshape(h.shape)
            rows[np.arange(len(h))[:, None], columns] = h / size[:, None] / sigma
            residual = np.append(residual, (size - self.length_rad_s) / sigma)
            jacobian = np.vstack([jacobian, rows])
        return residual, jacobian[:, free]


def make_prior(data: GyroscopeData, *, heading: bool) -> _Prior:
    """Return what the latitude says of the Earth's rate; ``heading``: its horizontal length is strictly kept."""
    mean, sigma = np.zeros(data.parameters), np.full(data.parameters, np.inf)
    if data.latitude_deg is None:
        sigma[VERTICAL:] = EARTH_RATE_RAD_S / np.sqrt(3.0)  # It may point anywhere.
        return _Prior(mean, sigma, None)
    latitude = np.radians(data.latitude_deg)
    mean[VERTICAL] = EARTH_RATE_RAD_S * np.sin(latitude)
    horizontal_rad_s = float(EARTH_RATE_RAD_S * np.cos(latitude))
    if not heading:
        sigma[FIRST_HORIZONTAL:] = horizontal_rad_s / np.sqrt(2.0)  # Of each component while the azimuth is unknown.
    return _Prior(mean, sigma, horizontal_rad_s if heading else None)


def fit_jointly(data: GyroscopeData, start: FloatArray, free: IntArray, scatter: Scatter | None = None) -> JointFit:
    """Fit the parameters ``free`` of ``p``, starting at ``start``; the Earth's horizontal rate is always fitted along.

    Parameters
    ----------
    data : GyroscopeData
    start : ndarray, shape (data.parameters,)
    free : ndarray of int
        Which of the 21 instrument parameters to fit.
    scatter : Scatter, optional
        To start from.
    """
    prior = make_prior(data, heading=False)
    p = start.copy()
    # Known where the latitude is; without one it is fitted from zero.
    p[VERTICAL] = prior.mean[VERTICAL]
    nuisance = [VERTICAL] if data.latitude_deg is None else []
    columns = np.array([*free, *nuisance, *range(FIRST_HORIZONTAL, data.parameters)], dtype=np.int64)
    strict = make_prior(data, heading=True)
    # One azimuth serves each chain of moves; once every chain knows it, the known length is kept strictly. A fit that is near
    # shows whether they do.
    is_rough = bool(strict.length_rad_s)
    while True:
        fitted = _gauss_newton(data, p, columns, prior=prior, scatter=scatter, is_rough=is_rough)
        p, scatter = fitted.p.copy(), fitted.scatter
        places = np.flatnonzero(fitted.free >= FIRST_HORIZONTAL)
        spread = np.sqrt(np.diag(fitted.covariance)[places].reshape(-1, 2).sum(axis=1))
        if strict.length_rad_s and np.all(spread < HEADING_SEEN * strict.length_rad_s):
            h = p[FIRST_HORIZONTAL:].reshape(-1, 2)
            h *= strict.length_rad_s / np.linalg.norm(h, axis=1)[:, None]
            return _gauss_newton(data, p, columns, prior=strict, scatter=scatter)
        if not is_rough:
            return fitted
        is_rough = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """The linearised problem at one point."""

    change: FloatArray
    covariance: FloatArray
    gain: FloatArray
    whitening: FloatArray  # L^-1 of S = L L^T.
    cost: float
    size: float  # Change in sigma, squared.


def _gauss_newton(
    data: GyroscopeData,
    p: FloatArray,
    free: IntArray,
    *,
    prior: _Prior,
    scatter: Scatter | None,
    is_rough: bool = False,
) -> JointFit:
    """Fit from ``p``; a rough fit ends where it is near, whatever the scatters do."""
    now = evaluate(p, data)
    scatter = scatter or first_scatter(now)
    status, count = SolverStatus.ITERATION_LIMIT, 1
    parts = covariances(now, p[:PARAMETERS], data)
    for _ in range(_ITERATIONS):
        step = _linear_step(now, parts, scatter, p, free=free, prior=prior)
        # Take the step, or the half of it that first lowers the cost.
        share, trial = 1.0, p
        for tried in range(1, _HALVINGS + 1):
            trial = p.copy()
            trial[free] += step.change * share
            now = evaluate(trial, data)
            prior_residual, _ = prior.rows(trial, free)
            cost = float(np.sum((step.whitening @ now.residual) ** 2) + prior_residual @ prior_residual)
            count += 1
            helps = cost <= step.cost * (1 + 1e-9) + 1e-9
            if helps or tried == _HALVINGS or step.size < _WHOLE * len(free):
                break
            share /= 2
        p = trial
        parts = covariances(now, p[:PARAMETERS], data)
        before, scatter = scatter, _next_scatter(scatter, now, free, parts)
        is_near = step.size < _NEAR * len(free)
        if is_near and not _is_same(before, scatter):
            scatter = _settle_scatter(scatter, now, free, parts)
        has_settled = step.size < _SETTLED * len(free) and _is_same(before, scatter)
        if has_settled or (is_rough and is_near):
            status = SolverStatus.CONVERGED
            break
    step = _linear_step(now, parts, scatter, p, free=free, prior=prior)
    message = sentence("fit.settled" if status is SolverStatus.CONVERGED else "fit.iteration_limit", iterations=_ITERATIONS)
    solved = SolverResult(x=p[free], cost=step.cost, status=status, message=message, evaluations=count)
    return JointFit(
        p=p,
        free=free,
        covariance=step.covariance,
        gain=step.gain,
        evaluation=now,
        parts=parts,
        scatter=scatter,
        solved=solved,
        heading_fitted=prior.length_rad_s is not None,
    )


def _settle_scatter(scatter: Scatter, now: Evaluation, free: IntArray, parts: Covariances) -> Scatter:
    """Return the scatters where they settle at these turns, which hardly change any more and cost most of a step."""
    for _ in range(_ITERATIONS):
        last, scatter = scatter, _next_scatter(scatter, now, free, parts)
        if _is_same(last, scatter):
            break
    return scatter


def _is_same(before: Scatter, after: Scatter) -> bool:
    pairs = zip(before, after, strict=True)
    return all(abs(old - new) <= _SCATTER_SETTLED * max(old, 1e-9) for old, new in pairs)


def first_scatter(evaluation: Evaluation) -> Scatter:
    """Return generous sizes to start from."""
    m = evaluation.moves
    moves, stills = evaluation.residual[: 2 * m], evaluation.residual[2 * m : 2 * m + 3 * evaluation.stills]
    turn = float(np.sqrt(np.mean(moves**2))) if m else 0.0
    drift = float(np.sqrt(np.mean(stills**2)))
    return Scatter(drift, drift / _SESSION_ROOT_S, min(turn, 0.1))  # 6 deg: a start far off must not excuse every move


def _next_scatter(scatter: Scatter, now: Evaluation, free: IntArray, parts: Covariances) -> Scatter:
    """Return the next sizes of the scatters.

    Raises
    ------
    CalibrationError
        If they have grown past all numbers: the moves do not fit the model at all.
    """
    try:
        # What overflows is asked for below.
        with np.errstate(over="ignore", invalid="ignore"):
            following = next_scatter(scatter, now.residual, now.jacobian[:, free], parts)
    except np.linalg.LinAlgError:
        following = Scatter(np.inf, np.inf, np.inf)
    if not np.isfinite(following).all():
        raise CalibrationError(sentence("fit.contradiction"), Reason.NOT_CONVERGED)
    return following


def _whitening(covariance: FloatArray) -> FloatArray:
    """Return the inverse of the Cholesky factor of the covariance of all residuals.

    Raises
    ------
    CalibrationError
        If the scatter that explains the residuals has grown past all noise: the moves do not fit the model at all.
    """
    try:
        return inverse_root(covariance)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(sentence("fit.contradiction"), Reason.NOT_CONVERGED) from error


def _linear_step(
    now: Evaluation, parts: Covariances, scatter: Scatter, p: FloatArray, *, free: IntArray, prior: _Prior
) -> _Step:
    whitening = _whitening(parts.total(scatter))
    whitened = whitening @ np.column_stack([now.residual, now.jacobian[:, free]])
    prior_residual, prior_jacobian = prior.rows(p, free)
    residual = np.concatenate([whitened[:, 0], prior_residual])
    jacobian = np.vstack([whitened[:, 1:], prior_jacobian])
    # Columns of one length: units of A, b and H differ by ten powers of ten.
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    inverse = np.linalg.pinv(jacobian / size) / size[:, None]
    change = -inverse @ residual
    return _Step(
        change=change,
        covariance=inverse @ inverse.T,
        gain=inverse[:, : len(whitened)] @ whitening,
        whitening=whitening,
        cost=float(residual @ residual),
        size=float(np.sum((jacobian @ change) ** 2)),
    )
