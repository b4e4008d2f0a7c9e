"""Calibrate an accelerometer from the outputs of still positions: the one call behind ``imufield solve``.

Steps: check the observations; start in closed form; ask what the positions can show; fit in the lower gauge, without and with
the quadratic term; choose the model; turn into the wanted gauge; work out uncertainties; judge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.accelerometer.fit import Fit, FitData, fit
from imufield.calibrate.accelerometer.model_choice import Chosen, choose_model, find_origin
from imufield.calibrate.accelerometer.quality import Evidence, common_scale_ratio, judge, refuse_saturation
from imufield.calibrate.accelerometer.start import (
    FEWEST_FOR_MISALIGNMENT,
    FEWEST_FOR_QUADRATIC,
    FEWEST_FOR_SCALE_AND_BIAS,
    Signs,
    find_signs,
)
from imufield.calibrate.model.gauge import change_gauge, intrinsic, make_intrinsic
from imufield.calibrate.model.models import PARAMETERS, SCALE, from_vector, norm_derivatives, to_vector
from imufield.calibrate.model.observability import (
    LOWER_GAUGE_COLUMNS,
    Observability,
    observe,
    parameter_scale,
    require_outputs,
    require_space,
)
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    GRAVITY_NAME,
    AccelerometerParameters,
    Calibration,
    Gauge,
    Intrinsic,
    ModelChoice,
    PositionResult,
    QuadraticAxes,
    Quality,
    SolverSummary,
)
from imufield.calibrate.model.uncertainty import (
    Influence,
    gravity_sensitivity,
    influence,
    known_covariance,
    single_position_factors,
    single_positions,
)
from imufield.calibrate.solvers.least_squares import Loss
from imufield.earth import Gravity
from imufield.errors import CalibrationError, Reason, UsageError, counted
from imufield.samples import FloatArray

EQUATIONS = {
    "sensing": "N - raw_zero = K (T a + b) + K2 (T a)^2",
    "body": "N - raw_zero = K (T a + b) + K2 a^2",
}
# A number that takes more than this share (in scaled coordinates) of a parameter that was not fitted has no sigma.
_MIXED = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solution:
    """Everything known after the fit, in the wanted gauge."""

    observations: Observations
    gravity: Gravity
    data: FitData
    chosen: Chosen
    seen: Observability  # Of the positions, at the start.
    fit: Fit
    to_gauge: FloatArray  # d parameters in the wanted gauge / d parameters in the lower gauge, shape (15, 15).
    spread: Influence

    @property
    def scale(self) -> FloatArray:
        """Step of each parameter that weighs as 1 m/s^2, shape (15,)."""
        return parameter_scale(self.fit.vector, self.data.gravity_m_s2)


def calibrate_accelerometer(  # noqa: PLR0913 (the settings of `solve`, by keyword)
    observations: Observations,
    gravity: Gravity,
    *,
    model: ModelChoice = "auto",
    gauge: Gauge | None = None,
    preset: AccelerometerParameters | None = None,
    quadratic_axes: QuadraticAxes = "sensing",
    raw_zero: FloatArray | float | None = None,
    loss: Loss = "linear",
    seed: int = 0,
) -> Calibration:
    """Calibrate from position means.

    Parameters
    ----------
    observations : Observations
        At least six positions; their covariances weight them where all are known, otherwise all weigh the same.
    gravity : Gravity
        Its sigma enters the covariance as a common scale.
    model : {"auto", "linear", "quadratic"}
    gauge : {"preset", "lower", "upper", "symmetric"}, optional
        Default: "preset" where there is one, else "lower".
    preset : AccelerometerParameters, optional
        Parameters in force before: signs, frame, and values of what the positions cannot show.
    quadratic_axes : {"sensing", "body"}
    raw_zero : float or ndarray, shape (3,), optional
        Mid-scale output, raw unit. Default: the preset's, else zero.
    loss : {"linear", "soft_l1", "huber", "cauchy"}
        Robust losses play down positions that do not fit.
    seed : int
        Written to the result; this method draws nothing at random.

    Returns
    -------
    Calibration
        Sigmas are the roots of the diagonal of ``covariance``, the sigma of gravity included.

    Raises
    ------
    CalibrationError
        If calibration is impossible from these positions, or refused.
    UsageError
        If the gauge is "preset" and there is no preset.
    """
    zero = _raw_zero(raw_zero, preset)
    data = _checked_data(observations, gravity, zero, quadratic_axes, loss=loss)
    before = None if preset is None else _checked_preset(preset)
    signs = find_signs(data.raw, observations.direction, None if before is None else before[SCALE])
    origin, seen = find_origin(data, signs.sign, before, model)
    chosen = choose_model(data, origin, seen, model)
    refuse_saturation(observations.mean_raw, chosen.fit.residual_m_s2)
    wanted: Gauge = gauge or ("lower" if preset is None else "preset")
    fitted, to_gauge = _in_gauge(data, chosen, wanted, before)
    spread = influence(fitted.residual_m_s2 / fitted.sigma_m_s2, fitted.jacobian / fitted.sigma_m_s2[:, None])
    solution = _Solution(
        observations=observations,
        gravity=gravity,
        data=data,
        chosen=chosen,
        seen=seen,
        fit=fitted,
        to_gauge=to_gauge,
        spread=spread,
    )
    return _calibration(solution, signs, before, wanted, zero=zero, seed=seed)


def _raw_zero(raw_zero: FloatArray | float | None, preset: AccelerometerParameters | None) -> FloatArray:
    if raw_zero is None:
        return np.zeros(3) if preset is None else preset.raw_zero
    return np.full(3, raw_zero, dtype=np.float64)


def _checked_data(
    observations: Observations, gravity: Gravity, zero: FloatArray, axes: QuadraticAxes, *, loss: Loss
) -> FitData:
    m = len(observations)
    if m < FEWEST_FOR_SCALE_AND_BIAS:
        raise CalibrationError(
            f"{counted(m, 'position')} {'is' if m == 1 else 'are'} too few: scale and bias need {FEWEST_FOR_SCALE_AND_BIAS} "
            f"(each axis up and down), misalignment "
            f"{FEWEST_FOR_MISALIGNMENT}, the quadratic term {FEWEST_FOR_QUADRATIC}; take more positions, 24 is a good number",
            Reason.TOO_FEW,
            positions=m,
            needed=FEWEST_FOR_SCALE_AND_BIAS,
        )
    for row in np.flatnonzero(~np.isfinite(observations.mean_raw).all(axis=1)):
        raise CalibrationError(
            f"position {observations.name[row]} (number {row + 1} of {m}) has the mean output "
            f"{observations.mean_raw[row].tolist()}, which is not finite; remove or retake it",
            Reason.NOT_FINITE,
            position=observations.name[row],
        )
    raw = observations.mean_raw - zero
    require_outputs(raw, observations.name)
    require_space(raw)
    covariance = observations.covariance_raw if known_covariance(observations.covariance_raw) else None
    return FitData(raw=raw, covariance_raw=covariance, gravity_m_s2=gravity.gravity_m_s2, quadratic_axes=axes, loss=loss)


def _checked_preset(preset: AccelerometerParameters) -> FloatArray:
    vector = to_vector(preset)
    K = preset.scale
    if not np.isfinite(vector).all() or np.any(K == 0):
        raise UsageError(
            f"the preset has scale {K.tolist()} and is not complete; every entry must be finite and scale not zero"
        )
    if np.prod(np.sign(K)) < 0 and np.any(K > 0):
        raise CalibrationError(
            f"the preset is left-handed: one of its scales {K.tolist()} is reversed; reverse that axis in the protocol and "
            "the preset",
            Reason.HANDEDNESS,
            scale=K.tolist(),
        )
    change_gauge(vector, "lower")  # raises where the sensing axes are no right-handed triad
    return vector


def _in_gauge(data: FitData, chosen: Chosen, gauge: Gauge, before: FloatArray | None) -> tuple[Fit, FloatArray]:
    change = change_gauge(chosen.fit.vector, gauge, before)
    basis = change.jacobian @ chosen.fit.basis
    if data.quadratic_axes == "body" and np.any(change.vector[12:]) and gauge != "lower":
        # The turn is exact on sensing axes only; the printed form needs a few more steps from there.
        return fit(data, change.vector, basis), change.jacobian
    return replace(chosen.fit, vector=change.vector, basis=basis), change.jacobian


def _calibration(
    solution: _Solution, signs: Signs, before: FloatArray | None, gauge: Gauge, *, zero: FloatArray, seed: int
) -> Calibration:
    fitted, axes = solution.fit, solution.data.quadratic_axes
    covariance, factors = _joint_covariance(solution)
    known = _known(solution, np.eye(PARAMETERS), solution.scale)
    sigma = np.where(known, np.sqrt(np.diag(covariance)[:PARAMETERS]), np.nan)
    positions = _positions(solution)
    unobservable = _unobservable(solution, known)
    quality = _quality(solution, positions, signs, before, unobservable=unobservable, sigma=sigma, factors=factors)
    keep = np.append(np.isfinite(sigma), True)
    return Calibration(
        accelerometer=from_vector(fitted.vector, zero, axes),
        accelerometer_sigma=from_vector(sigma, None, axes),
        accelerometer_raw_unit=solution.observations.units.accelerometer_rate_unit,
        equation=EQUATIONS[axes],
        gauge=gauge,
        intrinsic=_intrinsic(solution, covariance),
        covariance_names=tuple(name for name, kept in zip((*ACCELEROMETER_NAMES, GRAVITY_NAME), keep, strict=True) if kept),
        covariance=covariance[np.ix_(keep, keep)],
        gravity=solution.gravity,
        positions=positions,
        solver=_summary(fitted, seed),
        quality=quality,
        quadratic_fitted=solution.chosen.quadratic,
        unobservable=unobservable,
    )


def _summary(fitted: Fit, seed: int) -> SolverSummary:
    solved = fitted.solved
    return SolverSummary(
        method="least squares",
        status=int(solved.status),
        message=solved.message,
        cost=solved.cost,
        evaluations=solved.evaluations,
        seed=seed,
    )


def _positions(solution: _Solution) -> PositionResult:
    fitted, spread = solution.fit, solution.spread
    used = np.ones(len(solution.observations), dtype=np.bool_)
    return PositionResult(fitted.residual_m_s2, spread.leave_one_out * fitted.sigma_m_s2, spread.leverage, used)


def _joint_covariance(solution: _Solution) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of 15 parameters and gravity, and the factors by which coordinates were raised."""
    fitted, spread = solution.fit, solution.spread
    factors = np.ones(fitted.basis.shape[1])
    covariance = spread.covariance
    if fitted.degrees_of_freedom > 0:
        factors = single_position_factors(spread, single_positions(spread))
        covariance = covariance * np.outer(factors, factors)
    elif solution.data.covariance_raw is None:
        covariance = np.full_like(covariance, np.nan)  # nothing says how sure anything is
    doubt = solution.to_gauge @ solution.chosen.doubt
    t = np.append(gravity_sensitivity(fitted.vector, solution.gravity.gravity_m_s2), 1.0)
    joint = np.outer(t, t) * solution.gravity.sigma_m_s2**2
    joint[:PARAMETERS, :PARAMETERS] += fitted.basis @ covariance @ fitted.basis.T + doubt @ doubt.T
    return joint, factors


