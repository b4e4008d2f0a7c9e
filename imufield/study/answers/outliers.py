"""Holds that were touched: named, judged, and what leaving out those that are named does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.observations import leave_out
from imufield.earth import MILLI_G_M_S2, choose_gravity
from imufield.sentences import Sentence
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import GRADES, draw_truth
from imufield.study.answers.means import PLACED_M_S2, Answer, MeanSession, answer_of
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

LATITUDE_DEG = 48.0
KINDS = {
    "none": Effects(),
    **{
        f"{count} off by {size_mg:g} mg": Effects(touched_holds=count, touch_m_s2=size_mg * MILLI_G_M_S2)
        for count in (1, 2, 3)
        for size_mg in (2.0, 10.0, 50.0)
    },
}


@dataclass(frozen=True, slots=True)
class OutlierRun:
    """One session: as it is, and without the holds that its verdict names."""

    as_it_is: Answer
    without: Answer
    touched: frozenset[str]
    named: frozenset[str]


def run_outliers(effects: Effects, rng: np.random.Generator) -> OutlierRun:
    """Solve one session, then again without what the verdict names."""
    gravity = choose_gravity(latitude_deg=LATITUDE_DEG)
    instrument = replace(draw_truth(GRADES["industrial"], rng), effects=effects)
    true_m_s2 = gravity.gravity_m_s2 + gravity.sigma_m_s2 * float(rng.standard_normal())
    session = MeanSession(instrument=instrument, gravity_m_s2=true_m_s2, scatter_m_s2=PLACED_M_S2).observe(rng)
    found = calibrate_accelerometer(session.observations, gravity)
    named = frozenset(
        str(reason.values["position"])
        for reason in found.quality.reasons
        if isinstance(reason, Sentence) and reason.key in ("quality.outlier", "quality.gross_outlier")
    )
    again = calibrate_accelerometer(leave_out(session.observations, named)[0], gravity)
    return OutlierRun(answer_of(found, session.truth), answer_of(again, session.truth), session.touched, named)


def touched_holds(context: StudyContext) -> Findings:
    """Count verdicts and named holds."""
    runs = context.runs(500, 3)
    found = context.campaign_of_each("answers-outlier", run_outliers, [*KINDS.values()], runs)
    rows = {name: _figures(of_kind) for name, of_kind in zip(KINDS, found, strict=True)}
    return Findings(values={"rows": rows, "runs": runs}, tables=(keyed_table("shares", "touched", rows),))


def _figures(runs: list[OutlierRun]) -> dict[str, float]:
    def verdict(name: str) -> float:
        return float(np.mean([run.as_it_is.verdict == name for run in runs]))

    def inside(answers: list[Answer]) -> float:
        return float(np.mean([np.abs([answer.scale, answer.bias]) <= 1 for answer in answers]))

    before, after = [run.as_it_is for run in runs], [run.without for run in runs]
    return {
        **{name: verdict(name) for name in ("good", "usable", "poor")},
        "named_right": float(np.mean([run.named == run.touched for run in runs])),
        "named_wrong": float(np.mean([bool(run.named - run.touched) for run in runs])),
        "inside": inside(before),
        "error_mg": float(np.median([answer.bias_error_m_s2 for answer in before])) / MILLI_G_M_S2,
        "inside_without": inside(after),
        "error_without_mg": float(np.median([answer.bias_error_m_s2 for answer in after])) / MILLI_G_M_S2,
    }
