"""Sessions of position means, solved: textbook gravity, touched holds, drift and quadratic term, what no residual shows."""

from __future__ import annotations

from functools import cache, partial
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.model.models import BIAS, SCALE
from imufield.calibrate.model.result import VERDICTS
from imufield.dataclass import replace
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2, Gravity, choose_gravity, sigma_of_digits
from imufield.sentences import Sentence
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import draw_truth, perfect_instrument
from imufield.study.answers.means import KNOWN, PLACED_M_S2, Answer, MeanSession, true_gravity
from imufield.study.answers.tables import Statistics, Study, Table, least

EXPLICIT_M_S2 = 2e-4
"""Sigma of gravity that was measured and is typed with it."""
LATITUDE_DEG = 48.0
_PAPER = ("paper24", "paper24, in turn", "paper24, faces first", "paper24, shuffled")
ORDERS = (*_PAPER, "corners24", "corners24, faces first")
WARM_UPS_MG = (0.0, 0.3, 1.0, 5.0)
QUADRATIC_SIGMAS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
_INDUSTRIAL = GRADES["industrial"]
_OUTLIERS = ("quality.outlier", "quality.gross_outlier")


def with_typed_gravity(typed: str, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Solve one session somewhere on Earth, at sea level, with a textbook's gravity.

    Its sigma follows from its digits, is chosen as in use, or is that of a value that was measured.
    """
    # Uniform over the sphere: the sine of the latitude is.
    true_m_s2 = true_gravity(choose_gravity(latitude_deg=float(np.degrees(np.arcsin(rng.uniform(-1.0, 1.0))))), rng)
    truth = draw_truth(_INDUSTRIAL, rng)
    session = MeanSession(instrument=truth, gravity_m_s2=true_m_s2, scatter_m_s2=PLACED_M_S2).observe(rng)
    measured_m_s2 = true_m_s2 + EXPLICIT_M_S2 * float(rng.standard_normal())
    believed = {
        "by_digits": Gravity(gravity_m_s2=float(typed), sigma_m_s2=sigma_of_digits(typed), source="typed"),
        "chosen": choose_gravity(float(typed)),
        "measured": choose_gravity(measured_m_s2, sigma_m_s2=EXPLICIT_M_S2),
    }
    values: dict[str, ArrayLike] = {}
    for name, gravity in believed.items():
        answer = session.answer(gravity)
        values |= {f"{name} inside": answer.inside[:3], f"{name} good": answer.is_good}
    return values


def with_touched_holds(count: int, size_mg: float, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Solve one session with touched holds, then again without what the verdict names."""
    gravity = choose_gravity(latitude_deg=LATITUDE_DEG)
    effects = Effects(touched_holds=count, touch_m_s2=size_mg * MILLI_G_M_S2)
    instrument = replace(draw_truth(_INDUSTRIAL, rng), effects=effects)
    session = MeanSession(instrument=instrument, gravity_m_s2=true_gravity(gravity, rng), scatter_m_s2=PLACED_M_S2).observe(rng)
    found = session.answer(gravity)
    reasons = [reason for reason in found.calibration.quality.reasons if isinstance(reason, Sentence)]
    named = {str(reason.values["position"]) for reason in reasons if reason.key in _OUTLIERS}
    without = session.answer(gravity, without=named)
    return {
        **{verdict: found.calibration.quality.verdict == verdict for verdict in VERDICTS},
        "named_right": named == session.touched,
        "named_wrong": bool(named - session.touched),
        "inside": found.inside[:6],
        "beyond": found.is_good_and_beyond,
        "error_mg": found.bias_error_mg,
        "inside_without": without.inside[:6],
        "beyond_without": without.is_good_and_beyond,
        "error_without_mg": without.bias_error_mg,
    }


def with_terms(
    rng: np.random.Generator, *, order: str, warm_up_mg: float = 0.0, quadratic_sigmas: float = 0.0
) -> dict[str, ArrayLike]:
    """Solve one session with a warm-up and a quadratic term of so many of its sigmas."""
    drawn = draw_truth(_INDUSTRIAL, rng)
    scale = drawn.accelerometer.scale
    quadratic = scale * _quadratic_sigma(order) * quadratic_sigmas * rng.choice([-1.0, 1.0], 3)
    warm_up = warm_up_mg * MILLI_G_M_S2 * rng.choice([-1.0, 1.0], 3)
    effects = Effects(warm_up_m_s2=tuple(warm_up.tolist()))
    instrument = replace(drawn, accelerometer=replace(drawn.accelerometer, quadratic=quadratic), effects=effects)
    session = MeanSession(instrument=instrument, gravity_m_s2=STANDARD_GRAVITY_M_S2, order=order)
    found = session.observe(rng).answer(KNOWN)
    return {"inside": found.inside, "least": found.inside, **_judged(found)}


def with_typical_terms(grade: str, order: str, rng: np.random.Generator) -> dict[str, ArrayLike]:
    """Solve one session of which everything is drawn from what is typical of a grade, which the calibration is told."""
    typical = GRADES[grade]
    sizes = np.array([typical.asymmetry, typical.cubic, *[typical.cross] * 3])
    asymmetry, cubic, *cross = (tuple(axes.tolist()) for axes in sizes[:, None] * rng.standard_normal((5, 3)))
    effects = Effects(asymmetry=asymmetry, cubic=cubic, cross=tuple(cross))
    session = MeanSession(
        # Misalignments and quadratic terms of the grade are the typical ones.
        instrument=replace(draw_truth(typical, rng), effects=effects),
        gravity_m_s2=STANDARD_GRAVITY_M_S2,
        order=order,
        scatter_m_s2=typical.scatter_m_s2,
    )
    found = session.observe(rng).answer(KNOWN, grade=grade)
    groups = {name: found.inside[rows] for name, rows in (("scale", SCALE), ("bias", BIAS), ("angle", slice(6, 9)))}
    return {"inside": found.inside, **groups, **_judged(found)}


def _judged(found: Answer) -> dict[str, ArrayLike]:
    return {
        "good": found.is_good,
        "beyond": found.is_good_and_beyond,
        "bias_sigma_mg": float(np.mean(found.calibration.accelerometer_sigma.bias_m_s2)) / MILLI_G_M_S2,
        "bias_error_mg": found.bias_error_mg,
        "admitted": found.calibration.quadratic_fitted or bool(np.any(found.calibration.positions.bias_drift_m_s2)),
    }


@cache
def _quadratic_sigma(order: str) -> float:
    """Return the sigma of K2 / K that sessions of this kind have, 1 / (m/s^2)."""
    session = MeanSession(instrument=perfect_instrument(_INDUSTRIAL), gravity_m_s2=STANDARD_GRAVITY_M_S2, order=order)
    found = calibrate_accelerometer(session.observe(np.random.default_rng(0)).observations, KNOWN, model="quadratic")
    return float(np.mean(found.accelerometer_sigma.quadratic / found.accelerometer.scale))


_MEDIANS = ("error_mg", "error_without_mg", "bias_sigma_mg", "bias_error_mg")
_COUNTED: Statistics = {"least": least, **dict.fromkeys(_MEDIANS, np.median)}
_TYPED = {typed: partial(with_typed_gravity, typed) for typed in ("9.80665", "9.81", "9.8", "9.807")}
_TOUCHED = {
    f"{count} off by {mg:g} mg" if count else "none": partial(with_touched_holds, count, mg)
    for count, mg in ((0, 0.0), *product((1, 2, 3), (2.0, 10.0, 50.0)))
}
_TERMS = {
    f"{order}, warm-up {mg:g} mg": [
        partial(with_terms, order=order, warm_up_mg=mg, quadratic_sigmas=sigmas) for sigmas in QUADRATIC_SIGMAS
    ]
    for order, mg in product(ORDERS, WARM_UPS_MG)
}
_NONE = {order: partial(with_terms, order=order) for order in ORDERS}
_TYPICAL = {f"{grade}, {order}": partial(with_typical_terms, grade, order) for grade in GRADES for order in ORDERS}
typed_gravity = Study(Table(label="typed", campaign="answers-gravity", rows=_TYPED, runs=(500, 1)))
touched_holds = Study(Table(label="touched", campaign="answers-outlier", rows=_TOUCHED, runs=(500, 1), statistics=_COUNTED))
drift_and_quadratic = Study(
    Table(name="terms", label="session", campaign="answers-terms", rows=_TERMS, runs=(100, 1), statistics=_COUNTED),
    Table(name="gate", label="order", campaign="answers-gate", rows=_NONE, runs=(2000, 1), statistics=_COUNTED),
    Table(name="typical", label="grade, order", campaign="answers-typical", rows=_TYPICAL, runs=(2500, 1), statistics=_COUNTED),
)
