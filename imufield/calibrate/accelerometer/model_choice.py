"""Choice of the accelerometer model: which of the 15 parameters the positions can show, and which terms the data need.

With the model choice "auto" the quadratic term and a drift of the bias over the session pass one gate (``f_tests``); an
admitted changes the model, and what is not sure about the choice is in the covariance. With "linear" none is admitted, the
covariance is the same, and the verdict says where the gate contradicts. Higher terms (``higher_terms``) are fitted where they
are asked for; in every other model with the quadratic term open one F test says where the residuals show them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imufield.calibrate.accelerometer.drift import FEWEST_TO_SPARE, MOST_CONFUSION, DriftForm, drift_forms
from imufield.calibrate.accelerometer.ellipsoid_start import FEWEST_FOR_MISALIGNMENT, FEWEST_FOR_QUADRATIC, closed_form_start
from imufield.calibrate.accelerometer.f_tests import LEVEL, Choice, Gate, Term, Terms
from imufield.calibrate.accelerometer.fit import Fit, FitData, column_basis, fit, fit_beside
from imufield.calibrate.model.aliasing import typical_higher
from imufield.calibrate.model.coverage_factors import f_tail
from imufield.calibrate.model.gauge import change_gauge
from imufield.calibrate.model.grades import Grade
from imufield.calibrate.model.higher_terms import KINDS, TERMS, ShownTerms, higher_scale, shown_terms
from imufield.calibrate.model.models import MISALIGNMENT, PARAMETERS, QUADRATIC, SCALE, norm_derivatives
from imufield.calibrate.model.observability import WEAKEST_COLUMN, Observability, observe, require_scale_and_bias
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, ModelChoice
from imufield.dataclass import dataclass, field, replace
from imufield.earth import MILLI_G_M_S2
from imufield.errors import CalibrationError, Reason
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

_UNTESTED: dict[ModelChoice, str] = {
    "auto": "model_choice.linear_as_shown",
    "linear": "model_choice.linear_as_asked",
    "quadratic": "model_choice.quadratic_as_asked",
}
_FIRST_QUADRATIC = QUADRATIC.start
_MISALIGNMENT_ENTRIES = range(MISALIGNMENT.start, MISALIGNMENT.stop)
_ROUNDING = 1e-12  # Ideal outputs leave nothing else, and no ratio of it means anything.
VERDICT_LEVEL = 0.005
"""Chance that a clean session loses its "good" by a test of terms: of higher ones where they are typical at most, and of drift
and quadratic term in an order that confounds them. What the gate admits by its own level is in sigma."""
# Of a position: with it, what leaving it out shows is 14 sigma. The faces of all26 have 0.96 to 0.98, as they are placed; with
# cubic and cross terms each edge of paper24 has 1, so no other position checks it.
_MOST_LEVERAGE = 0.995


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutTerms:
    """Higher terms that the residuals show and the model does not have."""

    cubic_m_s2: float
    """At 1 g, root mean square of what is shown less what the noise makes of it; 0 where nothing is."""
    cross_m_s2: float
    p: float
    """Of the F test of all of them, of each kind where the positions are too few for both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenModel:
    """The model that was kept, in the lower gauge."""

    fit: Fit
    free: tuple[int, ...]
    """Fitted parameters, indices into ACCELEROMETER_NAMES; the coordinates of a drift come after them."""
    quadratic: bool
    is_quadratic_tested: bool = False
    drift: DriftForm | None = None
    choice: Choice = Choice()  # Frozen, so one default may be shared.
    """What choosing the model makes of the covariance."""
    higher: FloatArray = field(default_factory=lambda: np.zeros((TERMS, 0)))
    """Combinations of higher terms that are fitted, in steps of ``higher_scale``, shape (12, k)."""
    left_out: LeftOutTerms | None = None
    sentences: tuple[Sentence, ...]
    cautions: tuple[Sentence, ...] = ()
    """What lowers the verdict."""


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
    model : {"auto", "linear", "quadratic", "extended"}

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
    _require_inverse(data, derivatives.jacobian)
    observability = observe(derivatives, origin, data.gravity_m_s2, quadratic=True)
    require_scale_and_bias(observability)
    # This number of positions could at best fit these without a single one to spare.
    missing: set[int] = set()
    if len(data.raw) < FEWEST_FOR_MISALIGNMENT:
        missing.update(_MISALIGNMENT_ENTRIES)
    if len(data.raw) < FEWEST_FOR_QUADRATIC:
        missing.update(range(_FIRST_QUADRATIC, PARAMETERS))
    names = tuple(ACCELEROMETER_NAMES[k] for k in observability.free if k in missing)
    free = tuple(k for k in observability.free if k not in missing)
    # What is not asked for is not missed.
    hidden = (name for name in (*observability.unobservable, *names) if model != "linear" or "quadratic" not in name)
    observability = replace(observability, free=free, unobservable=tuple(hidden))
    if sum(k in _MISALIGNMENT_ENTRIES for k in free) == 3:
        full = closed_form_start(data.raw, data.gravity_m_s2, sign)
        origin = np.concatenate([full[:_FIRST_QUADRATIC], origin[QUADRATIC]])
    return origin, observability


