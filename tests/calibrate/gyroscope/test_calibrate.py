"""The gyroscope's paths on simulated sessions; on real recordings: ``test_real_recordings``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gyroscope_sessions import Session, Turn, collect_moves, ratios, record, rolled, simulate, vector

from imufield.calibrate.gyroscope import fit, residual_covariance
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput, make_data
from imufield.calibrate.gyroscope.move_integration import integrate, rough_inverse
from imufield.calibrate.gyroscope.residual_covariance import Covariances, Scatter
from imufield.calibrate.gyroscope.residuals import evaluate
from imufield.calibrate.gyroscope.result import (
    GyroscopeResult,
    JointSolution,
    MoveReport,
    angle_errors_deg,
    forward,
    is_hardly_better,
    is_worse,
)
from imufield.calibrate.gyroscope.turntable import TurntableRun
from imufield.calibrate.gyroscope.whole_turns import Stop
from imufield.calibrate.model.budget import combined_sigma
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, GRAVITY_NAME, GYROSCOPE_NAMES
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.guide.positions import scheme
from imufield.samples import FloatArray, IntArray, Samples, SampleUnits
from imufield.sentences import Sentences
from imufield.simulate.truth.motion import Site
from tests.refused import refused
from tests.told import key_of, told

sentence = Sentences("imufield.calibrate.gyroscope")


@pytest.fixture(scope="module")
def session() -> Session:
    return simulate(3)


@pytest.fixture(scope="module")
def result(session: Session) -> GyroscopeResult:
    return calibrate_gyroscope(session.given)


@pytest.fixture(scope="module")
def fine() -> Session:
    """A session of a gyroscope that sees the Earth turn."""
    return simulate(1, grade="navigation", hold_s=15.0)


def test_hand_moves_alone_give_all_21_parameters_within_their_sigma(session: Session, result: GyroscopeResult) -> None:
    found = [ratios(session, result)]
    for seed in range(2):
        one = simulate(seed)
        found.append(ratios(one, calibrate_gyroscope(one.given)))
    assert np.sqrt(np.mean(np.square(found))) < 1.3
    assert np.abs(found).max() < 4.5


def test_the_path_is_told_and_the_moves_reported(result: GyroscopeResult) -> None:
    assert sentence("result.moves", moves=24, stills=25) in result.calibration.path
    assert sentence("result.g_sensitivity") in result.calibration.path
    assert result.moves.rms_after_deg < 0.06 < result.moves.rms_before_deg
    assert len(result.moves.after_deg) == 24
    assert result.unobservable == ()
    assert np.all(result.calibration.sigma.scale < 2e-4)


def test_one_joint_covariance(session: Session, result: GyroscopeResult) -> None:
    joined = result.join(session.calibration)
    names = joined.covariance_names
    assert [name for name in names if name.startswith("gyroscope")] == list(GYROSCOPE_NAMES)
    assert names[-1] == GRAVITY_NAME
    assert joined.covariance == pytest.approx(joined.covariance.T)
    place = names.index("gyroscope.scale.x")
    assert np.sqrt(joined.covariance[place, place]) == pytest.approx(result.calibration.sigma.scale[0])
    free = np.diag(joined.covariance) > 0
    size = np.sqrt(np.diag(joined.covariance)[free])
    assert np.linalg.eigvalsh(joined.covariance[np.ix_(free, free)] / np.outer(size, size)).min() > -1e-9
    # Both triads are written in one frame: what turns the accelerometer's turns the gyroscope's misalignment.
    rows = [k for k, name in enumerate(names) if name in ACCELEROMETER_NAMES]
    columns = [k for k, name in enumerate(names) if name.startswith("gyroscope.misalignment")]
    assert np.abs(joined.covariance[np.ix_(rows, columns)]).max() > 0
    assert [one.values["moves"] for one in told(joined.quality.reasons, "result.angle_errors")] == [24]


def test_the_shares_are_the_covariance_and_the_earth_s_is_that_of_its_prior(session: Session, result: GyroscopeResult) -> None:
    for found in (result, calibrate_gyroscope(replace(session.given, latitude_deg=None), "basic")):
        joined = found.join(session.calibration)
        assert combined_sigma(joined.budget) ** 2 == pytest.approx(np.diag(joined.covariance), rel=1e-9, abs=1e-24)
        assert isinstance(found.basis, JointSolution)
        fitted = found.basis.chosen.fit
        prior = fit.make_prior(found.basis.data, heading=fitted.heading_fitted).rows(fitted.p, fitted.free)[1]
        by_prior = fitted.covariance @ prior.T @ prior @ fitted.covariance
        size = np.sqrt(np.diag(fitted.covariance))
        assert fitted.shares["earth_rate"] / np.outer(size, size) == pytest.approx(by_prior / np.outer(size, size), abs=1e-6)


def test_a_joint_covariance_is_one_whatever_raised_the_parts(session: Session, result: GyroscopeResult) -> None:
    """Raised sigmas of the accelerometer once made some combination of both triads' parameters surer than sure."""
    joined = replace(result, with_accelerometer=8 * result.with_accelerometer).join(session.calibration)
    sigma = np.sqrt(np.diag(joined.covariance))
    np.testing.assert_array_equal(sigma, np.sqrt(np.diag(result.join(session.calibration).covariance)))
    size = sigma[sigma > 0]
    correlation = joined.covariance[np.ix_(sigma > 0, sigma > 0)] / np.outer(size, size)
    assert np.linalg.eigvalsh(correlation).min() > -1e-9
    assert np.abs(correlation).max() <= 1 + 1e-9
    changed = joined.covariance != result.join(session.calibration).covariance
    assert changed.any(), "nothing was too large"


