import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from imufield.calibrate.model.rotation import signed_permutations
from imufield.errors import CalibrationError, Reason
from imufield.guide.cross_checks.axes import MoveBetweenStills, MoveLog, axes_words, check_axes
from imufield.guide.refusals import AXES_DIFFER, AXES_LEFT_HANDED, AXES_OPEN, MOTIONLESS, SCALE_AND_AXES, SCALE_DIFFERS
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import Samples, Status
from tests.guide.guided import cells_of, is_said_by, key_of, values_of

pytestmark = pytest.mark.numerical

ORDER = ([0, 0, 1], [1, 0, 0], [0, -1, 0.3], [0, 0, -1], [-1, 0.4, 0], [0.2, 1, 0], [0, 0.1, 1])


@pytest.fixture
def moves(make_path: Any) -> Any:
    path = make_path(200.0, lever_m=np.array([0.05, 0.03, -0.04])).hold(ORDER[0], 5)
    for up in ORDER[1:]:
        path.turn(up, 1.2).hold(up, 3)
    return _moves_of(path.samples())


def _moves_of(samples: Samples) -> Any:
    scale = RoughScale(accelerometer=1.0, gyroscope=1.0)
    detector, log = StillnessDetector(scale), MoveLog()
    for cells in cells_of([samples]):
        for judgement in detector.judge(cells):
            log.follow(judgement, detector.stretch.mean)
    return log.moves(scale)


def test_right_axes_agree(moves: Any) -> None:
    assert len(moves) == 6
    found = check_axes(moves, 1.0)
    assert found.agrees
    assert found.misfit_deg < 2
    assert found.error is None
    assert not found.is_contradicted


@pytest.mark.parametrize("index", range(0, 48, 5))
def test_every_arrangement_is_found(moves: Any, index: Any) -> None:
    """Gyroscope axes rearranged by P: the answer is the rearrangement that undoes it."""
    wrong = signed_permutations()[index]
    found = check_axes([dataclasses.replace(move, rate_raw=move.rate_raw @ wrong.T) for move in moves], 1.0)
    np.testing.assert_array_equal(found.permutation, wrong.T)
    assert found.best_misfit_deg < 2


def test_a_left_handed_triad_is_refused_with_the_angles(moves: Any) -> None:
    mirrored = [dataclasses.replace(move, rate_raw=move.rate_raw * [1, -1, 1]) for move in moves]
    found = check_axes(mirrored, 1.0)
    assert found.agrees is False
    assert isinstance(found.error, CalibrationError)
    assert found.error.reason is Reason.HANDEDNESS
    assert found.error.values["misfit_deg"] > 20
    assert np.linalg.det(found.permutation) < 0
    assert is_said_by(AXES_LEFT_HANDED, found.refusal)
    assert "y = -y" in values_of(found.words)["axes"]


def test_exchanged_axes_are_not_called_left_handed(moves: Any) -> None:
    turned = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    found = check_axes([dataclasses.replace(move, rate_raw=move.rate_raw @ turned.T) for move in moves], 1.0)
    assert found.agrees is False
    assert np.linalg.det(found.permutation) > 0
    assert is_said_by(AXES_DIFFER, found.refusal)


@pytest.mark.parametrize(
    "own", [np.diag([-1, 1, 1]), np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1]]), np.roll(np.eye(3), 1, axis=0)]
)
def test_the_axes_of_the_accelerometer_that_would_do_are_named(moves: Any, own: np.ndarray) -> None:
    ups = [{name: getattr(move, name) @ own for name in ("up_before", "up_after")} for move in moves]
    found = check_axes([dataclasses.replace(move, **up) for move, up in zip(moves, ups, strict=True)], 1.0)
    assert is_said_by(AXES_DIFFER, found.refusal)
    assert values_of(found.words)["accelerometer"] == axes_words(own)


def test_an_unknown_scale_is_found(moves: Any) -> None:
    counts = [dataclasses.replace(move, rate_raw=move.rate_raw * 4780.0) for move in moves]
    found = check_axes(counts, None)
    assert found.agrees
    assert found.gyroscope_scale == pytest.approx(4780, rel=0.03)


