"""Gravity that a person types from a textbook: what the answer says of the scale, before and after it counts as assumed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.earth import NORMAL_GRAVITY_SIGMA_M_S2, Gravity, choose_gravity, normal_gravity, sigma_of_digits
from imufield.simulate.truth.grades import GRADES, draw_truth
from imufield.study.answers.means import PLACED_M_S2, Answer, MeanSession, answer_of
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

VALUES = ("9.80665", "9.81", "9.8", "9.807")
EXPLICIT_M_S2 = 2e-4
"""Sigma of a value that was measured and is typed with it."""


@dataclass(frozen=True, slots=True)
class GravityRun:
    """Answers of one session with a typed value, whose sigma follows from its digits, as chosen now, and as measured."""

    by_digits: Answer
    chosen: Answer
    measured: Answer


def run_gravity(value: str, rng: np.random.Generator) -> GravityRun:
    """Solve one session somewhere on Earth, at sea level, with a textbook's gravity."""
    # Uniform over the sphere: the sine of the latitude is.
    latitude_deg = float(np.degrees(np.arcsin(rng.uniform(-1.0, 1.0))))
    true_m_s2 = normal_gravity(latitude_deg) + NORMAL_GRAVITY_SIGMA_M_S2 * float(rng.standard_normal())
    truth = draw_truth(GRADES["industrial"], rng)
    session = MeanSession(instrument=truth, gravity_m_s2=true_m_s2, scatter_m_s2=PLACED_M_S2).observe(rng)
    by_digits = Gravity(gravity_m_s2=float(value), sigma_m_s2=sigma_of_digits(value), source="typed")
    found_m_s2 = true_m_s2 + EXPLICIT_M_S2 * float(rng.standard_normal())
    measured = choose_gravity(found_m_s2, sigma_m_s2=EXPLICIT_M_S2)
    believed = (by_digits, choose_gravity(float(value)), measured)
    return GravityRun(
        *(answer_of(calibrate_accelerometer(session.observations, gravity), session.truth) for gravity in believed)
    )


def typed_gravity(context: StudyContext) -> Findings:
    """Count how often scale is inside its stated limits, and what verdict it has."""
    runs = context.runs(500, 3)
    found = context.campaign_of_each("answers-gravity", run_gravity, VALUES, runs)
    rows = {
        value: {
            f"{name} {figure}": number
            for name in ("by_digits", "chosen", "measured")
            for figure, number in _figures([getattr(run, name) for run in of_value]).items()
        }
        for value, of_value in zip(VALUES, found, strict=True)
    }
    return Findings(values={"rows": rows, "runs": runs}, tables=(keyed_table("shares", "typed", rows),))


def _figures(answers: list[Answer]) -> dict[str, float]:
    inside = np.array([np.abs(answer.scale) <= 1 for answer in answers])
    good = np.array([answer.verdict == "good" for answer in answers])
    return {"inside": float(inside.mean()), "good": float(good.mean())}
