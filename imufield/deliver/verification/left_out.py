"""Left-out positions (option --hold-out): the proof of an accelerometer calibration on data it has not seen.

At rest the corrected specific force must be as long as gravity. How far it is off, ``r = norm(a) - g``, is compared with
how far it may be off: with ``J = d norm / d parameters`` and the joint covariance ``C`` of parameters and gravity,

    S = [J, -1] C [J, -1]^T + (variance of each mean) + tau^2

where tau is the scatter between positions of the calibration. Gravity is common to calibration and check where both were at one
place, so its error, which went into every scale, cancels here: this check proves nothing about g.

``cross_validate`` needs no second session: each group of positions is predicted by a calibration from all the others.

A misfit is large by the F distribution for another session, with as many degrees of freedom as the calibration had residuals to
spare (exact where the scatter between positions rules, too wide where the noise within a hold does).

For positions of the own session the limit is simulated. The calibrations that predict the groups share most of their positions,
and each has a scatter tau of its own from the few residuals that its group leaves it: their pooled misfit has no textbook
distribution (F is far too wide for a scatter that is known well, and too narrow for 3 residuals to spare). So sessions that
have the stated noise and nothing else go through the same steps, in the linearised model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.coverage_factors import f_limit_95, f_tail
from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.model.models import BIAS, NormDerivatives, norm_derivatives, to_vector, without_higher
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS, WEAKEST_COLUMN, parameter_scale, unexplained_lengths
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    AccelerometerParameters,
    Calibration,
    without_drift,
)
from imufield.calibrate.model.rotation import unit_vectors
from imufield.calibrate.model.uncertainty import known_covariance, within_variance
from imufield.calibrate.solvers.agreement import AGREEMENT_SIGMA
from imufield.dataclass import dataclass, replace
from imufield.earth import MICRO_G_M_S2, MILLI_G_M_S2, SAME_GRAVITY_M_S2, Gravity
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.progress import one_by_one
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

RUNS = 4000
"""Four times what the rarest statement, 1 in 1000, needs."""
HOLD_OUT = 4
"""Positions left out at a time, where nobody says how many and enough are left."""
STRONG = 1e-3
"""A misfit less probable than this is called a defect; among fewer than a thousand checks it does not come by chance."""
FOREIGN = 10.0
"""Misfit of another session beyond this, three times the forecast: no uncertainty that was honest at all is so far off."""
_TELLS_LITTLE = 10.0  # Limit of the misfit from which on hardly anything would contradict.
_ROUNDING_M_S2 = 1e-9  # Where nothing is uncertain (simulations without noise), this keeps a comparison finite.
_TINY = 1e-22  # Square of a nanogal, with which a covariance of zeros can be inverted.
_NEWTON_STEPS = 20  # Of the scatter: it converges quadratically.


def _simulated_misfits(
    calibration: Calibration, observations: Observations, groups: list[NDArray[np.bool_]], fitted: list[int]
) -> FloatArray:
    """Return the pooled misfit of simulated sessions whose noise is as the calibration states, shape (RUNS,).

    Every position is in one of the groups that are left out together; ``fitted`` has the number of parameters fitted without
    each. The session is linearised: residual = J z + noise.
    """
    p = calibration.accelerometer
    at = _derivatives(p, observations)
    known = np.diag(calibration.covariance_in(ACCELEROMETER_NAMES)) > 0
    J = (at.jacobian * parameter_scale(to_vector(p), calibration.gravity.gravity_m_s2))[:, known]
    within, m = _within(at, observations), len(observations)
    sigma = np.sqrt(within + calibration.quality.between_position_sigma_m_s2**2 + _TINY)
    noise = sigma * np.random.default_rng(0).standard_normal((RUNS, m))
    pairs = one_by_one("simulating sessions", [*zip(groups, fitted, strict=True)])
    squares = [_squares(J, within, group, noise, sigma=sigma, fitted=count) for group, count in pairs]
    return np.asarray(np.sum(squares, axis=0) / m)


def _squares(
    jacobian: FloatArray, within: FloatArray, group: NDArray[np.bool_], noise: FloatArray, *, sigma: FloatArray, fitted: int
) -> FloatArray:
    """Return r^T S^-1 r of one group of every run, shape (RUNS,); ``within`` is the variance of each mean."""
    rest = ~group
    # In most gauges columns depend on each other, and the rest may not show all: as many as were fitted are independent.
    shown = np.linalg.svd(jacobian[rest], full_matrices=False)[2][:fitted].T
    J, H = jacobian[rest] @ shown, jacobian[group] @ shown
    # Q spans the weighted columns; the fit at the true weights stands for that at the estimated ones.
    Q, R = np.linalg.qr(J / sigma[rest, None])
    whitened = noise[:, rest] / sigma[rest]
    z = np.linalg.solve(R, Q.T @ whitened.T).T
    left = noise[:, rest] - z @ J.T
    tau2 = _scatter(left, within[rest], int(rest.sum()) - J.shape[1])
    residual = noise[:, group] - z @ H.T
    weight = 1 / (within[rest] + tau2[:, None] + _TINY)
    normal = np.einsum("ai,ra,aj->rij", J, weight, J, optimize=True)
    S = H @ np.linalg.solve(normal, np.broadcast_to(H.T, (len(normal), *H.T.shape)))
    diagonal = np.arange(len(H))
    S[:, diagonal, diagonal] += within[group] + tau2[:, None] + _TINY
    return np.asarray(np.einsum("rh,rh->r", residual, np.linalg.solve(S, residual[..., None])[..., 0]))


def _scatter(left: FloatArray, within: FloatArray, freedom: int) -> FloatArray:
    """Return tau^2 of every run, as ``between_position_sigma`` finds it: Newton's method from below never overshoots."""
    tau2 = np.zeros(len(left))
    if not np.any(within):
        return np.asarray(np.sum(left**2, axis=1) / freedom)
    for _ in range(_NEWTON_STEPS):
        weight = 1 / (within + tau2[:, None])
        weighted = left**2 * weight
        excess = np.sum(weighted, axis=1) - freedom
        after = tau2 + np.maximum(excess, 0.0) / np.sum(weighted * weight, axis=1)
        # Where no run moves by a bit any more, none ever will.
        if np.array_equal(after, tau2):
            break
        tau2 = after
    return tau2


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutPositions:
    """Residuals of m positions that the parameters have not seen, arrays of shape (m,)."""

    name: tuple[str, ...]
    up: FloatArray
    """Measured direction of "up" in the body frame, shape (m, 3)."""
    residual_m_s2: FloatArray
    before_m_s2: FloatArray
    """The same with the preset; NaN without one."""
    sigma_m_s2: FloatArray
    """Forecast, 1 sigma; NaN where the parameter file does not know its own uncertainty."""
    misfit: float
    """Mean square in units of the forecast, correlations between positions allowed for; 1 is as forecast."""
    misfit_limit: float
    """Exceeded by chance in 1 of 20 checks."""
    how: str
    """In words: which positions, and who predicted them."""
    chance: float = float("nan")
    """Probability of a misfit at least so large where instrument and uncertainty are as stated; NaN where not known."""
    turn_on_m_s2: float = float("nan")
    """Turn-on typical of the instrument's grade, 1 sigma; NaN where it does not explain the misfit, or is not known."""
    is_own: bool = False
    """Whether the positions are those of the calibration."""
    objection: str = ""
    """Why the parameters fail, whatever is required: a sentence, empty where nothing speaks against them."""
    hidden: str = ""
    """Why the residuals prove nothing of an axis: a sentence, empty where an error of scale or bias would show on each."""

    @property
    def rms_m_s2(self) -> float:
        """Root mean square of ``residual_m_s2``."""
        return _rms(self.residual_m_s2)

    @property
    def before_rms_m_s2(self) -> float:
        """Root mean square of ``before_m_s2``."""
        return _rms(self.before_m_s2)

    @property
    def forecast_rms_m_s2(self) -> float:
        """Root mean square of ``sigma_m_s2``: what the residual should be about."""
        return _rms(self.sigma_m_s2)

    @property
    def as_forecast(self) -> bool:
        """Whether the residuals are no larger than the stated uncertainty allows."""
        return not self.objection and self.misfit <= self.misfit_limit

    @property
    def words(self) -> str:
        """The misfit in a sentence, or the objection; empty where there is no forecast."""
        if self.objection:
            return self.objection
        if not np.isfinite(self.misfit):
            return ""
        figures = sentence("left_out.figures", misfit=self.misfit, limit=self.misfit_limit)
        if self.as_forecast:
            tells = "left_out.as_forecast" if self.misfit_limit < _TELLS_LITTLE else "left_out.tells_little"
            return sentence(tells, figures=figures)
        if np.isfinite(self.turn_on_m_s2):
            return sentence("left_out.turn_on", figures=figures, turn_on_mg=self.turn_on_m_s2 / MILLI_G_M_S2)
        if self.chance >= STRONG:
            again = sentence("left_out.again_own" if self.is_own else "left_out.again_other")
            return sentence("left_out.larger", one_of=1 / self.chance, figures=figures, again=again)
        changed = "left_out.cause_foreign" if self.misfit > FOREIGN else "left_out.cause_changed"
        cause = sentence("left_out.cause_own" if self.is_own else changed)
        return sentence("left_out.defect", one_of=1 / STRONG, figures=figures, cause=cause)


