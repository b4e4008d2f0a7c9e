"""Whether one scale serves all rates: the columns by simulated effects, the test by moves and by a turntable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from gyroscope_sessions import Session, simulate

from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import make_data
from imufield.calibrate.gyroscope.model_choice import _rate_columns, check_linearity
from imufield.calibrate.gyroscope.moves import cut_moves, no_slots
from imufield.calibrate.gyroscope.report import GyroscopeResult, JointSolution
from imufield.calibrate.gyroscope.residuals import evaluate
from imufield.calibrate.gyroscope.turntable import TurntableRun
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
    result: GyroscopeResult, effects: Effects, kind: slice, size: tuple[float, float, float]
) -> None:
    """The same session of one instrument with and without the effect, of the same noise: by simulation, not by derivation."""
    fit = solution_of(result).chosen.fit
    without, with_effect = (
        make_data(simulate(3, grade="industrial", settings=ANALOGUE, effects=each).given) for each in (Effects(), effects)
    )
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
    (said,) = told(result.reasons, "report.range")
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
    assert np.linalg.norm(linearity.hidden_change[:9]) > 5e-4


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
    for named in solution_of(found).linearity.sentences:
        true_ppm = 2e6 * asymmetry + 1e6 * cubic * found.calibration.range_rad_s.max() ** 2
        assert named.values["size_ppm"] == pytest.approx(true_ppm, rel=0.3)


def test_one_rate_shows_neither(plain: Session) -> None:
    stills = cut_moves(no_slots(), plain.given.observations.start_s, plain.given.observations.duration_s)
    found = calibrate_gyroscope(replace(plain.given, moves=stills, turntable=table(plain, (50.0,), asymmetry=0.01, cubic=0.01)))
    (said,) = told(found.reasons, "report.range_not_shown")
    assert said.values["not_shown"] == "asymmetry and nonlinearity"
    assert not solution_of(found).linearity.sentences
    assert np.degrees(found.calibration.range_rad_s) == pytest.approx(50.0, rel=0.02)


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