def _require_inverse(data: FitData, jacobian: FloatArray) -> None:
    """Refuse outputs so far from what a still accelerometer gives that the model has no inverse there."""
    for row in np.flatnonzero(~np.isfinite(jacobian).all(axis=1)):
        values = {"position": int(row) + 1, "count": len(data.raw), "output": data.raw[row].tolist()}
        raise CalibrationError(sentence("model_choice.unexplained", gravity_m_s2=data.gravity_m_s2, **values), Reason.BOUNDS)


def choose_model(
    data: FitData, origin: FloatArray, observability: Observability, model: ModelChoice, *, observations: Observations
) -> ChosenModel:
    """Fit what was asked for and, of the terms that are open, what passes the gate.

    Raises
    ------
    CalibrationError
        If the quadratic model was asked for and the positions cannot show it.
    """
    free, count = observability.free, len(data.raw)
    quadratic_free = tuple(k for k in free if k >= _FIRST_QUADRATIC)
    if model in ("quadratic", "extended") and len(quadratic_free) < 3:
        hidden = tuple(name for name in observability.unobservable if "quadratic" in name)
        refused = sentence("model_choice.no_quadratic", count=count, unobservable=hidden, fewest=FEWEST_FOR_QUADRATIC)
        raise CalibrationError(refused, Reason.UNOBSERVABLE)
    is_open = bool(quadratic_free) and count > len(free)
    if model == "extended":
        return _extended(data, origin, free)
    forms: tuple[DriftForm | None, ...] = drift_forms(observations, count - len(free)) or ((None,) if is_open else ())
    if model == "quadratic" or not forms:
        return _untested(data, origin, free, model)
    # What was asked for is fitted in full, and the others by a step from it.
    linear = _fit(data, origin, free, quadratic=False) if model == "linear" else None
    tried = [_all_terms(data, origin, free, form, linear=linear, is_quadratic_open=is_open) for form in forms]
    # Where drift may follow time or temperature, each is asked at its share of the level.
    level = LEVEL / len(tried)
    gate, form = min(zip(tried, forms, strict=True), key=lambda each: each[0].chance(each[0].all))
    p = gate.chance(gate.all)
    terms: Terms = frozenset() if linear is not None else gate.admitted(level)
    with_quadratic, kept = "quadratic" in terms, form if "drift" in terms else None
    # Where no grade says what is typical, who asks for the linear model is believed as far as the test goes.
    is_believed = linear is not None and p >= level and math.isinf(data.typical_quadratic_m_s2)
    choice = Choice() if is_believed else gate.choice(terms, data.typical_quadratic_m_s2)
    if not with_quadratic:
        choice.root[list(quadratic_free)] = 0.0
    fitted = linear or _fit(data, origin, free, quadratic=with_quadratic, drift=kept)
    said = _gate_sentences(gate, terms, is_asked=linear is not None, is_quadratic_open=is_open, level=level)
    cautions: list[Sentence] = []
    # Of clean sessions as few lose their verdict by this as by anything else; sigma allows for what is found in any case.
    is_doubtful = p * len(tried) < VERDICT_LEVEL
    if linear is not None and is_doubtful:
        said, cautions = cautions, said
    if kept is not None:
        drift_mg = fitted.drift_span_m_s2 / MILLI_G_M_S2
        said.append(sentence("model_choice.drift_kept", kind=kept.kind, drift_mg=drift_mg, p=p, limit=level))
    if terms and (factor := gate.confusion()) > MOST_CONFUSION:
        # Terms that show less may be none: then the order costs what sigma says, and nothing else.
        told = cautions if is_doubtful else said
        told.append(sentence("model_choice.confounded", factor=factor, limit=MOST_CONFUSION))
    return ChosenModel(
        fit=fitted,
        free=free if with_quadratic else tuple(k for k in free if k < _FIRST_QUADRATIC),
        quadratic=with_quadratic,
        is_quadratic_tested=is_open,
        drift=kept,
        choice=choice,
        sentences=tuple(said),
        cautions=tuple(cautions),
    )