def _known(solution: _Solution, derivative: FloatArray, scale: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which numbers, of given derivative by the parameters and scale, do not hang on parameters not fitted."""
    hidden = [k for k in LOWER_GAUGE_COLUMNS if k not in solution.chosen.free]
    mixed = np.abs(derivative @ solution.to_gauge[:, hidden]) * solution.scale[hidden] / scale[:, None]
    known: np.ndarray[tuple[int], np.dtype[np.bool_]] = ~np.any(mixed > _MIXED, axis=1)
    return known


def _intrinsic(solution: _Solution, covariance: FloatArray) -> Intrinsic:
    vector, g = solution.fit.vector, solution.gravity.gravity_m_s2
    values, J = intrinsic(vector, solution.data.quadratic_axes)
    variance = np.sum((J @ covariance[:PARAMETERS, :PARAMETERS]) * J, axis=1)
    K = np.abs(vector[SCALE])
    scale = np.concatenate([K / g, K, np.full(3, 1 / g), K / g**2])
    return make_intrinsic(values, np.where(_known(solution, J, scale), np.sqrt(np.maximum(variance, 0.0)), np.nan))


def _unobservable(solution: _Solution, known: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> tuple[str, ...]:
    """Name what has no sigma because the positions do not show it; a quadratic term left out on purpose is not among it."""
    return tuple(
        name
        for name, is_known in zip(ACCELEROMETER_NAMES, known, strict=True)
        if not is_known and ("quadratic" not in name or name in solution.seen.unobservable)
    )


def _quality(
    solution: _Solution,
    positions: PositionResult,
    signs: Signs,
    before: FloatArray | None,
    *,
    unobservable: tuple[str, ...],
    sigma: FloatArray,
    factors: FloatArray,
) -> Quality:
    lower, data = solution.chosen.fit.vector, solution.data
    derivatives = norm_derivatives(lower, data.raw, data.quadratic_axes)
    return judge(
        Evidence(
            name=solution.observations.name,
            gravity=solution.gravity,
            fitted=solution.fit,
            free=solution.chosen.free,
            spread=solution.spread,
            singles=single_positions(solution.spread),
            factors=factors,
            positions=positions,
            seen=observe(derivatives, lower, data.gravity_m_s2, quadratic=solution.chosen.quadratic),
            unobservable=unobservable,
            sign_source=signs.source,
            model_sentence=solution.chosen.sentence,
            covariance_known=data.covariance_raw is not None,
            scale_ratio=None if before is None else common_scale_ratio(solution.fit.vector[SCALE], before[SCALE]),
            sigma=sigma,
            temperature_degc=solution.observations.temperature_degc,
        )
    )
