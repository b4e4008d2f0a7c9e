import math
from typing import Any

import numpy as np
import pytest

from imufield.guide.stillness.cells import Cells, join_cells
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.hand_edges import FEWEST, hand_edges
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import Samples
from imufield.simulate.truth.grades import GRADES, perfect_instrument
from imufield.simulate.truth.imu import Imu, ImuSettings
from imufield.simulate.truth.operator import Operator, OperatorSettings, TrueMove
from tests.guide.guided import cells_of

pytestmark = pytest.mark.numerical

LIMIT = np.repeat([0.5, math.radians(10)], 3)


def cells_with(rate_rad_s: np.ndarray[Any, Any]) -> Cells:
    """Return cells of samples at 10 Hz: one each, with these rates about x."""
    n = len(rate_rad_s)
    gyroscope = np.zeros((n, 3))
    gyroscope[:, 0] = rate_rad_s
    template = Imu(perfect_instrument(GRADES["industrial"]), 1, ImuSettings(rate_hz=10.0))
    still = template.feed(Operator([], 1).block(0, n, 0.1))
    samples = Samples(
        time_s=still.time_s,
        accelerometer=np.tile([0.0, 0.0, 9.8], (n, 1)),
        gyroscope=gyroscope,
        temperature_degc=still.temperature_degc,
        counter=still.counter,
        status=still.status,
        units=still.units,
    )
    return join_cells(list(cells_of([samples])))


def test_a_turn_that_fades_is_cut_off_at_both_ends() -> None:
    sway = math.radians(2) * np.sin(np.arange(120) * 0.7)
    fading = math.radians(18) * (np.arange(10, 0, -1) / 10) ** 2
    rate = sway.copy()
    rate[:10] += fading
    rate[-10:] += fading[::-1]
    rows = hand_edges(cells_with(rate), LIMIT)
    # What is left of the turn after n cells is 0.06 deg (10 - n)^3 / 100, the sway's rms angle 0.2 deg: 3 cells from the end.
    assert 7 <= rows.start <= 10
    assert 110 <= rows.stop <= 113


def test_a_large_swing_of_the_arm_is_not_the_turn() -> None:
    rate = math.radians(2) * np.sin(np.arange(120) * 0.7)
    rate[107:109] = math.radians(6)
    assert hand_edges(cells_with(rate), LIMIT) == slice(0, 120)


def test_a_turn_that_begins_below_the_largest_swings_is_seen_at_the_edge() -> None:
    rate = math.radians(2) * np.sin(np.arange(120) * 0.7)
    rate[117:] = math.radians(3.7)
    assert hand_edges(cells_with(rate), LIMIT) == slice(0, 117)


def test_sway_alone_is_kept_whole() -> None:
    rows = hand_edges(cells_with(math.radians(2) * np.sin(np.arange(120) * 0.7)), LIMIT)
    assert rows == slice(0, 120)


def test_a_quiet_unit_is_not_cut_for_its_noise() -> None:
    rng = np.random.default_rng(4)
    assert hand_edges(cells_with(1e-4 * rng.standard_normal(100)), LIMIT) == slice(0, 100)


def test_a_slow_swing_at_the_end_of_a_short_hold_is_not_taken_for_a_turn() -> None:
    """Three seconds do not show a sway of five: what passes for a smooth turn may be one, and is left in but for a cell."""
    rate = math.radians(1.5) * np.sin(np.arange(36) * 1.9)
    rate[-10:] += math.radians(6) * np.linspace(0, 1, 10) ** 2
    short = hand_edges(cells_with(rate), LIMIT)
    longer = hand_edges(cells_with(np.concatenate([math.radians(1.5) * np.sin(np.arange(-114, 0) * 1.9), rate])), LIMIT)
    assert short.start == longer.start == 0
    assert 36 - short.stop < 150 - longer.stop <= 8


@pytest.mark.parametrize("swing", [7, 8])
def test_one_cell_that_departs_beyond_the_fitted_turn_goes_with_it_and_no_more(swing: int) -> None:
    rate = math.radians(2) * np.sin(np.arange(120) * 0.7)
    rate[-8:] += math.radians(8) * (np.arange(1, 9) / 8) ** 2
    fitted = hand_edges(cells_with(rate), LIMIT)
    assert fitted == slice(0, 114)
    rate[-swing] = math.radians(6)
    assert hand_edges(cells_with(rate), LIMIT) == slice(0, 113)


def test_turns_that_reach_far_into_both_ends_leave_something_to_compare_with() -> None:
    rate = math.radians(1) * np.sin(np.arange(FEWEST) * 1.3)
    rate[:10] += math.radians(8)
    rate[-10:] += math.radians(8)
    assert hand_edges(cells_with(rate), LIMIT) == slice(10, 20)


def test_a_short_stretch_is_left_alone() -> None:
    rate = np.zeros(FEWEST - 1)
    rate[0] = 1.0
    assert hand_edges(cells_with(rate), LIMIT) == slice(0, FEWEST - 1)


def hidden_s(operator: Operator, move: TrueMove) -> float:
    """Return how long, at either end of a minimum-jerk turn, less of it is made (or left) than the hand strays, rms angle."""
    before, after = operator.attitude(np.array([move.start_s, move.end_s]))
    turn = 2 * math.acos(min(abs(float(before @ after)), 1.0))
    settings = operator.settings
    stray = math.sqrt(3 * (settings.sway_rad**2 + settings.tremor_rad**2))
    share = np.linspace(0, 1, 10001)
    made = 10 * share**3 - 15 * share**4 + 6 * share**5
    return float(np.interp(min(stray / turn, 1.0), made, share)) * (move.end_s - move.start_s)


@pytest.mark.parametrize(
    ("sway_deg", "turn_s", "seed"),
    [(0.1, (0.5, 5.0), 33), (0.5, (0.5, 5.0), 33), (1.0, (0.5, 5.0), 33), (1.0, (3.0, 5.0), 52), (1.0, (3.0, 5.0), 107)],
)
def test_edges_of_held_stretches_lie_where_the_turns_begin_and_end(
    sway_deg: float, turn_s: tuple[float, float], seed: int
) -> None:
    """Within 0.3 s of the truth, which is a range where sway hides the end of a turn: what is left of it is less."""
    settings = OperatorSettings(
        style="held", hold_s=12.0, initial_still_s=6.0, turn_s=turn_s, sway_rad=math.radians(sway_deg), tremor_rad=0.001
    )
    directions: list[list[float]] = [[0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, -1], [0, -1, 0], [-1, 0, 0], [0.0, 1, 1]]
    operator = Operator(directions, seed, settings)
    imu = Imu(perfect_instrument(GRADES["industrial"]), seed, ImuSettings(rate_hz=100.0))
    count = round(operator.plan_all() * 100) - 50
    detector = StillnessDetector(RoughScale.of_units(imu.instrument.grade.units), hand=True)
    blocks = [imu.feed(operator.block(0, count, 0.01))]
    judged = [judgement for cells in cells_of(blocks) for judgement in detector.judge(cells)]
    found = [judgement.ended.cells() for judgement in judged if judgement.ended is not None]
    held = [still for still in operator.stills if still.kind == "held"][:-1]
    assert len(held) == len(found) - 1 == 6
    turns = [hidden_s(operator, move) for move in operator.moves]
    for cells, still, before_s, after_s in zip(found[1:], held, turns, turns[1:], strict=False):
        assert -before_s - 0.3 <= cells.start_s[0] - still.start_s <= 0.3
        assert -0.3 <= cells.end_s[-1] - still.end_s <= after_s + 0.3