def test_forward_derivative() -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([(np.eye(3) + 0.02 * rng.standard_normal((3, 3))).ravel(), 0.01 * rng.standard_normal(12)])
    values, J = forward(x, np.array([3.0, 1.0, 2.0]))
    step = 1e-7 * rng.standard_normal(21)
    change = (forward(x + step, np.array([3.0, 1.0, 2.0]))[0] - forward(x - step, np.array([3.0, 1.0, 2.0]))[0]) / 2
    assert change == pytest.approx(J @ step, abs=1e-12)
    assert len(values) == len(GYROSCOPE_NAMES)


def test_residual_derivatives(session: Session) -> None:
    data = make_data(session.given)
    rng = np.random.default_rng(2)
    p = np.zeros(data.parameters)
    p[:9] = np.eye(3).ravel()
    p[9:21] = 1e-4 * rng.standard_normal(12)
    now = evaluate(p, data)
    step = np.zeros(data.parameters)
    step[:21] = 1e-6 * rng.standard_normal(21)
    # With no turns remembered each is integrated.
    after, before = (evaluate(p + sign * step, replace(data, known_turns={})).residual for sign in (1, -1))
    change = (after - before) / 2
    assert change == pytest.approx(now.jacobian @ step, abs=2e-9)


def test_turns_near_integrated_ones_are_those_of_an_integration(session: Session) -> None:
    data = make_data(session.given)
    x = vector(session.truth)
    data.turns(x)
    # A millionth of each parameter, over turns of up to 3 rad.
    beside = x * (1 + 1e-6 * np.random.default_rng(0).standard_normal(len(x)))
    near, anew = data.turns(beside), integrate(beside, data.moves, data.noise_density_raw)
    assert 1e-7 < np.abs(near.quaternion - data.turns(x).quaternion).max() < 1e-5
    assert np.abs(near.quaternion - anew.quaternion).max() < 1e-10
    far = data.turns(1.01 * x)
    assert np.array_equal(far.quaternion, integrate(1.01 * x, data.moves, data.noise_density_raw).quaternion)


