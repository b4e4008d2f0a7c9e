"""What few moves do not tell is in the sigma, or left at the preset; and a preset that is far off is no trap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from gyroscope_sessions import Session, ratios, simulate, vector

from imufield.calibrate.gyroscope import residual_covariance
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.guide.positions import scheme
from imufield.samples import Samples
from tests.told import key_of, told


def interrupted(seed: int, lost: Sequence[int], *, grade: str = "mems") -> Session:
    """Simulate six positions, between which samples are lost in the moves of these numbers."""
    begin = np.roll(scheme("faces6").directions(), seed, axis=0)
    moves = simulate(seed, positions=begin, grade=grade).given.moves
    middle_s = (moves.start_s + moves.end_s)[list(lost)] / 2

    def lose(block: Samples) -> Samples:
        return block[np.flatnonzero(np.abs(block.time_s - middle_s[:, None]).min(axis=0) > 0.5)]

    return simulate(seed, positions=begin, grade=grade, damage=lose, latitude_deg=None if seed % 2 else 45.0)


@pytest.mark.parametrize(("grade", "lost"), [("mems", (1, 3)), ("mems", (2,)), ("navigation", (1, 3))])
def test_few_moves_tell_no_scatter(grade: str, lost: tuple[int, ...]) -> None:
    """Few turns and stills leave their scatter no degrees of freedom: it came out of rounding, with errors of 340 sigma."""
    found = []
    for seed in range(6):
        session = interrupted(seed, lost, grade=grade)
        result = calibrate_gyroscope(session.given)
        assert len(result.moves.after_deg) == 6 - len(lost)
        assert "result.few_moves" in [key_of(caution) for caution in result.cautions]
        fitted = np.isfinite(vector(result.calibration.sigma))
        assert np.count_nonzero(fitted) >= 9
        found.append(ratios(session, result)[fitted])
    ratio = np.concatenate(found)
    assert np.abs(ratio).max() < 4.5
    assert 0.3 < np.sqrt(np.mean(ratio**2)) < 1.3


def test_a_scale_that_is_hardly_known_is_not_good() -> None:
    """Also where another is not observable at all: the sigma of that one is no number."""
    result = calibrate_gyroscope(interrupted(1, (1, 3, 5)).given)
    assert np.isnan(result.calibration.sigma.scale).any()
    (coarse,) = told(result.cautions, "result.coarse")
    share = result.calibration.sigma.scale / result.calibration.parameters.scale
    assert coarse.values["found"] == pytest.approx(1e6 * np.nanmax(np.abs(share)))
    assert coarse.values["found"] > coarse.values["limit"] == 5e3
    assert not told(calibrate_gyroscope(simulate(1).given).cautions, "result.coarse")


@pytest.mark.parametrize(("stands_still", "is_apart"), [(True, True), (False, False)])
def test_a_gyroscope_that_contradicts_its_moves_is_poor(stands_still: bool, is_apart: bool) -> None:
    given = simulate(2).given
    begin_s, end_s = given.moves.start_s[5], given.moves.end_s[5]

    def still(block: Samples) -> Samples:
        inside = (block.time_s > begin_s) & (block.time_s < end_s)
        return replace(block, gyroscope=np.where(inside[:, None] & stands_still, given.rest_raw, block.gyroscope))

    result = calibrate_gyroscope(simulate(2, damage=still).given)
    found = told(result.faults, "result.apart")
    assert bool(found) is is_apart
    if is_apart:
        assert found[0].values["found"] == pytest.approx(result.moves.rms_after_deg)
    assert (result.moves.rms_after_deg > 5) is is_apart


@pytest.mark.parametrize("seed", range(4))
def test_what_tells_a_scatter_at_a_glance_tells_it_by_the_whole_sum(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """The quick bound says yes where it is sure, of stills, turns and stops, and of a matrix of any form never too soon."""
    random = np.random.default_rng(seed)
    root, noise = random.standard_normal((40, 12)), random.standard_normal((40, 40))
    others = noise @ noise.T
    # Of residuals that one of the cases touches.
    jacobian = np.pad(random.standard_normal((12, 10)), ((14, 14), (0, 0)))
    apart = np.zeros((40, 40))
    apart[range(13), range(13)] = random.uniform(0.1, 10, 13)
    cases = [apart, root @ root.T, np.pad(np.eye(12), 14), apart + np.pad(root[:12] @ root[:12].T, 14), np.eye(40)]
    quick = [residual_covariance._has_freedom(V, others, jacobian[:, :count]) for V in cases for count in (1, 7, 10)]
    # At once, of what stands apart: the whole sum is not asked for.
    with monkeypatch.context() as patch:
        patch.delattr(residual_covariance, "_projection")
        assert residual_covariance._has_freedom(apart, others, jacobian[:, :1])
    monkeypatch.setattr(residual_covariance, "_uncoupled_rows", lambda _: np.empty(0, dtype=np.int64))
    whole = [residual_covariance._has_freedom(V, others, jacobian[:, :count]) for V in cases for count in (1, 7, 10)]
    assert quick == whole
    assert {*whole} == {True, False}


@pytest.mark.parametrize("seed", [4, 11])
def test_few_moves_that_tell_a_sum_of_asymmetries_move_no_scale(seed: int) -> None:
    """Each term alone seemed to be shown: a size that was rounding moved parameters by 114 of their sigma."""
    session = interrupted(seed, [2], grade="tactical")
    alone = calibrate_gyroscope(session.given).calibration
    graded = calibrate_gyroscope(replace(session.given, grade="tactical")).calibration
    sigma = vector(alone.sigma)
    assert np.nanmax(np.abs(vector(graded.parameters) - vector(alone.parameters)) / sigma) < 0.01
    assert np.nanmax(vector(graded.sigma) / sigma) < 1.1


@pytest.mark.parametrize(
    ("grade", "seed", "moves"),
    [
        # Another hand was said, as two moves do not show every axis.
        ("mems", 1, 2),
        # The fit ran to another minimum, where one scale was near zero: 17.9 and 15.8 sigma.
        ("mems", 4, 3),
        ("mems", 4, 4),
        # Stills whose scatter nothing told, with g-sensitivity and a heading for each fitted: 583, 31 and 48 sigma.
        ("navigation", 5, 2),
        ("navigation", 8, 2),
        ("navigation", 4, 3),
    ],
)
def test_few_moves_with_a_preset_stay_within_their_sigma(grade: str, seed: int, moves: int) -> None:
    session = interrupted(seed, range(moves, 6), grade=grade)
    rng = np.random.default_rng(seed)
    truth = session.truth
    scale = truth.scale * rng.normal(1.0, 0.01, 3)
    off = np.where(np.eye(3) > 0, 0.0, rng.normal(0.0, 0.005, (3, 3)))
    preset = replace(truth, scale=scale, misalignment_rad=truth.misalignment_rad + off)
    result = calibrate_gyroscope(replace(session.given, preset=preset, grade=grade))
    assert len(result.moves.after_deg) == moves
    fitted = np.isfinite(vector(result.calibration.sigma))
    assert np.abs(ratios(session, result)[fitted]).max() < 4.5


@pytest.mark.parametrize("share", [0.4, 0.5, 2.0, 2.5])
def test_a_preset_of_another_range_leads_to_no_other_minimum(share: float) -> None:
    """From half of the scale the fit ended elsewhere, with errors of up to 1616 sigma."""
    session = simulate(3)
    right = calibrate_gyroscope(replace(session.given, preset=session.truth)).calibration
    wrong = replace(session.truth, scale=session.truth.scale * share)
    found = calibrate_gyroscope(replace(session.given, preset=wrong)).calibration
    assert np.nanmax(np.abs(vector(found.parameters) - vector(right.parameters)) / vector(right.sigma)) < 1e-3