def _gate_sentences(gate: Gate, terms: Terms, *, is_asked: bool, is_quadratic_open: bool, level: float) -> list[Sentence]:
    """Return what the gate says of the model, ``is_asked`` where the linear one was asked for."""
    p = gate.chance(gate.all)
    if is_asked and p < level:
        shift_mg = gate.bias_shift_m_s2() / MILLI_G_M_S2
        return [sentence("model_choice.linear_contradicted", p=p, limit=level, shift_mg=shift_mg)]
    if not is_quadratic_open:
        return [sentence(_UNTESTED["linear" if is_asked else "auto"])]
    # Where the drift explains what the linear model does not, the term is asked for beside it.
    if terms == {"drift"}:
        p = gate.chance(frozenset({"quadratic"}))
    left_out = "model_choice.linear_not_contradicted" if is_asked else "model_choice.quadratic_left_out"
    return [sentence("model_choice.quadratic_kept" if "quadratic" in terms else left_out, p=p, limit=level)]


def _all_terms(
    data: FitData,
    origin: FloatArray,
    free: tuple[int, ...],
    form: DriftForm | None,
    *,
    linear: Fit | None,
    is_quadratic_open: bool,
) -> Gate:
    """Return the gate with one form of drift, or none."""
    if linear is None:
        everything = _fit(data, origin, free, quadratic=True, drift=form)
    else:
        basis = column_basis(origin, free, data.gravity_m_s2)
        everything = fit_beside(data, linear, basis, None if form is None else form.columns)
        _require_inverse(data, everything.jacobian)
    columns = {k: place for place, k in enumerate(free)}
    coordinates: dict[Term, tuple[int, ...]] = {}
    value = np.zeros(everything.basis.shape[1])
    if is_quadratic_open:
        entries = [k for k in free if k >= _FIRST_QUADRATIC]
        coordinates["quadratic"] = tuple(columns[k] for k in entries)
        # The basis moves each entry by its own scale.
        value[[columns[k] for k in entries]] = everything.vector[entries] / [everything.basis[k, columns[k]] for k in entries]
    if form is not None:
        coordinates["drift"] = tuple(range(len(free), len(value)))
        value[len(free) :] = np.linalg.lstsq(form.columns, everything.drift_m_s2, rcond=None)[0].ravel()
    return Gate(everything, coordinates, value)


def _fit(data: FitData, origin: FloatArray, free: tuple[int, ...], *, quadratic: bool, drift: DriftForm | None = None) -> Fit:
    if not quadratic:
        # Zero where the term could be fitted and is not wanted; the preset's value where it cannot be observed.
        origin = origin.copy()
        origin[[k for k in free if k >= _FIRST_QUADRATIC]] = 0.0
        free = tuple(k for k in free if k < _FIRST_QUADRATIC)
    basis = column_basis(origin, free, data.gravity_m_s2)
    fitted = fit(data, origin, basis, drift=None if drift is None else drift.columns)
    _require_inverse(data, fitted.jacobian)
    return fitted


def _untested(data: FitData, origin: FloatArray, free: tuple[int, ...], model: ModelChoice) -> ChosenModel:
    """Return the model that was asked for, or the linear one where nothing can be tested."""
    quadratic = model == "quadratic"
    return ChosenModel(
        fit=_fit(data, origin, free, quadratic=quadratic),
        free=free if quadratic else tuple(k for k in free if k < _FIRST_QUADRATIC),
        quadratic=quadratic,
        sentences=(sentence(_UNTESTED[model]),),
    )