@pytest.mark.parametrize(("seed", "count"), [(21, 7), (22, 9), (24, 7)])
def test_a_fit_ends_where_the_next_step_is_small(monkeypatch: pytest.MonkeyPatch, seed: int, count: int) -> None:
    """Few positions, some directions stiff and some loose: a small step does not tell that the next one is smaller."""
    directions, steps = scheme("paper24").directions(), []
    original = fit._linear_step

    def kept(*given: object, free: IntArray, **named: object) -> object:
        step = original(*given, free=free, **named)  # type: ignore[arg-type]  # handed on as it is
        steps.append(step.size / len(free))
        return step

    monkeypatch.setattr(fit, "_linear_step", kept)
    shown = directions[np.random.default_rng(seed).permutation(24)[:count]]
    few = simulate(seed, rate_hz=25.0, grade="navigation", positions=shown, hold_s=4.0)
    for latitude_deg in (45.0, None):
        calibrate_gyroscope(replace(few.given, latitude_deg=latitude_deg), "basic")
        # The last is computed at the end, and not taken.
        assert steps[-1] < 1e-8


def test_model_is_chosen_by_significance(session: Session, fine: Session) -> None:
    basic = calibrate_gyroscope(session.given, "basic")
    assert told(basic.reasons, "model_choice.basic_as_asked")
    assert np.isnan(basic.calibration.sigma.g_sensitivity).all()
    assert not basic.calibration.parameters.g_sensitivity.any()
    assert told(calibrate_gyroscope(session.given, "g-sensitive").reasons, "model_choice.fitted_as_asked")
    kept = calibrate_gyroscope(fine.given)
    assert not kept.calibration.parameters.g_sensitivity.any()
    assert told(kept.reasons, "model_choice.left_out")


def test_a_fine_gyroscope_finds_north_and_checks_the_latitude(fine: Session) -> None:
    result = calibrate_gyroscope(fine.given, "basic")
    assert sentence("result.azimuth") in result.calibration.path
    assert np.abs(np.degrees(result.calibration.parameters.bias - fine.truth.bias) * 3600).max() < 0.03
    assert told(result.reasons, "stills_alone.latitude_seen")[0].values["observed_deg"] == pytest.approx(45.0, abs=0.5)
    wrong = calibrate_gyroscope(replace(fine.given, latitude_deg=45.5), "basic")
    assert told(wrong.cautions, "stills_alone.latitude_contradicted")


@pytest.mark.parametrize("latitude_deg", [-45.0, 12.0, 45.5])
def test_a_wrong_latitude_is_no_g_sensitivity(fine: Session, latitude_deg: float) -> None:
    result = calibrate_gyroscope(replace(fine.given, latitude_deg=latitude_deg))
    assert not result.calibration.parameters.g_sensitivity.any()
    (said,) = told(result.cautions, "stills_alone.latitude_contradicted")
    assert said.values["observed_deg"] == pytest.approx(45.0, abs=0.5)
    assert result.verdict == "usable"


def test_a_fitted_g_sensitivity_that_is_a_latitude_is_said_to_be_one(session: Session, fine: Session) -> None:
    wrong = calibrate_gyroscope(replace(fine.given, latitude_deg=-45.0), "g-sensitive")
    (said,) = told(wrong.cautions, "calibrate.alike")
    assert said.values["observed_deg"] == pytest.approx(45.0, abs=0.5)
    assert not told(calibrate_gyroscope(fine.given, "g-sensitive").cautions, "calibrate.alike")
    # Beside nine large entries it is one of them.
    hidden = calibrate_gyroscope(replace(session.given, latitude_deg=-45.0))
    assert hidden.calibration.parameters.g_sensitivity.any()
    assert hidden.verdict == "good"


def test_a_latitude_that_no_heading_shows_is_contradicted(fine: Session) -> None:
    # So near to the pole the horizontal rate is too small for a heading.
    polar = calibrate_gyroscope(replace(fine.given, latitude_deg=89.95), "basic")
    assert sentence("result.azimuth") not in polar.calibration.path
    assert told(polar.cautions, "stills_alone.latitude_contradicted")


def test_without_a_latitude_the_earth_is_in_the_sigma(session: Session, result: GyroscopeResult) -> None:
    unknown = calibrate_gyroscope(replace(session.given, latitude_deg=None))
    assert sentence("result.no_latitude") in unknown.calibration.path
    assert np.all(unknown.calibration.sigma.g_sensitivity[range(3), range(3)] > result.calibration.sigma.g_sensitivity.min())


