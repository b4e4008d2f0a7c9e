"""Drift, quadratic term and what no residual shows: whether the stated intervals hold the truth, and what the verdict says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.uncertainty import degrees_of_freedom, student_factor
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2, Gravity
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import GRADES, TrueInstrument, draw_truth, perfect_instrument
from imufield.study.answers.means import Answer, MeanSession, answer_of
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

ORDERS = (
    "paper24",
    "paper24, in turn",
    "paper24, faces first",
    "paper24, shuffled",
    "corners24",
    "corners24, faces first",
)
WARM_UPS_MG = (0.0, 0.3, 1.0, 5.0)
QUADRATIC_SIGMAS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
_KNOWN = Gravity(gravity_m_s2=STANDARD_GRAVITY_M_S2, sigma_m_s2=1e-6, source="measured")
_FOUR_SIGMA = 6.3e-5  # Chance that a normal number is beyond 4 sigma.
_GRADE = "industrial"


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One kind of sessions."""

    order: str
    warm_up_mg: float = 0.0
    quadratic_sigmas: float = 0.0
    has_typical_terms: bool = False


@dataclass(frozen=True, slots=True)
class TermsRun:
    """One session."""

    answer: Answer
    admitted: bool
    bias_sigma_mg: float
    four_sigma: float
    """What 4 normal sigma are, over the 95 % limit."""


def run_case(case: Case, rng: np.random.Generator) -> TermsRun:
    """Solve one session."""
    session = MeanSession(instrument=_instrument(case, rng), gravity_m_s2=STANDARD_GRAVITY_M_S2, order=case.order).observe(rng)
    grade = _GRADE if case.has_typical_terms else None
    found = calibrate_accelerometer(session.observations, _KNOWN, grade=grade)
    freedom = degrees_of_freedom(found.quality.student_factor_95)
    return TermsRun(
        answer=answer_of(found, session.truth),
        admitted=found.quadratic_fitted or bool(np.any(found.positions.bias_drift_m_s2)),
        bias_sigma_mg=float(np.mean(found.accelerometer_sigma.bias_m_s2)) / MILLI_G_M_S2,
        four_sigma=student_factor(freedom, chance=_FOUR_SIGMA) / found.quality.student_factor_95,
    )


def _instrument(case: Case, rng: np.random.Generator) -> TrueInstrument:
    drawn = draw_truth(GRADES[_GRADE], rng)
    scale = drawn.accelerometer.scale
    quadratic = scale * _quadratic_sigma(case.order) * case.quadratic_sigmas * rng.choice([-1.0, 1.0], 3)
    warm_up = case.warm_up_mg * MILLI_G_M_S2 * rng.choice([-1.0, 1.0], 3)
    effects = Effects(warm_up_m_s2=(float(warm_up[0]), float(warm_up[1]), float(warm_up[2])))
    if case.has_typical_terms:
        typical = GRADES[_GRADE]
        asymmetry, cubic, *cross = (
            (float(x), float(y), float(z))
            for x, y, z in np.repeat([typical.asymmetry, typical.cubic, *[typical.cross] * 3], 3).reshape(5, 3)
            * rng.standard_normal((5, 3))
        )
        effects = replace(effects, asymmetry=asymmetry, cubic=cubic, cross=tuple(cross))
    return replace(drawn, accelerometer=replace(drawn.accelerometer, quadratic=quadratic), effects=effects)


@cache
def _quadratic_sigma(order: str) -> float:
    """Return the sigma of K2 / K that sessions of this kind have, 1 / (m/s^2)."""
    session = MeanSession(instrument=perfect_instrument(GRADES[_GRADE]), gravity_m_s2=STANDARD_GRAVITY_M_S2, order=order)
    found = calibrate_accelerometer(session.observe(np.random.default_rng(0)).observations, _KNOWN, model="quadratic")
    return float(np.mean(found.accelerometer_sigma.quadratic / found.accelerometer.scale))


def drift_and_quadratic(context: StudyContext) -> Findings:
    """Measure coverage, verdict and admission in six orders, with warm-ups and quadratic terms of many sizes."""
    runs, clean_runs = context.runs(100, 1), context.runs(2000, 4)
    kinds = {(order, warm_up): f"{order}, warm-up {warm_up:g} mg" for order in ORDERS for warm_up in WARM_UPS_MG}
    cases = [
        Case(order=order, warm_up_mg=warm_up, quadratic_sigmas=sigmas)
        for order, warm_up in kinds
        for sigmas in QUADRATIC_SIGMAS
    ]
    found = context.campaign_of_each("answers-terms", run_case, cases, runs)
    size = len(QUADRATIC_SIGMAS)
    rows = {name: _figures(found[k * size : (k + 1) * size]) for k, name in enumerate(kinds.values())}
    clean = context.campaign_of_each("answers-gate", run_case, [Case(order=order) for order in ORDERS], clean_runs)
    admitted = {
        order: {"admitted": float(np.mean([run.admitted for run in of_order])), "good": _share_good(of_order)}
        for order, of_order in zip(ORDERS, clean, strict=True)
    }
    typical = context.campaign_of_each(
        "answers-typical", run_case, [Case(order=order, has_typical_terms=True) for order in ORDERS], size * runs
    )
    drawn = {order: _figures([of_order]) for order, of_order in zip(ORDERS, typical, strict=True)}
    return Findings(
        values={"rows": rows, "clean": admitted, "typical": drawn, "runs": runs, "clean_runs": clean_runs},
        tables=(
            keyed_table("terms", "session", rows),
            keyed_table("gate", "order", admitted),
            keyed_table("typical", "order", drawn),
        ),
    )


def _figures(of_sizes: list[list[TermsRun]]) -> dict[str, float]:
    """Return the figures of sessions whose quadratic term has several sizes, all of them as often."""
    inside = [float(np.mean([np.abs(run.answer.all) <= 1 for run in of_size])) for of_size in of_sizes]
    every = [run for of_size in of_sizes for run in of_size]
    beyond = [run.answer.verdict == "good" and bool(np.any(np.abs(run.answer.all) > run.four_sigma)) for run in every]
    return {
        "inside": float(np.mean(inside)),
        "least": min(inside),
        "good": _share_good(every),
        "beyond": float(np.mean(beyond)),
        "bias_sigma_mg": float(np.median([run.bias_sigma_mg for run in every])),
        "bias_error_mg": float(np.median([run.answer.bias_error_m_s2 for run in every])) / MILLI_G_M_S2,
    }


def _share_good(runs: list[TermsRun]) -> float:
    return float(np.mean([run.answer.verdict == "good" for run in runs]))