def check_positions(
    calibration: Calibration,
    observations: Observations,
    gravity: Gravity,
    before: AccelerometerParameters | None = None,
    *,
    grade: str = "",
) -> LeftOutPositions:
    """Return what a calibration makes of positions of another session, by an instrument of this grade where it is known.

    Raises
    ------
    CalibrationError
        If there is no position, or an output is not finite.
    """
    _require_finite(observations)
    residual, S = _residual(calibration, observations, gravity)
    m = len(observations)
    # With no residual to spare F has no limit at all; that of one degree of freedom is the widest there is.
    freedom, misfit = max(calibration.quality.degrees_of_freedom, 1), _misfit(residual, S)
    limit = f_limit_95(m, freedom)
    # Another session is another power-on.
    turn_on = GRADES[grade].accelerometer.turn_on if grade else 0.0
    by_bias = _derivatives(calibration.accelerometer, observations).jacobian[:, BIAS]
    explains = misfit > limit >= _misfit(residual, S + turn_on**2 * by_bias @ by_bias.T)
    axes = _hidden_axes(calibration.accelerometer, observations, gravity)
    sides = [f"+{axis} up and -{axis} up" for axis in axes]
    return LeftOutPositions(
        name=observations.name,
        up=_up(calibration, observations),
        residual_m_s2=residual,
        before_m_s2=_residual_of(before, observations, gravity),
        sigma_m_s2=np.sqrt(np.diag(S)),
        misfit=misfit,
        misfit_limit=limit,
        how=sentence("left_out.other_session", found=m),
        chance=f_tail(m, freedom, misfit),
        turn_on_m_s2=turn_on if explains else np.nan,
        hidden=sentence("left_out.hidden", found=m, axes=axes, limit=WEAKEST_COLUMN, sides=sides) if axes else "",
    )