@pytest.mark.parametrize(("factor", "confused"), [(1 / 57.3, ["rad/s", "deg/s"]), (57.3, ["deg/s", "rad/s"]), (0.4, [])])
def test_a_scale_that_the_moves_contradict_is_named(moves: Any, factor: float, confused: list[str]) -> None:
    wrong = [dataclasses.replace(move, rate_raw=move.rate_raw * factor) for move in moves]
    found = check_axes(wrong, 1.0)
    assert found.turns_ratio == pytest.approx(1 / factor, rel=0.03)
    assert found.agrees
    assert found.error is None
    assert found.is_contradicted
    assert found.misfit_deg > 20 > found.best_misfit_deg
    assert is_said_by(SCALE_DIFFERS, found.refusal)
    told = values_of(found.words)
    assert re.findall("deg/s|rad/s", told["cause"]) == confused
    assert told["ratio"] == pytest.approx(1 / factor, rel=0.03)


@pytest.mark.parametrize(("factor", "confused"), [(1 / 57.3, ["rad/s", "deg/s"]), (57.3, ["deg/s", "rad/s"])])
def test_two_moves_tell_a_unit_that_is_often_confused(moves: Any, factor: float, confused: list[str]) -> None:
    wrong = [dataclasses.replace(move, rate_raw=move.rate_raw * factor) for move in moves]
    found = check_axes(wrong[1:3], 1.0)
    assert is_said_by(SCALE_DIFFERS, found.refusal)
    assert re.findall("deg/s|rad/s", values_of(found.words)["cause"]) == confused
    # One move, another factor, the right unit and wrong axes are no such thing.
    assert check_axes(wrong[1:2], 1.0).refusal is None
    assert check_axes([dataclasses.replace(move, rate_raw=move.rate_raw * 0.4) for move in moves[1:3]], 1.0).refusal is None
    for wrong_axes in signed_permutations():
        assert (
            check_axes([dataclasses.replace(one, rate_raw=one.rate_raw @ wrong_axes) for one in moves[1:3]], 1.0).refusal
            is None
        )


def test_turns_about_one_axis_tell_a_wrong_scale(make_path: Any) -> None:
    ups = [np.array([0, np.sin(angle), np.cos(angle)]) for angle in np.radians(np.arange(0, 270, 45))]
    path = make_path(200.0).hold(ups[0], 5)
    for up in ups[1:]:
        path.turn(up, 1.2).hold(up, 3)
    found = check_axes(_moves_of(path.samples()), 57.3)
    assert found.agrees is None
    assert found.turns_ratio == pytest.approx(57.3, rel=0.03)


def test_a_wrong_scale_and_wrong_axes_are_both_named(moves: Any) -> None:
    wrong = [dataclasses.replace(move, rate_raw=move.rate_raw * [1, -1, 1] / 57.3) for move in moves]
    found = check_axes(wrong, 1.0)
    assert found.agrees is False
    assert is_said_by(SCALE_AND_AXES, found.refusal)
    told = values_of(found.words)
    assert told["ratio"] == pytest.approx(57.3, rel=0.03)
    assert "y = -y" in told["axes"]


def test_axes_that_fit_and_are_not_the_only_ones_are_called_so(make_path: Any) -> None:
    """All moves are about x: which of the others is y shows nothing."""
    ups = [np.array([0, np.sin(angle), np.cos(angle)]) for angle in np.radians(np.arange(0, 270, 45))]
    path = make_path(200.0).hold(ups[0], 5)
    for up in ups[1:]:
        path.turn(up, 1.2).hold(up, 3)
    moves = _moves_of(path.samples())
    found = check_axes(moves, 1.0)
    assert found.agrees is None
    assert found.refusal is None
    assert not found.is_contradicted
    assert key_of(found.words) == "axes.ambiguous"
    told = values_of(found.words)
    assert told["within_deg"] == found.misfit_deg < 2
    assert told["other_deg"] < 2
    assert told["axes"] != axes_words(np.eye(3))
    # Reversed, they do not fit, and several others do.
    reversed_x = [dataclasses.replace(move, rate_raw=move.rate_raw * [-1, 1, 1]) for move in moves]
    assert is_said_by(AXES_OPEN, check_axes(reversed_x, 1.0).refusal)


def made_moves(kinds: str, seed: int) -> list[MoveBetweenStills]:
    """Return a move of 90 degrees about each of these axes of the body, up seen with an error of 3 degrees."""
    rng, found = np.random.default_rng(seed), []
    for kind in kinds:
        axis, up = np.eye(3)["xyz".index(kind)], np.eye(3)[("xyz".index(kind) + 1) % 3]
        # A direction fixed in the room turns the other way in the body.
        seen = [each + np.radians(3.0) * rng.standard_normal(3) for each in (up, np.cross(up, axis))]
        before, after = (each / np.linalg.norm(each) for each in seen)
        found.append(MoveBetweenStills(before, after, np.tile(axis * np.pi / 2, (10, 1))))
    return found


