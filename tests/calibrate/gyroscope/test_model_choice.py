"""Whether one scale serves all rates: the columns by simulated effects, the test by moves and by a turntable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from gyroscope_sessions import Session, simulate

from imufield.calibrate.gyroscope import model_choice
from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.fit import make_prior
from imufield.calibrate.gyroscope.input import make_data
from imufield.calibrate.gyroscope.model_choice import SCALES, _rate_columns, check_linearity, typical_rate_terms
from imufield.calibrate.gyroscope.residuals import evaluate
from imufield.calibrate.gyroscope.result import GyroscopeResult, JointSolution
from imufield.calibrate.gyroscope.turntable import TurntableRun
from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95
from imufield.calibrate.model.grades import GRADES
from imufield.calibrate.moves.moves import cut_moves
from imufield.calibrate.moves.slots import no_slots
from imufield.samples import FloatArray
from imufield.simulate.truth.effects import Effects
from imufield.simulate.truth.imu import ImuSettings
from tests.told import told

pytestmark = pytest.mark.numerical

ASYMMETRIC = (1e-3, -1e-3, 5e-4)
CUBIC = (1e-4, 2e-4, -1e-4)
NAMED = ("model_choice.asymmetry", "model_choice.nonlinearity")
ANALOGUE = ImuSettings(rate_hz=100.0, quantise=False)


def solution_of(result: GyroscopeResult) -> JointSolution:
    assert isinstance(result.basis, JointSolution)
    return result.basis


@pytest.fixture(scope="module")
def plain() -> Session:
    return simulate(3, grade="industrial")


@pytest.fixture(scope="module")
def analogue() -> Session:
    return simulate(3, grade="industrial", settings=ANALOGUE)


@pytest.fixture(scope="module")
def result(plain: Session) -> GyroscopeResult:
    return calibrate_gyroscope(plain.given)


@pytest.mark.parametrize(
    ("effects", "kind", "size"),
    [
        (Effects(gyroscope_asymmetry=ASYMMETRIC), slice(0, 3), ASYMMETRIC),
        (Effects(gyroscope_cubic=CUBIC), slice(3, 6), CUBIC),
    ],
    ids=["asymmetry", "nonlinearity"],
)
def test_the_columns_are_what_the_effects_do_to_the_residuals(
    result: GyroscopeResult, analogue: Session, effects: Effects, kind: slice, size: tuple[float, float, float]
) -> None:
    """The same session of one instrument with and without the effect, of the same noise: by simulation, not by derivation."""
    fit = solution_of(result).chosen.fit
    changed = simulate(3, grade="industrial", settings=ANALOGUE, effects=effects)
    without, with_effect = make_data(analogue.given), make_data(changed.given)
    before = evaluate(fit.p, without)
    range_rad_s, C, _ = _rate_columns(without, replace(fit, evaluation=before))
    relative = np.array(size) * (1 if kind.start == 0 else range_rad_s**2)
    moves = slice(0, 2 * before.moves)
    change = evaluate(fit.p, with_effect).residual[moves] - before.residual[moves]
    # What a residual misses is taken off: the column is that of the correction.
    expected = -C[moves, kind] @ relative
    assert np.corrcoef(change, expected)[0, 1] > 0.999
    assert np.linalg.norm(change - expected) < 0.03 * np.linalg.norm(change)


def test_a_clean_session_names_nothing_and_says_its_range(result: GyroscopeResult) -> None:
    assert not any(told(result.reasons, key) for key in NAMED)
    (said,) = told(result.reasons, "result.range")
    assert said.values["rates_deg_s"] == pytest.approx(np.degrees(result.calibration.range_rad_s))
    # The operator turns at 250 deg/s at most, wobble aside.
    assert np.all((result.calibration.range_rad_s > 1.5) & (result.calibration.range_rad_s < 6.0))
    assert 0 < said.values["asymmetry"] < said.values["nonlinearity"] < 0.01


def test_an_asymmetry_is_named_with_its_size_and_lowers_the_verdict() -> None:
    session = simulate(3, grade="industrial", effects=Effects(gyroscope_asymmetry=(0.0, 1e-3, 0.0)))
    found = calibrate_gyroscope(session.given)
    (named,) = told(found.cautions, "model_choice.asymmetry")
    assert named.values["axis"] == "y"
    assert named.values["size_ppm"] == pytest.approx(2000, abs=4 * named.values["sigma_ppm"])
    assert found.join(session.calibration).quality.verdict != "good"
    assert not told(found.cautions, "model_choice.nonlinearity")


def test_what_is_named_is_in_the_sigma() -> None:
    session = simulate(3, grade="industrial", effects=Effects(gyroscope_cubic=(3e-4, 3e-4, 3e-4)))
    found = calibrate_gyroscope(session.given)
    (named,) = told(found.cautions, "model_choice.nonlinearity")
    assert named.values["size_ppm"] > 0
    off = np.abs(found.calibration.parameters.scale - session.truth.scale)
    linearity = solution_of(found).linearity
    assert np.all(off < 2 * found.calibration.sigma.scale)
    assert np.linalg.norm(linearity.hidden_root[:9]) > 5e-4
    # The closing errors are those of the reported parameters, which the fit's are not.
    data, fit = solution_of(found).data, solution_of(found).chosen.fit
    up_after = data.up[data.moves.after]
    exact = evaluate(fit.p - linearity.moved, data).angle_error_rad(up_after)
    assert found.moves.after_deg == pytest.approx(np.degrees(exact), abs=1e-3)
    assert np.degrees(np.abs(exact - fit.evaluation.angle_error_rad(up_after)).max()) > 5e-3


def table(session: Session, rates_deg_s: Sequence[float], *, asymmetry: float = 0.0, cubic: float = 0.0) -> list[TurntableRun]:
    """Return runs both ways about each axis, off the axis of the table: the centripetal force acts on g-sensitivity."""
    truth = session.truth
    M: FloatArray = truth.scale[:, None] * (np.eye(3) + truth.misalignment_rad)
    noise, rng = 2e-6, np.random.default_rng(8)
    return [
        TurntableRun(
            axis=axis,
            rate_rad_s=way * w,
            mean_raw=M @ axis * (way * w + asymmetry * w + cubic * way * w**3) + truth.bias + 2e-6 * w**2
            + noise * rng.standard_normal(3),
            covariance_raw=noise**2 * np.eye(3),
        )
        for axis in np.eye(3)
        for w in np.radians(rates_deg_s)
        for way in (1.0, -1.0)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("asymmetry", "cubic", "key"),
    [(1e-4, 0.0, NAMED[0]), (0.0, 1e-5, NAMED[1]), (0.0, 0.0, "")],
    ids=["asymmetry", "cubic", ""],
)
def test_a_turntable_of_several_rates_shows_it_best(plain: Session, asymmetry: float, cubic: float, key: str) -> None:
    runs = table(plain, (25.0, 50.0, 100.0, 200.0), asymmetry=asymmetry, cubic=cubic)
    found = calibrate_gyroscope(replace(plain.given, turntable=runs))
    assert [sentence.key for sentence in solution_of(found).linearity.sentences] == ([key] if key else [])
    # Beside what is there it does not say what was not found.
    assert len(told(found.reasons, "result.range_of_named" if key else "result.range")) == 1
    for named in solution_of(found).linearity.sentences:
        true_ppm = 2e6 * asymmetry + 1e6 * cubic * found.calibration.range_rad_s.max() ** 2
        assert named.values["size_ppm"] == pytest.approx(true_ppm, rel=0.3)


def test_one_rate_shows_neither(plain: Session) -> None:
    stills = cut_moves(no_slots(), plain.given.observations.start_s, plain.given.observations.duration_s)
    found = calibrate_gyroscope(replace(plain.given, moves=stills, turntable=table(plain, (50.0,), asymmetry=0.01, cubic=0.01)))
    (said,) = told(found.reasons, "result.range_not_shown")
    assert said.values["not_shown"] == "asymmetry and nonlinearity"
    assert not solution_of(found).linearity.sentences
    assert np.degrees(found.calibration.range_rad_s) == pytest.approx(50.0, rel=0.02)


def test_what_is_not_shown_is_said_beside_what_is_named(plain: Session) -> None:
    stills = cut_moves(no_slots(), plain.given.observations.start_s, plain.given.observations.duration_s)
    runs = table(plain, (50.0, 55.0), cubic=0.01)
    found = calibrate_gyroscope(replace(plain.given, moves=stills, turntable=runs))
    assert [named.key for named in solution_of(found).linearity.sentences] == [NAMED[1]]
    assert [said.values["not_shown"] for said in told(found.reasons, "result.range_not_shown")] == ["asymmetry"]


@pytest.fixture
def counted_once(result: GyroscopeResult, monkeypatch: pytest.MonkeyPatch) -> tuple[FloatArray, FloatArray]:
    """Return largest rates and columns of the fit; every draw of its residuals is tested with these, which are its own."""
    solution = solution_of(result)
    columns = _rate_columns(solution.data, solution.chosen.fit)
    monkeypatch.setattr(model_choice, "_rate_columns", lambda *_: columns)
    return columns[0], columns[1]


@pytest.mark.statistical
@pytest.mark.usefixtures("counted_once")
def test_false_alarms_are_rare_in_linear_data(result: GyroscopeResult) -> None:
    """Residuals drawn from the stated covariance are named in one of a hundred, by both tests together."""
    solution = solution_of(result)
    fit, rng = solution.chosen.fit, np.random.default_rng(4)
    root = np.linalg.cholesky(fit.parts.total(fit.scatter))
    named = []
    for _ in range(400):
        drawn = root @ rng.standard_normal(len(root))
        linearity = check_linearity(solution.data, replace(fit, evaluation=replace(fit.evaluation, residual=drawn)))
        named.append(bool(linearity.sentences))
    assert 0.001 < np.mean(named) < 0.025


@pytest.mark.statistical
@pytest.mark.parametrize("grade", ["navigation", "mems"])
def test_typical_terms_are_covered_as_stated(
    result: GyroscopeResult, grade: str, counted_once: tuple[FloatArray, FloatArray]
) -> None:
    """Terms drawn from what is typical and residuals from the stated covariance: by error and truth of the linear model."""
    solution = solution_of(result)
    data, fit, rng = solution.data, solution.chosen.fit, np.random.default_rng(4)
    root = np.linalg.cholesky(fit.parts.total(fit.scatter))
    range_rad_s, C = counted_once
    typical = typical_rate_terms(range_rad_s, GRADES[grade])
    inside = []
    for _ in range(400):
        residual = root @ rng.standard_normal(len(root)) - C @ (typical * rng.standard_normal(6))
        drawn = replace(fit, evaluation=replace(fit.evaluation, residual=residual))
        linearity = check_linearity(data, drawn, GRADES[grade])
        sigma = np.sqrt(np.diag(fit.covariance)[SCALES] + np.sum(linearity.hidden_root[SCALES] ** 2, axis=1))
        off = (fit.gain @ residual)[SCALES] + linearity.moved[SCALES]
        inside.append(np.abs(off) < NORMAL_FACTOR_95 * sigma)
    assert 0.93 < np.mean(inside) < 0.97


def test_what_moves_leave_open_is_a_fit_of_both_with_priors(result: GyroscopeResult) -> None:
    """What is taken off and the variance that is added are those of a fit of both together, with a row for each prior."""
    solution = solution_of(result)
    data, fit = solution.data, solution.chosen.fit
    # Terms that seem to be smaller than typical.
    fit = replace(fit, evaluation=replace(fit.evaluation, residual=0.1 * fit.evaluation.residual))
    range_rad_s, C, _ = _rate_columns(data, fit)
    typical = typical_rate_terms(range_rad_s, GRADES["mems"])
    L, own = np.linalg.cholesky(fit.parts.total(fit.scatter)), len(fit.free)
    rows = np.linalg.solve(L, np.hstack([fit.evaluation.jacobian[:, fit.free], C]))
    prior_residual, prior_jacobian = make_prior(data, heading=fit.heading_fitted).rows(fit.p, fit.free)
    more = np.hstack([prior_jacobian, np.zeros((len(prior_jacobian), 6))])
    together = np.vstack([rows, more, np.hstack([np.zeros((6, own)), np.diag(1 / typical)])])
    residual = np.concatenate([np.linalg.solve(L, fit.evaluation.residual), prior_residual, np.zeros(6)])
    linearity = check_linearity(data, fit, GRADES["mems"])
    expected = np.diag(np.linalg.inv(together.T @ together))[SCALES] - np.diag(fit.covariance)[SCALES]
    assert np.sum(linearity.hidden_root[SCALES] ** 2, axis=1) == pytest.approx(expected, rel=0.02)
    off = np.linalg.lstsq(together, residual, rcond=None)[0][:own] - np.linalg.lstsq(together[:, :own], residual, rcond=None)[0]
    assert linearity.moved[SCALES] == pytest.approx(off[SCALES], rel=0.02)


def test_the_verdict_says_what_a_typical_nonlinearity_adds(plain: Session, result: GyroscopeResult) -> None:
    found = calibrate_gyroscope(replace(plain.given, grade="mems"))
    (said,) = told(found.reasons, "result.typical")
    assert said.values["grade"] == "mems"
    assert not told(result.reasons, "result.typical")
    more, less = (each.calibration.sigma.scale for each in (found, result))
    added_ppm = 1e6 * np.sqrt(np.max(more**2 - less**2)) / found.calibration.parameters.scale[0]
    assert said.values["scale_ppm"] == pytest.approx(added_ppm, rel=0.02)
    # Where the rates show all, little is left.
    runs = table(plain, (25.0, 50.0, 100.0, 200.0))
    shown = calibrate_gyroscope(replace(plain.given, grade="mems", turntable=runs))
    (less_said,) = told(shown.reasons, "result.typical")
    assert less_said.values["scale_ppm"] < said.values["scale_ppm"] / 5
