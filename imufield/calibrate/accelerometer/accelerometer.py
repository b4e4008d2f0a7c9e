"""Calibrate an accelerometer from the outputs of still positions: the one call behind ``imufield solve``.

Steps: check the observations; start in closed form; ask what the positions can show; fit in the lower gauge, without and with
the quadratic term (``fit``); choose the model (``model_choice``); turn into the wanted gauge; propagate the covariance
(``covariance``); judge (``quality``).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.accelerometer.covariance import Uncertainty, all_shares, is_known, propagate
from imufield.calibrate.accelerometer.ellipsoid_start import (
    FEWEST_FOR_MISALIGNMENT,
    FEWEST_FOR_QUADRATIC,
    FEWEST_FOR_SCALE_AND_BIAS,
    find_signs,
)
from imufield.calibrate.accelerometer.fit import Fit, FitData, fit, summarise
from imufield.calibrate.accelerometer.model_choice import ChosenModel, choose_model, find_origin, left_out_terms
from imufield.calibrate.accelerometer.quality import Evidence, common_scale_ratio, judge, refuse_saturation
from imufield.calibrate.accelerometer.unfitted_terms import unshown
from imufield.calibrate.model.budget import picked
from imufield.calibrate.model.gauge import change_gauge, intrinsic, make_intrinsic
from imufield.calibrate.model.grades import Grade, find_grade
from imufield.calibrate.model.higher_terms import higher_scale
from imufield.calibrate.model.models import (
    PARAMETERS,
    SCALE,
    from_vector,
    norm_derivatives,
    to_vector,
)
from imufield.calibrate.model.observability import (
    LOWER_GAUGE_COLUMNS,
    Observability,
    observe,
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
)
from imufield.calibrate.model.uncertainty import known_covariance
from imufield.dataclass import replace
from imufield.earth import STANDARD_GRAVITY_M_S2, Gravity
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

EQUATIONS = {
    "sensing": "N - raw_zero = K (T a + b) + K2 (T a)^2",
    "body": "N - raw_zero = K (T a + b) + K2 a^2",
}
HIGHER_EQUATIONS = {
    "sensing": "N - raw_zero = K (f + b) + K2 f^2, f = T a + h(T a)",
    "body": "N - raw_zero = K (f + b) + K2 (T^-1 f)^2, f = T a + h(T a)",
}


def calibrate_accelerometer(  # noqa: PLR0913 (the settings of `solve`, by keyword)
    observations: Observations,
    gravity: Gravity,
    *,
    model: ModelChoice = "auto",
    gauge: Gauge | None = None,
    preset: AccelerometerParameters | None = None,
    quadratic_axes: QuadraticAxes = "sensing",
    raw_zero: FloatArray | float | None = None,
    grade: str | None = None,
    seed: int = 0,
) -> Calibration:
    """Calibrate from position means.

    Parameters
    ----------
    observations : Observations
        At least six positions; their covariances weight them where all are known, otherwise all weigh the same.
    gravity : Gravity
        Its sigma enters the covariance as a common scale.
    model : {"auto", "linear", "quadratic", "extended"}
    gauge : {"preset", "lower", "upper", "symmetric"}, optional
        Default: "preset" where there is one, else "lower".
    preset : AccelerometerParameters, optional
        Parameters in force before: signs, frame, and values of what the positions cannot show.
    quadratic_axes : {"sensing", "body"}
    raw_zero : float or ndarray, shape (3,), optional
        Mid-scale output, raw unit. Default: the preset's, else zero.
    grade : {"navigation", "tactical", "industrial", "mems"}, optional
        Whose typical errors stand in the uncertainty for what these positions do not show; without it nothing does.
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
    usual_zero = 0.0 if preset is None else preset.raw_zero
    zero = np.full(3, usual_zero if raw_zero is None else raw_zero, dtype=np.float64)
    typical = None if grade is None else find_grade(grade)
    data = _checked_data(observations, gravity, zero, quadratic_axes, typical=typical)
    before = None if preset is None else _checked_preset(preset)
    signs = find_signs(data.raw, observations.direction, None if before is None else before[SCALE])
    origin, observability = find_origin(data, signs.sign, before, model)
    chosen = choose_model(data, origin, observability, model, observations=observations)
    if len(observability.free) == len(LOWER_GAUGE_COLUMNS):
        chosen = replace(chosen, left_out=left_out_terms(data, chosen, typical))
    refuse_saturation(observations.mean_raw, chosen.fit.residual_m_s2)
    wanted: Gauge = gauge or ("lower" if preset is None else "preset")
    fitted, to_gauge = _in_gauge(data, chosen, wanted, before)
    derivatives = norm_derivatives(chosen.fit.vector, data.raw, quadratic_axes, chosen.fit.higher)
    up = derivatives.a / derivatives.norm[:, None]
    is_open = _open_entries(chosen, has_preset=preset is not None)
    hidden = unshown(fitted, chosen, typical, up, is_open=is_open, to_gauge=to_gauge, gravity_m_s2=gravity.gravity_m_s2)
    known = propagate(fitted, chosen, data, gravity, hidden=hidden, to_gauge=to_gauge)
    evidence = Evidence(
        observations=observations,
        gravity=gravity,
        data=data,
        chosen=chosen,
        fitted=fitted,
        known=known,
        hidden=hidden,
        observability=observe(derivatives, chosen.fit.vector, gravity.gravity_m_s2, quadratic=chosen.quadratic),
        unobservable=_unobservable(known.sigma, observability),
        sign_source=signs.source,
        scale_ratio=None if before is None else common_scale_ratio(fitted.vector[SCALE], before[SCALE]),
        grade=grade,
    )
    keep = np.append(np.isfinite(known.sigma), True)
    return Calibration(
        accelerometer=replace(from_vector(fitted.vector, zero, quadratic_axes), higher=fitted.higher),
        accelerometer_sigma=replace(from_vector(known.sigma, None, quadratic_axes), higher=known.higher_sigma),
        accelerometer_raw_unit=observations.units.accelerometer_rate_unit,
        equation=(EQUATIONS if fitted.higher is None else HIGHER_EQUATIONS)[quadratic_axes],
        gauge=wanted,
        intrinsic=_intrinsic(fitted.vector, data, known),
        covariance_names=tuple(name for name, kept in zip((*ACCELEROMETER_NAMES, GRAVITY_NAME), keep, strict=True) if kept),
        covariance=known.covariance[np.ix_(keep, keep)],
        budget=picked(all_shares(known, hidden, int(is_open[:3].sum())), np.flatnonzero(keep).tolist()),
        gravity=gravity,
        positions=PositionResult(
            residual_m_s2=fitted.residual_m_s2,
            leave_one_out_m_s2=evidence.leave_one_out_m_s2,
            leverage=known.spread.leverage,
            used=np.ones(len(observations), dtype=np.bool_),
            bias_drift_m_s2=fitted.drift_m_s2,
        ),
        solver=summarise(fitted.solved, "least squares", seed),
        quality=judge(evidence),
        quadratic_fitted=chosen.quadratic,
        unobservable=evidence.unobservable,
        left_out=hidden.left_out,
    )