def test_rolled_whole_turns_sharpen_the_scale(result: GyroscopeResult) -> None:
    turned = simulate(3, turns=rolled(3))
    sharp = calibrate_gyroscope(turned.given)
    assert len(sharp.turns) == 18
    assert len(told(sharp.turns, "whole_turns.rolled_and_before")) == 18
    assert sorted({turn.values["turns"] for turn in sharp.turns}) == [-1, 1]
    assert np.all(result.calibration.sigma.scale > 2.7 * sharp.calibration.sigma.scale)
    assert np.abs(ratios(turned, sharp)[:3]).max() < 3.5
    assert sentence("result.rolled", turns=18) in sharp.calibration.path


UPRIGHT = tuple(Turn(np.eye(3)[axis], way * 2 * np.pi, upright=True) for axis in range(3) for way in (1.0, -1.0))
SHORT = Turn(np.array([0, 0, 1.0]), np.radians(352.0), upright=True)


@pytest.fixture(scope="module")
def turned() -> Session:
    """A session with whole turns about the vertical, and one that was not whole."""
    return simulate(3, turns=(*UPRIGHT, SHORT))


def test_turns_about_the_vertical_need_a_stop(turned: Session) -> None:
    stops = tuple(Stop(time_s, np.radians(0.01)) for time_s in turned.turn_times_s[: len(UPRIGHT)])
    without = calibrate_gyroscope(turned.given)
    with_stops = calibrate_gyroscope(replace(turned.given, stops=stops))
    coarse = calibrate_gyroscope(replace(turned.given, stops=tuple(replace(stop, repeatability_rad=0.02) for stop in stops)))
    assert {turn.key for turn in with_stops.turns} == {"whole_turns.upright_and_before"}
    assert np.all(without.calibration.sigma.scale > 1.5 * with_stops.calibration.sigma.scale)
    assert np.all(coarse.calibration.sigma.scale > 0.9 * without.calibration.sigma.scale)
    assert np.abs(ratios(turned, with_stops)[:3]).max() < 3.5


def test_a_turn_that_was_not_whole_is_named_with_what_is_missing(turned: Session) -> None:
    stops = tuple(Stop(time_s, np.radians(0.01)) for time_s in turned.turn_times_s)
    found = calibrate_gyroscope(replace(turned.given, stops=stops))
    (missed,) = told(found.reasons, "calibrate.not_whole")
    assert abs(missed.values["missed_deg"]) == pytest.approx(8.0, abs=0.15)
    assert sentence("result.stops", stops=6) in found.calibration.path
    with refused(UsageError, Reason.USAGE, "-5 s", key="whole_turns.no_move"):
        calibrate_gyroscope(replace(turned.given, stops=(Stop(-5.0, 1e-3),)))
    with refused(UsageError, Reason.USAGE, "57.2958 deg", key="whole_turns.repeatability"):
        calibrate_gyroscope(replace(turned.given, stops=(Stop(stops[0].time_s, 1.0),)))


def test_turntable_rates_join_the_fit(session: Session, result: GyroscopeResult) -> None:
    truth = session.truth
    M = truth.scale[:, None] * (np.eye(3) + truth.misalignment_rad)
    noise, rng = 1e-6, np.random.default_rng(8)
    runs = [
        TurntableRun(
            axis=axis,
            rate_rad_s=w,
            mean_raw=M @ axis * w + truth.bias + noise * rng.standard_normal(3),
            covariance_raw=noise**2 * np.eye(3),
        )
        for axis in np.eye(3)
        for w in np.radians([10.0, -10.0, 30.0, -30.0])
    ]
    joined = calibrate_gyroscope(replace(session.given, turntable=runs))
    assert sentence("result.table", pairs=6) in joined.calibration.path
    assert np.all(joined.calibration.sigma.scale < 0.1 * result.calibration.sigma.scale)
    assert np.abs(ratios(session, joined)[:9]).max() < 4
    # Alone they tell all, whatever a preset says.
    stills = collect_moves([], session.given.observations.start_s[:1], session.given.observations.duration_s[:1])
    wrong = replace(truth, scale=2 * truth.scale)
    alone = calibrate_gyroscope(replace(session.given, moves=stills, turntable=runs, preset=wrong))
    assert np.abs(ratios(session, alone)[:9]).max() < 4