def contradiction(
    calibration: Calibration, observations: Observations, before: AccelerometerParameters | None = None
) -> LeftOutPositions | None:
    """Hold parameters against the positions they are said to come from; None where solving these again gives the same.

    Compared is the corrected specific force at each position, in sigma of the parameters solved again: that knows no gauge, and
    the error of gravity, which is in both, cancels. Methods with costs of their own may differ by ``AGREEMENT_SIGMA``.

    Raises
    ------
    CalibrationError
        If an output is not finite, or the positions cannot be calibrated from.
    """
    _require_finite(observations)
    gravity, again = calibration.gravity, _again(calibration, observations)
    stated, solved = (_residual_of(each.accelerometer, observations, gravity) for each in (calibration, again))
    sigma = np.sqrt(np.diag(_forecast(again, _derivatives(again.accelerometer, observations))))
    known = np.where(np.isfinite(sigma), sigma, _rms(solved))
    apart = float(np.max(np.abs(stated - solved) / (known + _ROUNDING_M_S2)))
    # NaN, of parameters that give no specific force here, is no agreement.
    if apart <= AGREEMENT_SIGMA:
        return None
    m = len(observations)
    stated_ug, solved_ug = _rms(stated) / MICRO_G_M_S2, _rms(solved) / MICRO_G_M_S2
    objection = sentence(
        "left_out.contradiction", stated_ug=stated_ug, found=m, solved_ug=solved_ug, apart=apart, limit=AGREEMENT_SIGMA
    )
    how = sentence("left_out.as_left", found=m)
    as_stated = check_positions(calibration, observations, gravity, before)
    return replace(as_stated, how=how, misfit=float("nan"), chance=float("nan"), is_own=True, objection=objection)