def _unobservable(sigma: FloatArray, observability: Observability) -> tuple[str, ...]:
    """Return the names of what the positions do not show; a quadratic term that is left out on purpose is not among them."""
    names = (name for name, known in zip(ACCELEROMETER_NAMES, np.isfinite(sigma), strict=True) if not known)
    return tuple(name for name in names if "quadratic" not in name or name in observability.unobservable)


def _open_entries(chosen: ChosenModel, *, has_preset: bool) -> NDArray[np.bool_]:
    """Return which entries the positions leave open: three misalignments, three quadratic terms, shape (6,)."""
    entries = LOWER_GAUGE_COLUMNS[6:]
    # A quadratic term that was asked for at the gate is in the covariance, and a preset knows what these positions do not show.
    known = {*chosen.free, *(entries[3:] if chosen.is_quadratic_tested else ())}
    return np.array([not has_preset and entry not in known for entry in entries])


def _intrinsic(vector: FloatArray, data: FitData, known: Uncertainty) -> Intrinsic:
    numbers, J = intrinsic(vector, data.quadratic_axes)
    variance = np.sum((J @ known.covariance[:PARAMETERS, :PARAMETERS]) * J, axis=1)
    K, g = np.abs(vector[SCALE]), data.gravity_m_s2
    shown = is_known(J @ known.by_left_out, np.concatenate([K / g, K, np.full(3, 1 / g), K / g**2]))
    return make_intrinsic(numbers, np.where(shown, np.sqrt(np.maximum(variance, 0.0)), np.nan))