def test_positions_about_one_axis_leave_the_rest_at_the_preset() -> None:
    # The accelerometer needs all positions; the gyroscope is given the moves about z alone.
    full = simulate(5)
    keep = full.given.observations
    ring = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.radians(np.arange(0, 720, 60))])
    flat = simulate_ring(ring)
    given = replace(flat, calibration=full.calibration, preset=full.truth)
    result = calibrate_gyroscope(given)
    assert set(result.unobservable) <= set(GYROSCOPE_NAMES[:9])
    assert "gyroscope.scale.x" in result.unobservable
    assert "gyroscope.scale.z" not in result.unobservable
    assert np.isnan(result.calibration.sigma.scale[0])
    assert result.calibration.parameters.scale[0] == pytest.approx(full.truth.scale[0], rel=1e-3)
    assert "gyroscope.scale.x" in told(result.reasons, "result.hidden")[0].values["names"]
    angles = {name.rpartition(".")[2] for name in result.unobservable if "misalignment" in name}
    hidden = tuple(np.array([["xyz".index(axis) for axis in pair] for pair in sorted(angles)]).T)
    assert angles
    np.testing.assert_array_equal(result.calibration.parameters.misalignment_rad[hidden], full.truth.misalignment_rad[hidden])
    counts = replace(
        given,
        preset=None,
        observations=replace(given.observations, units=SampleUnits(accelerometer="count", gyroscope="count")),
    )
    with refused(CalibrationError, Reason.UNOBSERVABLE, key="observability.hidden_scale") as caught:
        calibrate_gyroscope(counts)
    assert "gyroscope.scale.x" in caught.value.values["names"]
    assert len(keep) == 25


def simulate_ring(directions: FloatArray) -> GyroscopeInput:
    """Positions about z alone, of the same instrument; its accelerometer cannot be calibrated from them."""
    observations, moves = record(5, directions)
    return GyroscopeInput(observations=observations, moves=moves, calibration=None, latitude_deg=45.0)  # type: ignore[arg-type]


def swung(given: GyroscopeInput, arm_m: float) -> GyroscopeInput:
    """Return the session as the accelerometer sees it so far from the hand: of the moves' specific force nothing is gravity."""
    slots = given.moves.slots
    duration_s, arm = slots.duration_s[:, None], arm_m * np.array([1.0, 0.6, -0.4])
    rate = slots.turn / duration_s
    swing = np.cross(np.gradient(rate, axis=0) / duration_s, arm) + np.cross(rate, np.cross(rate, arm))
    return replace(given, moves=replace(given.moves, slots=replace(slots, force=slots.force + swing * duration_s)))


@pytest.mark.parametrize("unit", ["rad/s", "count"])
def test_the_acceleration_of_the_hand_contradicts_no_gyroscope(session: Session, result: GyroscopeResult, unit: str) -> None:
    """A right one was said to have another hand; of one whose scale nobody knows only that acceleration told the start."""
    given = swung(session.given, 1.0)
    assert np.abs(rough_inverse(make_data(given).moves, np.eye(3)) - np.eye(3)).max() > 0.5
    units = replace(given.observations.units, gyroscope=unit)
    found = calibrate_gyroscope(replace(given, observations=replace(given.observations, units=units))).calibration
    change = vector(found.parameters) - vector(result.calibration.parameters)
    assert np.abs(change / vector(result.calibration.sigma)).max() < 1


