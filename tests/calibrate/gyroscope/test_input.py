"""What the accelerometer's calibration does not show reaches the gyroscope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gyroscope_sessions import Turn, ratios, simulate

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.whole_turns import Stop
from imufield.calibrate.model.budget import combined_sigma
from imufield.calibrate.model.gauge import change_gauge, turn_gyroscope
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import Gauge
from imufield.sentences import Sentences
from imufield.simulate.truth.grades import GRADES, draw_truth
from tests.told import told

sentence = Sentences("imufield.calibrate.gyroscope")

FACES = np.vstack([np.eye(3), -np.eye(3)])[[0, 4, 2, 3, 1, 5, 1, 3, 5, 0, 2, 4]]


@pytest.mark.parametrize("gauge", ["lower", "upper", "symmetric"])
def test_a_misalignment_of_the_accelerometer_that_faces_hide_is_in_the_sigma(gauge: Gauge) -> None:
    found = []
    for seed in range(1, 6):
        session = simulate(seed, positions=FACES, hold_s=6.0)
        observations, gravity = session.given.observations, session.calibration.gravity
        calibration = calibrate_accelerometer(observations, gravity, grade="mems", gauge=gauge)
        result = calibrate_gyroscope(replace(session.given, calibration=calibration, grade="mems"))
        true = to_vector(draw_truth(GRADES["mems"], np.random.default_rng([seed, 7])).accelerometer)
        # The session's truth is in the lower gauge.
        between = change_gauge(true, gauge).rotation @ change_gauge(true, "lower").rotation.T
        turned = replace(session, truth=turn_gyroscope(session.truth, between))
        found.append(ratios(turned, result)[3:9])
        assert "misalignment_not_shown" in {share.name for share in result.budget}
        assert combined_sigma(result.budget) ** 2 == pytest.approx(np.diag(result.covariance), rel=1e-9)
        joined = result.join(calibration).covariance
        size = np.sqrt(np.diag(joined))
        size[size == 0] = 1.0  # what the gauge fixes
        assert np.linalg.eigvalsh(joined / np.outer(size, size)).min() > -1e-9
    assert 0.6 < np.sqrt(np.mean(np.square(found))) < 1.3
    assert np.abs(found).max() < 3.5


@pytest.mark.parametrize(("triad", "output"), [("accelerometer", 9.4e5), ("gyroscope", np.radians(9123.0))])
def test_a_move_with_a_damaged_sample_is_left_out_and_told(triad: str, output: float) -> None:
    session = simulate(3)
    moves, whole = session.given.moves, calibrate_gyroscope(session.given)
    slots, row = moves.slots, moves.first[4] + 3
    name = {"accelerometer": "force", "gyroscope": "turn"}[triad]
    values = getattr(slots, name).copy()
    # One sample whose number lost its point.
    values[row] += output * slots.duration_s[row]
    damaged = replace(session.given, moves=replace(moves, slots=replace(slots, **{name: values})))
    found = calibrate_gyroscope(damaged)
    ((begin_s, named),) = [(each.values["begin_s"], each.values["triad"]) for each in told(found.reasons, "input.impossible")]
    assert (begin_s, named) == (pytest.approx(moves.start_s[4]), triad)
    assert len(found.moves.after_deg) == len(moves) - 1
    change = found.calibration.parameters.g_sensitivity - whole.calibration.parameters.g_sensitivity
    assert np.abs(change / whole.calibration.sigma.g_sensitivity).max() < 1.0


def test_moves_that_either_triad_damages_are_left_out_once_each() -> None:
    session = simulate(3)
    moves = session.given.moves
    slots, few = moves.slots, len(moves) // 5
    force, turn = slots.force.copy(), slots.turn.copy()
    # One move is damaged in both.
    for values, output, rows in ((force, 9.4e5, range(few)), (turn, 160.0, range(few - 1, 2 * few - 1))):
        for k in rows:
            values[moves.first[k] + 3] += output * slots.duration_s[moves.first[k] + 3]
    damaged = replace(session.given, moves=replace(moves, slots=replace(slots, force=force, turn=turn)))
    found = calibrate_gyroscope(damaged)
    begins_s = [each.values["begin_s"] for each in told(found.reasons, "input.impossible")]
    assert sorted(begins_s) == pytest.approx(moves.start_s[: 2 * few - 1])
    assert len(found.moves.after_deg) == len(moves) - (2 * few - 1)


def test_the_stop_of_a_move_that_is_left_out_goes_with_it() -> None:
    turned = simulate(3, turns=tuple(Turn(np.eye(3)[axis], 2 * np.pi, upright=True) for axis in range(3)))
    stops = tuple(Stop(time_s, np.radians(0.01)) for time_s in turned.turn_times_s)
    moves, turn = turned.given.moves, turned.given.moves.slots.turn.copy()
    # One sample whose number lost its point.
    row = int(np.searchsorted(moves.slots.start_s, stops[2].time_s))
    turn[row] += np.radians(9000.0) * moves.slots.duration_s[row]
    damaged = replace(moves, slots=replace(moves.slots, turn=turn))
    found = calibrate_gyroscope(replace(turned.given, stops=stops, moves=damaged))
    assert sentence("result.stops", stops=2) in found.calibration.path
    assert len(told(found.reasons, "input.impossible")) == 1