def cross_validate(
    calibration: Calibration,
    observations: Observations,
    hold_out: int | None = None,
    before: AccelerometerParameters | None = None,
) -> LeftOutPositions:
    """Return residuals of positions each predicted by a calibration that has not seen it.

    Parameters
    ----------
    calibration : Calibration
        From these observations; its model and signs are kept.
    observations : Observations
    hold_out : int, optional
        Positions left out at a time. Default: ``HOLD_OUT``, or as many as leave a residual to spare and can be calibrated from.
    before : AccelerometerParameters, optional

    Raises
    ------
    UsageError
        If no more positions would be left than parameters are fitted to them.
    CalibrationError
        If those left cannot be calibrated from.
    """
    _require_finite(observations)
    # Each group would be fitted without the drift that all of them show together.
    observations = without_drift(observations, calibration)
    before_m_s2 = _residual_of(before, observations, calibration.gravity)
    calibration, observations = _without_higher(calibration, observations)
    # Groups are fitted without drift and higher terms, so the calibration may count more parameters: a fit counts them.
    m, fewest = len(observations), _again(calibration, observations).quality.parameters_fitted + 1
    # The scatter is that of the residuals: a fit with none to spare has rounding only, and so would the limit.
    most = m - fewest
    asked = [*range(min(HOLD_OUT, most), 0, -1)] if hold_out is None else [hold_out]
    if not (asked and 1 <= asked[0] <= most):
        key = "left_out.hold_out" if most > 0 else "left_out.none_to_spare"
        raise UsageError(sentence(key, hold_out=hold_out, positions=m, fewest=fewest, most=most))
    hold_out, groups, solved = _without_groups(calibration, observations, asked)
    residual, misfit, sigma = np.empty(m), 0.0, np.empty(m)
    for group, others in zip(groups, solved, strict=True):
        residual[group], S = _residual(others, observations[group], calibration.gravity)
        sigma[group] = np.sqrt(np.diag(S))
        misfit += _misfit(residual[group], S) * int(group.sum()) / m
    by_chance = _simulated_misfits(calibration, observations, groups, [each.quality.parameters_fitted for each in solved])
    return LeftOutPositions(
        name=observations.name,
        up=_up(calibration, observations),
        residual_m_s2=residual,
        before_m_s2=before_m_s2,
        sigma_m_s2=sigma,
        misfit=misfit,
        misfit_limit=float(np.quantile(by_chance, 0.95)),
        how=sentence("left_out.cross_validated", found=m, hold_out=hold_out),
        # The check itself counts as one of the runs: a chance of zero is more than any number of runs can show.
        chance=float((1 + np.count_nonzero(by_chance >= misfit)) / (1 + len(by_chance))),
        is_own=True,
    )


