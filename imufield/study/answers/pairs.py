"""Pairs of sessions of one instrument: how often unchanged ones are called different, and what a turn-on is called."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.model.result import ModelChoice
from imufield.deliver.family import Shared, family_of, typical_turn_on
from imufield.deliver.parameters.gauge_free import GaugeFree
from imufield.earth import MILLI_G_M_S2
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import Grade, draw_truth, find_grade
from imufield.study import figures
from imufield.study.answers.means import MeanSession
from imufield.study.answers.sessions import guided_numbers, mean_numbers, site_gravity
from imufield.study.context import StudyContext
from imufield.study.report import Findings, keyed_table

TURN_ON_M_S2 = 0.5 * MILLI_G_M_S2
"""Between two power-ons, 1 sigma: a better MEMS module's."""
WARM_UP_M_S2 = 2 * MILLI_G_M_S2
_SLOW_S = 600.0
_SINGLE_SIGMA = 3.0  # What one number alone passes in 1 of 370.


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of pairs."""

    grade: str
    positions: str = "paper24"
    model: ModelChoice = "auto"
    turn_on_m_s2: float = 0.0
    warm_up_m_s2: float = 0.0
    """In each axis, the same in both sessions, and slow: what two orders of time do not follow would be scatter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRun:
    """What one pair shows."""

    differs: bool
    single: bool
    """Whether any number is beyond 3 sigma."""
    moved: bool
    """Whether history would say that a number moved, with two sessions."""


def run_pair(kind: Kind, rng: np.random.Generator) -> PairRun:
    """Draw an instrument without a quadratic term and calibrate its accelerometer twice at one place."""
    drawn, warm_up = draw_truth(find_grade(kind.grade), rng), kind.warm_up_m_s2
    truth = replace(
        drawn,
        accelerometer=replace(drawn.accelerometer, quadratic=np.zeros(3)),
        effects=Effects(turn_on_m_s2=kind.turn_on_m_s2, warm_up_m_s2=(warm_up, warm_up, warm_up), warm_up_s=_SLOW_S),
    )
    gravity = site_gravity()
    # True gravity is off the normal one by an anomaly, the same in both sessions.
    anomaly = gravity.sigma_m_s2 * float(rng.standard_normal())
    session = MeanSession(instrument=truth, gravity_m_s2=gravity.gravity_m_s2 + anomaly, order=kind.positions)
    return _judged(*(mean_numbers(session, gravity, rng, model=kind.model) for _ in range(2)), grade=truth.grade)


def run_whole_pair(grade: str, rng: np.random.Generator) -> PairRun:
    """Let the guide take two sessions of one instrument on two days, and compare both triads."""
    seed = int(rng.integers(2**31))
    return _judged(*(guided_numbers(grade, seed, day) for day in (0, 1)), grade=find_grade(grade))


def _judged(old: GaugeFree, new: GaugeFree, *, grade: Grade) -> PairRun:
    # The quadratic term is among the numbers where the model has it; a drift takes degrees of freedom.
    models = [[(number.name, number.scatter_freedom) for number in side.numbers] for side in (old, new)]
    same_model = models[0] == models[1]
    family = family_of(old, new, Shared(gravity=True, setup=same_model))
    return PairRun(
        differs=bool(family.beyond),
        single=any(abs(change.in_sigma) > _SINGLE_SIGMA for change in family.changes),
        moved=any(family.exceeds(change, typical_turn_on(grade, change.name)) for change in family.beyond),
    )


KINDS = {
    "tactical, paper24, linear model": Kind(grade="tactical", model="linear"),
    "tactical, paper24, model auto": Kind(grade="tactical"),
    "consumer, corners24, model auto": Kind(grade="mems", positions="corners24"),
    "industrial, corners24, slow warm-up of 2 mg": Kind(grade="industrial", positions="corners24", warm_up_m_s2=WARM_UP_M_S2),
}
TURNED_ON = {"industrial, paper24, turn-on of 0.5 mg": Kind(grade="industrial", turn_on_m_s2=TURN_ON_M_S2)}
_WHOLE = "tactical, guided sessions, both triads"


def unchanged_pairs(context: StudyContext) -> Findings:
    """Count pairs that are called different."""
    kinds = KINDS | TURNED_ON
    runs = context.runs(2000, 3)
    found = dict(zip(kinds, context.campaign_of_each("answers-pairs", run_pair, [*kinds.values()], runs), strict=True))
    found[_WHOLE] = context.campaign("answers-pairs whole", run_whole_pair, ["tactical"] * context.runs(400, 1))
    shares = {
        name: {
            "pairs": len(of_kind),
            "called different": float(np.mean([run.differs for run in of_kind])),
            # 1 sigma of a share of 5 %.
            "known to": float(np.sqrt(0.05 * 0.95 / len(of_kind))),
            "any beyond 3 sigma": float(np.mean([run.single for run in of_kind])),
            "said to have moved": float(np.mean([run.moved for run in of_kind])),
        }
        for name, of_kind in found.items()
    }
    columns = ("called different", "any beyond 3 sigma", "said to have moved")
    return Findings(
        values={
            "unchanged": {name: row for name, row in shares.items() if name not in TURNED_ON},
            "turned_on": {name: row for name, row in shares.items() if name in TURNED_ON},
        },
        tables=(keyed_table("shares", "kind", shares),),
        draw=figures.bars(tuple(shares), {name: np.array([row[name] for row in shares.values()]) for name in columns}, "share"),
    )
