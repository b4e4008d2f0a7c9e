"""Which of the 15 parameters are fitted: what the positions can show, and what the data need.

The model choice "auto" keeps the quadratic term where an F test on its entries together says 95 %. Where it does not, the
term may still be there, hidden in scale and bias, so the change ``d = p_quadratic - p_linear`` enters the covariance as
``F / (1 + F) d d^T``: little where the estimate is mere noise, nearly all where it just failed the test. Simulated with 24
positions, error over sigma of the bias then has an RMS of 0.83 where there is no such term and 1.7 at worst, for a term the
size of its own uncertainty (0.72 and 1.5 with all of ``d``, 1.2 and 3.2 with none). Only the quadratic model is honest for
every size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.fit import Fit, FitData, column_basis, fit
from imufield.calibrate.gauge import change_gauge
from imufield.calibrate.models import MISALIGNMENT, PARAMETERS, QUADRATIC, NormDerivatives, norm_derivatives
from imufield.calibrate.observability import Observability, observe, require_scale_and_bias
from imufield.calibrate.result import ACCELEROMETER_NAMES, ModelChoice
from imufield.calibrate.start import FEWEST_FOR_MISALIGNMENT, FEWEST_FOR_QUADRATIC, closed_form_start
from imufield.calibrate.uncertainty import f_limit_95, influence
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray

_FIRST_QUADRATIC = QUADRATIC.start
_MISALIGNMENT_ENTRIES = range(MISALIGNMENT.start, MISALIGNMENT.stop)


@dataclass(frozen=True, slots=True)
class Chosen:
    """The model that was kept, in the lower gauge."""

    fit: Fit
    free: tuple[int, ...]
    """Fitted parameters, indices into ACCELEROMETER_NAMES."""
    quadratic: bool
    doubt: FloatArray
    """Change that the rejected quadratic term would cause, times the root of its share; shape (15,)."""
    sentence: str


def find_origin(
    data: FitData, sign: FloatArray, preset: FloatArray | None, model: ModelChoice
) -> tuple[FloatArray, Observability]:
    """Return a start in the lower gauge and what the positions show from there.

    What will not be fitted has the preset's value, or zero.

    Parameters
    ----------
    data : FitData
    sign : ndarray, shape (3,)
        Signs of the scales.
    preset : ndarray, shape (15,), optional
        In any gauge.
    model : {"auto", "linear", "quadratic"}

    Raises
    ------
    CalibrationError
        If not even scale and bias of each axis can be seen.
    """
    origin = _rough_origin(data, sign, preset, model)
    derivatives = norm_derivatives(origin, data.raw, data.quadratic_axes)
    _require_forces(derivatives, data)
    seen = observe(derivatives, origin, data.gravity_m_s2, quadratic=model != "linear")
    require_scale_and_bias(seen)
    seen = _enough_positions(seen, len(data.raw))
    if sum(k in _MISALIGNMENT_ENTRIES for k in seen.free) == 3:
        full = closed_form_start(data.raw, data.gravity_m_s2, sign)
        origin = np.concatenate([full[:_FIRST_QUADRATIC], origin[QUADRATIC]])
    return origin, seen


def _rough_origin(data: FitData, sign: FloatArray, preset: FloatArray | None, model: ModelChoice) -> FloatArray:
    origin = closed_form_start(data.raw, data.gravity_m_s2, sign, misalignment=False)
    if preset is not None:
        lower = change_gauge(preset, "lower").vector
        origin[MISALIGNMENT] = lower[MISALIGNMENT]
        if model != "linear":
            origin[QUADRATIC] = lower[QUADRATIC]
    return origin


def _require_forces(derivatives: NormDerivatives, data: FitData) -> None:
    """Refuse outputs that are far from what a still accelerometer gives, so far that the model has no inverse there."""
    for row in np.flatnonzero(~np.isfinite(derivatives.jacobian).all(axis=1)):
        raise CalibrationError(
            f"position {row + 1} of {len(data.raw)} has the output {data.raw[row].tolist()}, which no specific force near "
            f"{data.gravity_m_s2:g} m/s^2 explains beside the others; retake it, or check columns, raw unit and preset",
            Reason.BOUNDS,
            position=int(row) + 1,
        )


def _enough_positions(seen: Observability, positions: int) -> Observability:
    """Take out what this number of positions can at best fit without a single one to spare for it."""
    missing: set[int] = set()
    if positions < FEWEST_FOR_MISALIGNMENT:
        missing.update(_MISALIGNMENT_ENTRIES)
    if positions < FEWEST_FOR_QUADRATIC:
        missing.update(range(_FIRST_QUADRATIC, PARAMETERS))
    names = tuple(ACCELEROMETER_NAMES[k] for k in seen.free if k in missing)
    free = tuple(k for k in seen.free if k not in missing)
    return replace(seen, free=free, unobservable=(*seen.unobservable, *names))


def choose_model(data: FitData, origin: FloatArray, seen: Observability, model: ModelChoice) -> Chosen:
    """Fit what was asked for, or, with "auto", what is significant.

    Raises
    ------
    CalibrationError
        If the quadratic model was asked for and the positions cannot show it.
    """
    quadratic_free = tuple(k for k in seen.free if k >= _FIRST_QUADRATIC)
    if model == "quadratic" and len(quadratic_free) < 3:
        hidden = tuple(name for name in seen.unobservable if "quadratic" in name)
        raise CalibrationError(
            f"{len(data.raw)} positions cannot show {', '.join(hidden)}: that takes at least {FEWEST_FOR_QUADRATIC} with faces "
            "and edges or corners; add such positions, or use the linear model",
            Reason.UNOBSERVABLE,
            unobservable=hidden,
        )
    if not quadratic_free:
        reason = "as asked" if model == "linear" else "because the positions do not show more"
        return _linear(data, origin, seen, f"the model is linear, {reason}")
    quadratic = fit(data, origin, column_basis(origin, seen.free, data.gravity_m_s2))
    if model == "quadratic":
        return Chosen(quadratic, seen.free, True, np.zeros(PARAMETERS), "the quadratic term is fitted, as asked")
    return _decide(data, origin, seen, quadratic, quadratic_free)


def _linear(data: FitData, origin: FloatArray, seen: Observability, sentence: str) -> Chosen:
    # Zero where the term could be fitted and is not wanted; the preset's value where it cannot be seen.
    plain = origin.copy()
    plain[[k for k in seen.free if k >= _FIRST_QUADRATIC]] = 0.0
    free = tuple(k for k in seen.free if k < _FIRST_QUADRATIC)
    fitted = fit(data, plain, column_basis(plain, free, data.gravity_m_s2))
    return Chosen(fitted, free, False, np.zeros(PARAMETERS), sentence)


def _decide(data: FitData, origin: FloatArray, seen: Observability, quadratic: Fit, entries: tuple[int, ...]) -> Chosen:
    F = _f_statistic(quadratic, entries)
    limit = f_limit_95(len(entries), quadratic.degrees_of_freedom)
    figures = f"F = {F:.1f}, 95 % limit {limit:.1f}"
    if limit < F:
        sentence = f"the quadratic term is kept: it is significant ({figures})"
        return Chosen(quadratic, seen.free, True, np.zeros(PARAMETERS), sentence)
    sentence = (
        f"the quadratic term is left out: it is not significant ({figures}); what it may hide in scale and bias is in "
        "their uncertainty"
    )
    linear = _linear(data, origin, seen, sentence)
    change = quadratic.vector - linear.fit.vector
    change[list(entries)] = 0.0
    return replace(linear, doubt=np.sqrt(F / (1 + F)) * change)


def _f_statistic(fitted: Fit, entries: tuple[int, ...]) -> float:
    """Return F of some parameters, the last coordinates of the fit, against zero."""
    n = len(entries)
    sigma = fitted.sigma_m_s2
    covariance = influence(fitted.residual_m_s2 / sigma, fitted.jacobian / sigma[:, None]).covariance[-n:, -n:]
    z = fitted.vector[list(entries)] / fitted.basis[list(entries), range(-n, 0)]
    return float(z @ np.linalg.solve(covariance, z)) / n