def test_one_damaged_move_of_many_does_not_speak_against_right_axes() -> None:
    good = made_moves("xyzxyzxyzxyz", 1)
    assert check_axes(good, 1.0).agrees
    damaged = [dataclasses.replace(good[0], rate_raw=np.add(good[0].rate_raw, [0.0, 25.0, 0.0])), *good[1:]]
    assert check_axes(damaged, 1.0).agrees
    assert check_axes(damaged, None).agrees
    # With few it may be the only one about its axis.
    assert not check_axes(damaged[:6], 1.0).agrees


@pytest.mark.parametrize("seed", range(5))
def test_the_only_move_about_an_axis_shows_that_it_is_wrong(seed: int) -> None:
    moves = made_moves("xyxyxyxyxyxyz", seed)
    assert check_axes(moves, 1.0).agrees
    wrong = [dataclasses.replace(move, rate_raw=move.rate_raw * [1, 1, -1]) for move in moves]
    check = check_axes(wrong, 1.0)
    assert check.agrees is False
    np.testing.assert_array_equal(check.permutation, np.diag([1, 1, -1]))


def test_few_moves_tell_nothing(moves: Any) -> None:
    found = check_axes(moves[:3], 1.0)
    assert found.agrees is None
    assert found.error is None
    assert "3" in found.words.split()


def test_a_gyroscope_that_shows_nothing_is_not_decided(moves: Any) -> None:
    silent = [dataclasses.replace(move, rate_raw=move.rate_raw * 0) for move in moves]
    assert check_axes(silent, 1.0).agrees is None
    assert check_axes(silent, None).agrees is None
    assert check_axes(silent, 1.0).is_contradicted


def test_a_gyroscope_that_does_not_turn_is_the_cause(moves: Any) -> None:
    noise = np.random.default_rng(1)
    still = [dataclasses.replace(move, rate_raw=noise.normal(0, 0.001, move.rate_raw.shape)) for move in moves]
    found = check_axes(still, 1.0)
    assert found.agrees is None
    assert is_said_by(MOTIONLESS, found.refusal)
    assert values_of(found.words)["way"] < 1
    one_turns = [dataclasses.replace(still[0], rate_raw=moves[0].rate_raw), *still[1:]]
    assert is_said_by(AXES_OPEN, check_axes(one_turns, 1.0).refusal)


@pytest.mark.parametrize(
    ("from_s", "to_s"), [pytest.param(5.4, 5.8, id="in the turn"), pytest.param(4.0, 7.5, id="from still to still")]
)
def test_a_gap_in_a_move_drops_it(make_path: Any, from_s: float, to_s: float) -> None:
    path = make_path(200.0).hold(ORDER[0], 5)
    for up in ORDER[1:]:
        path.turn(up, 1.2).hold(up, 3)
    samples = path.samples()
    keep = (samples.time_s < from_s) | (samples.time_s >= to_s)
    moves = _moves_of(samples[keep])
    assert len(moves) == 5
    assert check_axes(moves, 1.0).agrees


def test_a_clock_that_is_set_in_a_move_drops_it(make_path: Any) -> None:
    """As of an hour without samples, which looks like a clock that was set."""
    path = make_path(200.0).hold(ORDER[0], 5)
    for up in ORDER[1:]:
        path.turn(up, 1.2).hold(up, 3)
    samples = path.samples()
    behind = int(np.count_nonzero(samples.time_s < 5.2))
    samples = samples[(samples.time_s < 5.2) | (samples.time_s >= 6.0)]
    samples.time_s[behind:] -= 0.8
    assert len(_moves_of(samples)) == 6
    samples.status[behind] |= np.uint32(Status.GAP_ESTIMATED)
    assert len(_moves_of(samples)) == 6
    samples.status[behind] |= np.uint32(Status.CLOCK_SET)
    moves = _moves_of(samples)
    assert len(moves) == 5
    assert check_axes(moves, 1.0).agrees


def test_a_pause_with_a_few_more_samples_before_the_turn_drops_the_move(make_path: Any) -> None:
    """The unit was turned while nothing was written: what arrives before the next hold begins is no whole move."""
    path = make_path(200.0).hold(ORDER[0], 5)
    for up in ORDER[1:]:
        path.turn(up, 1.2).hold(up, 3)
    samples = path.samples()
    moves = _moves_of(samples[(samples.time_s < 4.0) | (samples.time_s >= 5.9)])
    assert len(moves) == 5