@pytest.mark.parametrize("arm_m", [0.0, 1.0])
def test_wrong_unit_and_handedness_are_refused(session: Session, arm_m: float) -> None:
    session = replace(session, given=swung(session.given, arm_m))
    with refused(CalibrationError, Reason.UNITS, key="input.foreign_scale") as caught:
        calibrate_gyroscope(replace(session.given, nominal_scale=57.3))
    assert min(caught.value.values["ratio"]) > 3
    assert caught.value.reason is Reason.UNITS
    flipped = replace(
        session.given.moves.slots,
        turn=session.given.moves.slots.turn * [1, 1, -1],
        area=session.given.moves.slots.area * [-1, -1, 1],
        moment=session.given.moves.slots.moment * [1, 1, -1],
    )
    mirrored = replace(session.given, moves=replace(session.given.moves, slots=flipped))
    # Without and with something that says what the scale is: two ways lead to the refusal.
    for given in (mirrored, replace(mirrored, preset=session.truth)):
        with refused(CalibrationError, Reason.HANDEDNESS, key="input.handedness"):
            calibrate_gyroscope(given)


def test_missing_gyroscope_is_refused(session: Session) -> None:
    observations = session.given.observations
    nothing = np.full_like(observations.gyroscope_mean_raw, np.nan)
    with refused(CalibrationError, Reason.TOO_FEW, key="input.too_few_stills") as caught:
        calibrate_gyroscope(replace(session.given, observations=replace(observations, gyroscope_mean_raw=nothing)))
    assert caught.value.values["positions"] == 0
    one = observations.gyroscope_mean_raw.copy()
    one[3] = np.nan
    with refused(CalibrationError, Reason.NOT_FINITE, key="input.missing_mean") as caught:
        calibrate_gyroscope(replace(session.given, observations=replace(observations, gyroscope_mean_raw=one)))
    assert caught.value.values["positions"] == 1


def test_lost_samples_are_bridged_or_named() -> None:
    def lose(block: Samples) -> Samples:
        gap = (np.abs(block.time_s - 9.5) < 0.2) | (np.mod(block.time_s, 1.7) < 0.008)
        return block[np.flatnonzero(~gap)]

    lossy = simulate(3, damage=lose)
    result = calibrate_gyroscope(lossy.given)
    assert told(result.reasons, "moves.lost_samples")[0].values["missing_s"] == pytest.approx(0.4, abs=0.05)
    assert len(result.moves.after_deg) == 23
    assert told(result.reasons, "result.chains")[0].values["chains"] == 2
    assert np.abs(ratios(lossy, result)).max() < 4.5


def test_static_bias_where_there_are_no_moves(session: Session) -> None:
    nothing = collect_moves([], session.given.observations.start_s[:1], session.given.observations.duration_s[:1])
    result = calibrate_gyroscope(replace(session.given, moves=nothing))
    assert key_of(result.calibration.path).startswith("stills_alone.bias")
    joined = result.join(session.calibration)
    assert joined.gyroscope is not None
    assert np.isnan(joined.gyroscope.sigma.scale).all()


def test_static_norm_for_an_instrument_that_sees_the_earth(fine: Session) -> None:
    nothing = collect_moves([], fine.given.observations.start_s[:1], fine.given.observations.duration_s[:1])
    result = calibrate_gyroscope(replace(fine.given, moves=nothing, preset=fine.truth))
    assert key_of(result.calibration.path) == "result.norm_bias"
    assert np.abs(np.degrees(result.calibration.parameters.bias - fine.truth.bias) * 3600).max() < 0.05
    wrong = calibrate_gyroscope(replace(fine.given, moves=nothing, preset=fine.truth, latitude_deg=-45.0))
    assert told(wrong.cautions, "stills_alone.latitude_contradicted")
    everything = calibrate_gyroscope(replace(fine.given, moves=nothing, static_free="all"))
    assert np.isfinite(everything.calibration.sigma.scale).all()


@pytest.mark.parametrize(("factor", "is_told"), [(1.2, True), (0.8, True), (1.05, False)])
def test_scales_that_are_all_off_their_unit_are_told(factor: float, is_told: bool) -> None:
    """As by a wrong unit, or sample rate: turns are rate times step."""
    still = simulate(1, grade="tactical")
    scale = float(calibrate_gyroscope(still.given).calibration.parameters.scale.mean())
    found = calibrate_gyroscope(replace(still.given, nominal_scale=scale / factor))
    caution = told(found.cautions, "result.off_unit")
    assert bool(caution) is is_told
    if is_told:
        assert caution[0].values["found"] == pytest.approx(abs(factor - 1), abs=0.01)
        assert found.join(still.calibration).quality.verdict == "usable"


