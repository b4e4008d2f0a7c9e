"""Choice of the accelerometer model: which of the 15 parameters the positions can show, and which the data need.

The model choice "auto" keeps the quadratic term where it is significant: an F test on its entries together, or a t test on
the largest of them (Bonferroni), says 95 %. Where it is not, the term may still be there, hidden in scale and bias. What is
known then of the truth is what the quadratic model says, so the stated covariance is that model's plus ``d d^T`` with the
change ``d = p_quadratic - p_linear``. Simulated with 24 positions in eighths of a turn, error over sigma of the bias then has
an RMS of at most 1.2 for a term of any size; with ``d d^T`` alone it reaches 1.7 for a term the size of its own uncertainty,
with nothing 3.2. The price: where there is no such term the bias is three times better than stated. Who knows that asks
for the linear model.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from imufield.calibrate.accelerometer.fit import Fit, FitData, column_basis, fit
from imufield.calibrate.accelerometer.start import FEWEST_FOR_MISALIGNMENT, FEWEST_FOR_QUADRATIC, closed_form_start
from imufield.calibrate.model.gauge import change_gauge
from imufield.calibrate.model.models import MISALIGNMENT, PARAMETERS, QUADRATIC, norm_derivatives
from imufield.calibrate.model.observability import Observability, observe, require_scale_and_bias
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, ModelChoice
from imufield.calibrate.model.uncertainty import f_limit_95, influence, student_factor, told_apart
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_FIRST_QUADRATIC = QUADRATIC.start
_MISALIGNMENT_ENTRIES = range(MISALIGNMENT.start, MISALIGNMENT.stop)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenModel:
    """The model that was kept, in the lower gauge."""

    fit: Fit
    free: tuple[int, ...]
    """Fitted parameters, indices into ACCELEROMETER_NAMES."""
    quadratic: bool
    hidden_root: FloatArray = field(default_factory=lambda: np.zeros((PARAMETERS, 0)))
    """Root of the covariance that a rejected quadratic term adds, in columns, shape (15, k)."""
    sentence: Sentence


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
        If not even scale and bias of each axis can be observed.
    """
    origin = closed_form_start(data.raw, data.gravity_m_s2, sign, misalignment=False)
    if preset is not None:
        lower = change_gauge(preset, "lower").vector
        origin[MISALIGNMENT] = lower[MISALIGNMENT]
        if model != "linear":
            origin[QUADRATIC] = lower[QUADRATIC]
    derivatives = norm_derivatives(origin, data.raw, data.quadratic_axes)
    # Outputs so far from what a still accelerometer gives that the model has no inverse there.
    for row in np.flatnonzero(~np.isfinite(derivatives.jacobian).all(axis=1)):
        values = {"position": int(row) + 1, "count": len(data.raw), "output": data.raw[row].tolist()}
        raise CalibrationError(sentence("model_choice.unexplained", gravity_m_s2=data.gravity_m_s2, **values), Reason.BOUNDS)
    observability = observe(derivatives, origin, data.gravity_m_s2, quadratic=model != "linear")
    require_scale_and_bias(observability)
    # This number of positions could at best fit these without a single one to spare.
    missing: set[int] = set()
    if len(data.raw) < FEWEST_FOR_MISALIGNMENT:
        missing.update(_MISALIGNMENT_ENTRIES)
    if len(data.raw) < FEWEST_FOR_QUADRATIC:
        missing.update(range(_FIRST_QUADRATIC, PARAMETERS))
    names = tuple(ACCELEROMETER_NAMES[k] for k in observability.free if k in missing)
    free = tuple(k for k in observability.free if k not in missing)
    observability = replace(observability, free=free, unobservable=(*observability.unobservable, *names))
    if sum(k in _MISALIGNMENT_ENTRIES for k in free) == 3:
        full = closed_form_start(data.raw, data.gravity_m_s2, sign)
        origin = np.concatenate([full[:_FIRST_QUADRATIC], origin[QUADRATIC]])
    return origin, observability


def choose_model(data: FitData, origin: FloatArray, observability: Observability, model: ModelChoice) -> ChosenModel:
    """Fit what was asked for, or, with "auto", what is significant.

    Raises
    ------
    CalibrationError
        If the quadratic model was asked for and the positions cannot show it.
    """
    quadratic_free = tuple(k for k in observability.free if k >= _FIRST_QUADRATIC)
    if model == "quadratic" and len(quadratic_free) < 3:
        hidden = tuple(name for name in observability.unobservable if "quadratic" in name)
        count = len(data.raw)
        refused = sentence("model_choice.no_quadratic", count=count, unobservable=hidden, fewest=FEWEST_FOR_QUADRATIC)
        raise CalibrationError(refused, Reason.UNOBSERVABLE)
    if not quadratic_free:
        key = "model_choice.linear_as_asked" if model == "linear" else "model_choice.linear_as_shown"
        return _linear(data, origin, observability, sentence(key))
    quadratic = fit(data, origin, column_basis(origin, observability.free, data.gravity_m_s2))
    as_asked = sentence("model_choice.quadratic_as_asked")
    kept = ChosenModel(fit=quadratic, free=observability.free, quadratic=True, sentence=as_asked)
    if model == "quadratic":
        return kept
    # Keep the term where it is significant; else add what it may hide to the covariance of the linear model.
    n, entries = len(quadratic_free), list(quadratic_free)
    # The last n coordinates of the fit move the entries of the term.
    change = quadratic.vector[entries] / quadratic.basis[entries, range(-n, 0)]
    sigma = quadratic.sigma_m_s2
    C = influence(quadratic.residual_m_s2 / sigma, quadratic.jacobian / sigma[:, None]).covariance
    F = float(change @ np.linalg.solve(C[-n:, -n:], change)) / n
    t = float(np.max(np.abs(change) / np.sqrt(np.diag(C[-n:, -n:]))))
    freedom = quadratic.degrees_of_freedom
    F_limit, t_limit = f_limit_95(n, freedom), student_factor(freedom, of=n)
    figures = dict(zip(("F", "F_limit", "t", "t_limit"), (*told_apart(F, F_limit), *told_apart(t, t_limit)), strict=True))
    if F_limit < F or t_limit < t:
        return replace(kept, sentence=sentence("model_choice.quadratic_kept", **figures))
    linear = _linear(data, origin, observability, sentence("model_choice.quadratic_left_out", **figures))
    # The other coordinates hang on the last n by -C_rl C_ll^-1, so of their covariance C_rl C_ll^-1 C_lr is from those.
    root = np.linalg.solve(np.linalg.cholesky(C[-n:, -n:]), C[-n:, :-n]).T
    hidden_root = np.column_stack([quadratic.vector - linear.fit.vector, quadratic.basis[:, :-n] @ root])
    hidden_root[entries] = 0.0
    return replace(linear, hidden_root=hidden_root)


def _linear(data: FitData, origin: FloatArray, observability: Observability, why: Sentence) -> ChosenModel:
    # Zero where the term could be fitted and is not wanted; the preset's value where it cannot be observed.
    plain = origin.copy()
    plain[[k for k in observability.free if k >= _FIRST_QUADRATIC]] = 0.0
    free = tuple(k for k in observability.free if k < _FIRST_QUADRATIC)
    fitted = fit(data, plain, column_basis(plain, free, data.gravity_m_s2))
    return ChosenModel(fit=fitted, free=free, quadratic=False, sentence=why)