def _checked_data(
    observations: Observations, gravity: Gravity, zero: FloatArray, axes: QuadraticAxes, *, typical: Grade | None
) -> FitData:
    m = len(observations)
    if m < FEWEST_FOR_SCALE_AND_BIAS:
        needed = {
            "needed": FEWEST_FOR_SCALE_AND_BIAS,
            "misalignment": FEWEST_FOR_MISALIGNMENT,
            "quadratic": FEWEST_FOR_QUADRATIC,
        }
        raise CalibrationError(sentence("accelerometer.too_few", positions=m, **needed), Reason.TOO_FEW)
    for row in np.flatnonzero(~np.isfinite(observations.mean_raw).all(axis=1)):
        position, output = observations.name[row], observations.mean_raw[row].tolist()
        lost = sentence("accelerometer.not_finite", position=position, number=row + 1, count=m, output=output)
        raise CalibrationError(lost, Reason.NOT_FINITE)
    raw = observations.mean_raw - zero
    require_outputs(raw, observations.name)
    require_space(raw)
    covariance = known_covariance(observations.covariance_raw)
    return FitData(
        raw=raw,
        covariance_raw=covariance,
        gravity_m_s2=gravity.gravity_m_s2,
        quadratic_axes=axes,
        least_scatter_m_s2=0.0 if typical is None else typical.scatter_m_s2,
        typical_quadratic_m_s2=math.inf if typical is None else typical.quadratic * STANDARD_GRAVITY_M_S2,
    )


def _checked_preset(preset: AccelerometerParameters) -> FloatArray:
    vector = to_vector(preset)
    K = preset.scale
    if not np.isfinite(vector).all() or np.any(K == 0):
        raise UsageError(sentence("accelerometer.incomplete_preset", scale=K.tolist()))
    if np.prod(np.sign(K)) < 0 and np.any(K > 0):
        raise CalibrationError(sentence("accelerometer.left_handed_preset", scale=K.tolist()), Reason.HANDEDNESS)
    change_gauge(vector, "lower")  # raises where the sensing axes are no right-handed triad
    return vector


def _in_gauge(data: FitData, chosen: ChosenModel, gauge: Gauge, before: FloatArray | None) -> tuple[Fit, FloatArray]:
    change = change_gauge(chosen.fit.vector, gauge, before)
    basis = change.jacobian @ chosen.fit.basis
    if data.quadratic_axes == "body" and np.any(change.vector[12:]) and gauge != "lower":
        # The turn is exact on sensing axes only; the printed form needs a few more steps from there.
        columns = None if chosen.drift is None else chosen.drift.columns
        combinations = higher_scale(data.gravity_m_s2)[:, None] * chosen.higher if chosen.higher.size else None
        return fit(data, change.vector, basis[:, : len(chosen.free)], drift=columns, higher=combinations), change.jacobian
    higher = None if chosen.fit.higher is None else chosen.fit.higher.turned(change.vector[SCALE] / chosen.fit.vector[SCALE])
    return replace(chosen.fit, vector=change.vector, basis=basis, higher=higher), change.jacobian