def _extended(data: FitData, origin: FloatArray, free: tuple[int, ...]) -> ChosenModel:
    """Return the quadratic model with the higher terms that the positions show beside it."""
    fitted = _fit(data, origin, free, quadratic=True)
    fewer_and_fewer = (_shown_terms(data, fitted, fitted.jacobian, KINDS[:count]) for count in (2, 1, 0))
    shown = next(each for each in fewer_and_fewer if not each.lengths.size or _is_checked(each))
    if shown.lengths.size:
        higher = higher_scale(data.gravity_m_s2)[:, None] * shown.combinations
        fitted = fit(data, fitted.vector, fitted.basis, higher=higher)
    cubic, cross = shown.counts
    return ChosenModel(
        fit=fitted,
        free=free,
        quadratic=True,
        higher=shown.combinations,
        sentences=(sentence("model_choice.extended", cubic=cubic, cross=cross),),
    )


def _is_checked(shown: ShownTerms) -> bool:
    return shown.spare >= FEWEST_TO_SPARE and shown.leverage < _MOST_LEVERAGE


def left_out_terms(data: FitData, chosen: ChosenModel, typical: Grade | None) -> LeftOutTerms | None:
    """Return the higher terms that the residuals show and the model does not have; None where they show none."""
    fitted = chosen.fit
    # A quadratic term is for the gate to admit.
    beside = fitted.jacobian if chosen.quadratic else np.hstack([fitted.jacobian, _up(data, fitted) ** 3])
    kinds = [kind for kind in KINDS if not chosen.higher[kind].any()]
    tests = [_shown_terms(data, fitted, beside, kinds)]
    if tests[0].spare < FEWEST_TO_SPARE:
        tests = [_shown_terms(data, fitted, beside, [kind]) for kind in kinds]
    possible = [shown for shown in tests if shown.lengths.size and shown.spare >= FEWEST_TO_SPARE]
    residual = fitted.residual_m_s2 / fitted.sigma_m_s2
    found = [_tested(shown, residual, np.zeros(TERMS) if typical is None else typical_higher(typical)) for shown in possible]
    return min((each for each in found if each.p < VERDICT_LEVEL / len(tests)), key=lambda each: each.p, default=None)


def _tested(shown: ShownTerms, residual: FloatArray, typical_m_s2: FloatArray) -> LeftOutTerms:
    """Return what residuals over their sigmas show of higher terms.

    With x of each combination, its length l and its typical size t, the mean of ``x^2 / (s^2 + (t l)^2)`` is held against the F
    distribution: s^2 is the variance that the residuals leave, and typical terms are in the uncertainty.
    """
    square = (shown.columns.T @ residual) ** 2
    rest = residual - shown.span @ (shown.span.T @ residual)
    noise = max(float(rest @ rest) / shown.spare, _ROUNDING)
    typical_square = (shown.combinations.T**2 @ typical_m_s2**2) * shown.lengths**2
    ratio = float(np.mean(square / (noise + typical_square)))
    terms = np.maximum(square - noise, 0.0) / shown.lengths**2
    cubic, cross = (
        math.sqrt(np.mean(terms[own])) if (own := shown.combinations[kind].any(axis=0)).any() else 0.0 for kind in KINDS
    )
    return LeftOutTerms(cubic_m_s2=cubic, cross_m_s2=cross, p=f_tail(len(shown.lengths), shown.spare, ratio))


def _shown_terms(data: FitData, fitted: Fit, jacobian: FloatArray, kinds: Sequence[slice]) -> ShownTerms:
    return shown_terms(jacobian, _up(data, fitted), fitted.sigma_m_s2, least=WEAKEST_COLUMN, kinds=kinds)


def _up(data: FitData, fitted: Fit) -> FloatArray:
    raw = data.raw - fitted.vector[SCALE] * fitted.drift_m_s2
    at = norm_derivatives(fitted.vector, raw, data.quadratic_axes, fitted.higher)
    return at.a / at.norm[:, None]
