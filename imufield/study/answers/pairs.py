"""Pairs of sessions of one instrument: how often unchanged ones are called different, and what a turn-on is called."""

from __future__ import annotations

from functools import partial

import numpy as np

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.model.grades import find_grade
from imufield.calibrate.model.result import ModelChoice
from imufield.calibrate.moves.moves import MoveCollector
from imufield.dataclass import replace
from imufield.deliver.pair_test import Shared, family_of, typical_turn_on
from imufield.deliver.parameters.gauge_free import GaugeFree
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2, choose_gravity
from imufield.guide.lead.guide import Guide
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import scheme
from imufield.samples import AXES, FloatArray
from imufield.simulate.emulator.emulate import Emulation, make_virtual_imu
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.grades import draw_truth
from imufield.simulate.truth.operator import OperatorSettings
from imufield.study.answers.means import MeanSession, gauge_free_of, true_gravity, without_quadratic
from imufield.study.answers.recorded import moves_of
from imufield.study.answers.tables import Statistics, Study, Table

LATITUDE_DEG = 48.1
RATE_HZ = 100.0
TURN_ON_M_S2 = 0.5 * MILLI_G_M_S2
"""Between two power-ons, 1 sigma: a better MEMS module's."""
WARM_UP_M_S2 = 2 * MILLI_G_M_S2
_SLOW_S = 600.0
_SINGLE_SIGMA = 3.0  # What one number alone passes in 1 of 370.
_BLOCK = 2000


def compare(
    rng: np.random.Generator,
    *,
    grade: str,
    positions: str = "paper24",
    model: ModelChoice = "auto",
    turn_on_m_s2: float = 0.0,
    warm_up_m_s2: float = 0.0,
) -> dict[str, bool]:
    """Draw an instrument without a quadratic term and calibrate its accelerometer twice at one place.

    A warm-up is the same in each axis and in both sessions, and slow: what two orders of time do not follow would be scatter.
    """
    drawn = draw_truth(find_grade(grade), rng)
    effects = Effects(turn_on_m_s2=turn_on_m_s2, warm_up_m_s2=(warm_up_m_s2, warm_up_m_s2, warm_up_m_s2), warm_up_s=_SLOW_S)
    truth = replace(without_quadratic(drawn), effects=effects)
    gravity = choose_gravity(latitude_deg=LATITUDE_DEG)
    # The same in both sessions.
    session = MeanSession(instrument=truth, gravity_m_s2=true_gravity(gravity, rng), order=positions)
    taken = [session.observe(rng).observations for _ in range(2)]
    return _judged(*(gauge_free_of(calibrate_accelerometer(each, gravity, model=model), each) for each in taken), grade=grade)


def compare_guided(rng: np.random.Generator, *, grade: str) -> dict[str, bool]:
    """Let the guide take two sessions of one instrument on two days, and compare both triads."""
    seed = int(rng.integers(2**31))
    return _judged(*(_guided(grade, seed, day) for day in (0, 1)), grade=grade)


def _judged(old: GaugeFree, new: GaugeFree, *, grade: str) -> dict[str, bool]:
    if _model(old) != _model(new):
        old, new = old.in_linear_model(), new.in_linear_model()
    family = family_of(old, new, Shared(gravity=True, setup=_model(old) == _model(new)))
    typical = find_grade(grade)
    return {
        "pairs": True,
        "called different": bool(family.beyond),
        "known to": True,
        "any beyond 3 sigma": any(abs(change.in_sigma) > _SINGLE_SIGMA for change in family.changes),
        # As history says with two sessions.
        "said to have moved": any(family.exceeds(change, typical_turn_on(typical, change.name)) for change in family.beyond),
    }


def _model(side: GaugeFree) -> list[tuple[str, float]]:
    """Return what tells models apart: a quadratic term is among the numbers, a drift takes degrees of freedom."""
    return [(number.name, number.scatter_freedom) for number in side.numbers]


def _guided(grade: str, seed: int, day: int) -> GaugeFree:
    """Return the gauge-free numbers of both triads from a session on one day of an instrument, taken by the guide.

    What slow drift added to the biases on average over the session is a change of the instrument, and is taken off.
    """
    positions = scheme("paper24")
    habits = OperatorSettings(hold_s=5.5, initial_still_s=6.0, begins_in_first_position=True)
    options = Emulation(
        device="text", rate_hz=RATE_HZ, grade=grade, seed=seed, day=day, directions=positions.directions(), operator=habits
    )
    source = make_virtual_imu(options)
    units, end_s = source.imu.instrument.grade.units, source.operator.plan_all() + 2.0
    guide, collector = Guide(positions, units, settings=GuideSettings(hold_s=2.5)), MoveCollector(units)
    while not guide.done and source.time_s < end_s:
        block = source.next_block(_BLOCK)
        guide.feed(block)
        collector.feed(block)
    observations = guide.observations()
    gravity = choose_gravity(options.site.gravity_m_s2)
    given = moves_of(observations, collector, gravity, options.site.latitude_deg)
    found = gauge_free_of(calibrate_gyroscope(given).join(given.calibration), observations)
    drift = source.imu.mean_drift / np.repeat([MILLI_G_M_S2, DEG_PER_HOUR_RAD_S], 3)
    added = dict(zip((*(f"bias {axis}" for axis in AXES), *(f"gyroscope bias {axis}" for axis in AXES)), drift, strict=True))
    numbers = tuple(replace(number, value=number.value - added.get(number.name, 0.0)) for number in found.numbers)
    return replace(found, numbers=numbers)


def _known_to(pairs: FloatArray) -> float:
    """Return 1 sigma of a share of 5 %."""
    return float(np.sqrt(0.05 * 0.95 / pairs.size))


_COUNTED: Statistics = {"pairs": np.sum, "known to": _known_to}
TURNED_ON = "industrial, paper24, turn-on of 0.5 mg"
_PAIRS = {
    "tactical, paper24, linear model": partial(compare, grade="tactical", model="linear"),
    "tactical, paper24, model auto": partial(compare, grade="tactical"),
    "consumer, corners24, model auto": partial(compare, grade="mems", positions="corners24"),
    "industrial, corners24, slow warm-up of 2 mg": partial(
        compare, grade="industrial", positions="corners24", warm_up_m_s2=WARM_UP_M_S2
    ),
    TURNED_ON: partial(compare, grade="industrial", turn_on_m_s2=TURN_ON_M_S2),
}
_GUIDED = {"tactical, guided sessions, both triads": partial(compare_guided, grade="tactical")}
unchanged_pairs = Study(
    Table(label="kind", campaign="answers-pairs", rows=_PAIRS, runs=(2000, 1), statistics=_COUNTED),
    Table(label="kind", campaign="answers-pairs whole", rows=_GUIDED, runs=(400, 1), statistics=_COUNTED),
    bars=("called different", "any beyond 3 sigma", "said to have moved"),
)