def _without_groups(
    calibration: Calibration, observations: Observations, asked: Sequence[int]
) -> tuple[int, list[NDArray[np.bool_]], list[Calibration]]:
    """Return the first of these numbers of positions that can be left out at a time, the groups, and what the others show."""
    *larger, least = asked

    def solved(hold_out: int) -> tuple[int, list[NDArray[np.bool_]], list[Calibration]]:
        count = -(-len(observations) // hold_out)
        # Every count-th position: neighbours in time, which drift alike, part ways.
        groups = [np.arange(len(observations)) % count == first for first in range(count)]
        return hold_out, groups, [*_without_each(calibration, observations, groups)]

    for hold_out in larger:
        # A quadratic term asks more of those left than their number.
        with suppress(CalibrationError):
            return solved(hold_out)
    return solved(least)


def _without_each(
    calibration: Calibration, observations: Observations, groups: list[NDArray[np.bool_]]
) -> Iterator[Calibration]:
    """Yield the calibration from the positions without each group."""
    for group in one_by_one("solving without some positions", groups):
        try:
            yield _again(calibration, observations[~group])
        except CalibrationError as error:
            names = [observations.name[row] for row in np.flatnonzero(group)]
            without = sentence("left_out.without", names=names, positions=len(observations), error=error.message)
            raise CalibrationError(without, error.reason, **error.values) from error


def _rms(values: FloatArray) -> float:
    # NaN where any value is: a position without a specific force must not leave the others' figure.
    return float(np.sqrt(np.mean(values**2)))


def _require_finite(observations: Observations) -> None:
    if not len(observations):
        raise CalibrationError(sentence("left_out.no_position"))
    for row in np.flatnonzero(~np.isfinite(observations.mean_raw).all(axis=1)):
        mean = observations.mean_raw[row].tolist()
        raise CalibrationError(sentence("left_out.not_finite", position=observations.name[row], mean=mean), Reason.NOT_FINITE)


def _without_higher(calibration: Calibration, observations: Observations) -> tuple[Calibration, Observations]:
    """Return both without higher terms, which the groups would be fitted without: all positions show them together."""
    used = calibration.accelerometer
    if used.higher is None:
        return calibration, observations
    raw = without_higher(used, observations.mean_raw)
    return replace(calibration, accelerometer=replace(used, higher=None)), replace(observations, mean_raw=raw)


def _again(calibration: Calibration, observations: Observations) -> Calibration:
    return calibrate_accelerometer(
        observations,
        calibration.gravity,
        model="quadratic" if calibration.quadratic_fitted else "linear",
        preset=calibration.accelerometer,
        quadratic_axes=calibration.accelerometer.quadratic_axes,
        raw_zero=calibration.accelerometer.raw_zero,
    )


def _derivatives(parameters: AccelerometerParameters, observations: Observations) -> NormDerivatives:
    raw = observations.mean_raw - parameters.raw_zero
    return norm_derivatives(to_vector(parameters), raw, parameters.quadratic_axes, parameters.higher)


def _hidden_axes(parameters: AccelerometerParameters, observations: Observations, gravity: Gravity) -> list[str]:
    """Return the axes on which an error of scale or bias may leave these residuals small, by the rule of ``solve``."""
    columns = LOWER_GAUGE_COLUMNS[:6]
    scaled = _derivatives(parameters, observations).jacobian * parameter_scale(to_vector(parameters), gravity.gravity_m_s2)
    lengths = unexplained_lengths(scaled[:, columns], WEAKEST_COLUMN)
    # NaN, of parameters that give no specific force here, shows nothing.
    shown = {column for column, length in zip(columns, lengths, strict=True) if length > WEAKEST_COLUMN}
    return sorted({ACCELEROMETER_NAMES[column][-1] for column in columns if column not in shown})


def _up(calibration: Calibration, observations: Observations) -> FloatArray:
    return unit_vectors(_derivatives(calibration.accelerometer, observations).a)


def _residual_of(parameters: AccelerometerParameters | None, observations: Observations, gravity: Gravity) -> FloatArray:
    if parameters is None:
        return np.full(len(observations), np.nan)
    return _derivatives(parameters, observations).norm - gravity.gravity_m_s2


def _within(at: NormDerivatives, observations: Observations) -> FloatArray:
    """Return the variance of each mean's norm from the noise within its hold, shape (m,)."""
    return within_variance(at.raw_gradient, known_covariance(observations.covariance_raw))


def _residual(calibration: Calibration, observations: Observations, gravity: Gravity) -> tuple[FloatArray, FloatArray]:
    """Return r, shape (m,), and S, shape (m, m)."""
    at = _derivatives(calibration.accelerometer, observations)
    one_place = abs(gravity.gravity_m_s2 - calibration.gravity.gravity_m_s2) < SAME_GRAVITY_M_S2
    own = calibration.quality.between_position_sigma_m_s2**2 + _within(at, observations)
    S = _forecast(calibration, at, one_place=one_place) + np.diag(own) + (0.0 if one_place else gravity.sigma_m_s2**2)
    return at.norm - gravity.gravity_m_s2, S


def _forecast(calibration: Calibration, at: NormDerivatives, *, one_place: bool = True) -> FloatArray:
    """Return the covariance of the residuals as far as the parameters make them, shape (m, m)."""
    J = np.column_stack([at.jacobian, np.full(len(at.norm), -1.0 if one_place else 0.0)])
    return np.asarray(J @ calibration.covariance_in((*ACCELEROMETER_NAMES, GRAVITY_NAME)) @ J.T)


def _misfit(residual: FloatArray, S: FloatArray) -> float:
    if not np.isfinite(S).all():
        return float("nan")
    return float(residual @ np.linalg.solve(S + np.eye(len(S)) * _TINY, residual)) / len(residual)