@pytest.mark.parametrize("grade", ["mems", "industrial", "tactical"])
def test_a_scatter_of_the_turns_that_is_far_too_large_comes_down(monkeypatch: pytest.MonkeyPatch, grade: str) -> None:
    """As where the scale is known to a sixth only, beside a wander with 10^20 times the information."""
    asked: list[tuple[Scatter, FloatArray, FloatArray, Covariances]] = []

    def heard(scatter: Scatter, residual: FloatArray, jacobian: FloatArray, parts: Covariances) -> Scatter:
        asked.append((scatter, residual, jacobian, parts))
        return residual_covariance.next_scatter(scatter, residual, jacobian, parts)

    monkeypatch.setattr(fit, "next_scatter", heard)
    calibrate_gyroscope(simulate(1, grade=grade).given)
    found, residual, jacobian, parts = asked[-1]
    assert found.turn_rad < 1e-3
    assert residual_covariance.next_scatter(Scatter(1e-6, 0.0, 0.08), residual, jacobian, parts).turn_rad < 0.01


def test_closing_errors_count_from_any_raw_zero(session: Session, result: GyroscopeResult) -> None:
    parameters = result.calibration.parameters
    about = parameters.about(np.array([500.0, 32768.0, -3.0]))
    before, after = angle_errors_deg(replace(session.given, preset=about), about)
    np.testing.assert_allclose(after, angle_errors_deg(session.given, parameters)[1], atol=1e-6)
    np.testing.assert_allclose(before, after, atol=1e-6)


def test_a_fit_that_does_not_end_makes_the_whole_poor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A latitude for data without the Earth's rate, as simulators that leave it out write them."""
    monkeypatch.setattr(Site, "earth_rate_n", property(lambda _: np.zeros(3)))
    still = simulate(1, grade="tactical")
    found = calibrate_gyroscope(still.given)
    joined = found.join(still.calibration).quality
    assert still.calibration.quality.verdict == "good"
    assert joined.verdict == "poor"
    assert key_of(joined.main_reason) == "result.unsettled"
    assert "--gravity" in joined.main_reason
    assert "--latitude" in joined.main_reason
    remedied = calibrate_gyroscope(replace(still.given, latitude_deg=None))
    assert remedied.cautions == remedied.faults == ()
    assert remedied.join(still.calibration).quality.verdict == "good"


def test_residuals_that_no_noise_explains_are_refused() -> None:
    with refused(CalibrationError, Reason.NOT_CONVERGED, key="fit.contradiction"):
        fit._whitening(np.array([[4.0, 5.0], [5.0, 4.0]]))


@pytest.mark.parametrize(
    ("before_deg", "after_deg", "hardly", "worse"),
    [(0.368, 0.312, True, False), (0.025, 0.078, False, True), (0.097, 0.012, False, False), (np.nan, 0.012, False, False)],
)
def test_what_a_fit_has_gained(before_deg: float, after_deg: float, *, hardly: bool, worse: bool) -> None:
    report = MoveReport(before_deg=np.full(6, before_deg), after_deg=np.full(6, after_deg), sigma=np.ones(6))
    assert (is_hardly_better(report), is_worse(report)) == (hardly, worse)


def test_scatter_that_overflows_is_a_contradiction(monkeypatch: pytest.MonkeyPatch, session: Session) -> None:
    # A capture that was resumed twice once led there: sizes that overflow, then eigenvalues that do not converge.
    def overflowing(scatter: Scatter, residual: FloatArray, jacobian: FloatArray, parts: Covariances) -> Scatter:
        return residual_covariance.next_scatter(Scatter(1e153, 1e153, 1e153), residual, jacobian, parts)

    monkeypatch.setattr(fit, "next_scatter", overflowing)
    with refused(CalibrationError, Reason.NOT_CONVERGED, key="fit.contradiction"):
        calibrate_gyroscope(session.given)
