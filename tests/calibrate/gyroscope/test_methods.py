"""The gyroscope by other methods: they prove one another, on every path that is searched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gyroscope_sessions import Session, simulate

from imufield.calibrate.gyroscope.calibrate import calibrate_gyroscope
from imufield.calibrate.gyroscope.input import GyroscopeInput
from imufield.calibrate.gyroscope.methods import cross_check_gyroscope, searched_fit, solve_gyroscope_with
from imufield.calibrate.gyroscope.result import GyroscopeResult
from imufield.calibrate.gyroscope.turntable import TurntableRun
from imufield.calibrate.model.models import recover
from imufield.calibrate.model.result import GyroscopeParameters
from imufield.calibrate.moves.moves import cut_moves
from imufield.calibrate.moves.slots import no_slots
from imufield.errors import Reason, UsageError
from imufield.sentences import Sentences
from tests.refused import refused
from tests.told import key_of

sentence = Sentences("imufield.calibrate.gyroscope")


def values(result: GyroscopeResult) -> np.ndarray:
    p = result.calibration.parameters
    return np.concatenate([p.scale, p.misalignment_rad.ravel(), p.bias, p.g_sensitivity.ravel()])


def sigmas(result: GyroscopeResult) -> np.ndarray:
    p = result.calibration.sigma
    return np.nan_to_num(np.concatenate([p.scale, p.misalignment_rad.ravel(), p.bias, p.g_sensitivity.ravel()]), nan=np.inf)


@pytest.fixture(scope="module")
def session() -> Session:
    return simulate(3)


@pytest.fixture(scope="module")
def result(session: Session) -> GyroscopeResult:
    return calibrate_gyroscope(session.given)


@pytest.fixture(scope="module")
def still(session: Session) -> GyroscopeInput:
    """The stills of a gyroscope that sees the Earth turn: made from the truth, with 0.003 deg/sqrt(h) for 60 s."""
    rng = np.random.default_rng(5)
    given, truth = session.given, session.truth
    accelerometer = given.calibration.accelerometer
    up = recover(accelerometer, given.observations.mean_raw)
    up /= np.linalg.norm(up, axis=1)[:, None]
    level = np.cross(up, rng.standard_normal(up.shape))
    level /= np.linalg.norm(level, axis=1)[:, None]
    rate = 7.292115e-5 * np.sqrt(0.5) * (up + level)
    sigma = np.radians(0.003 / 60) / np.sqrt(60.0)
    clean = truth.scale * (rate @ (np.eye(3) + truth.misalignment_rad).T)
    mean = clean + truth.scale * sigma * rng.standard_normal(up.shape) + 1e-4 * truth.scale
    covariance = np.tile(np.diag((truth.scale * sigma) ** 2), (len(up), 1, 1))
    observations = replace(given.observations, gyroscope_mean_raw=mean, gyroscope_covariance_raw=covariance)
    preset = GyroscopeParameters(truth.scale, truth.misalignment_rad, np.zeros(3), np.zeros((3, 3)))
    none = cut_moves(no_slots(), observations.start_s, observations.duration_s)
    return replace(given, observations=observations, moves=none, preset=preset)


def test_methods_prove_one_another_on_moves(result: GyroscopeResult) -> None:
    check = cross_check_gyroscope(result, rng=np.random.default_rng(0))
    assert check is not None
    assert check.agree, check.sentence
    assert check.what == "gyroscope"
    assert "bsas, ide, least-squares" in check.sentence
    assert 0.0 < check.own_costs.sigma < 3.0
    assert check.one_cost.sigma < 0.02
    assert check.own_costs.parameter.startswith("gyroscope.")


@pytest.mark.parametrize("method", ["bsas", "ide"])
def test_a_polished_method_ends_where_the_fit_does(result: GyroscopeResult, method: str) -> None:
    found, solved = solve_gyroscope_with(method, result, rng=np.random.default_rng(0))
    assert solved is not None
    assert solved.converged, solved.message
    assert np.all(np.abs(values(found) - values(result)) <= 0.01 * sigmas(result))
    assert found.moves.rms_after_deg == pytest.approx(result.moves.rms_after_deg, rel=1e-3)
    assert key_of(solved.message) == "base.polished"


def test_without_polish_the_swarm_keeps_the_minimum_of_its_own_cost(result: GyroscopeResult) -> None:
    found, solved = solve_gyroscope_with("bsas", result, rng=np.random.default_rng(0), polish=False)
    again = searched_fit(result)
    assert solved is not None
    assert again is not None
    fitted = again.linearise(result.basis.chosen.fit.p[result.basis.chosen.fit.free])[0]
    assert solved.cost < np.abs(fitted).sum()
    assert solved.cost == pytest.approx(np.abs(again.linearise(solved.x)[0]).sum(), rel=1e-9)
    apart = np.abs(values(found) - values(result)) / np.where(sigmas(result) > 0, sigmas(result), np.inf)
    assert 0.01 < apart.max() < 3.0


def test_least_squares_is_what_it_was(result: GyroscopeResult) -> None:
    assert solve_gyroscope_with("least-squares", result, rng=np.random.default_rng(0)) == (result, None)


def test_a_method_that_stops_short_says_so(result: GyroscopeResult) -> None:
    _, solved = solve_gyroscope_with("bas", result, rng=np.random.default_rng(0))
    assert solved is not None
    assert not solved.converged
    with refused(UsageError, Reason.USAGE, "least-squares, bsas", key="registry.unknown") as caught:
        solve_gyroscope_with("magic", result, rng=np.random.default_rng(0))
    assert caught.value.values["method"] == "magic"


@pytest.mark.parametrize("free", ["bias", "all"])
def test_methods_prove_one_another_on_the_norm_of_the_earth_rate(still: GyroscopeInput, free: str) -> None:
    found = calibrate_gyroscope(replace(still, static_free=free))  # type: ignore[arg-type]
    assert key_of(found.calibration.path) == f"result.norm_{free}"
    check = cross_check_gyroscope(found, rng=np.random.default_rng(0))
    assert check is not None
    assert check.agree, check.sentence
    solved = solve_gyroscope_with("ide", found, rng=np.random.default_rng(0))
    assert np.all(np.abs(values(solved[0]) - values(found)) <= 0.01 * sigmas(found) + 1e-12 * np.abs(values(found)))


def test_turntable_rates_are_searched_in_the_vector_form(session: Session) -> None:
    rng = np.random.default_rng(2)
    truth = session.truth
    KE = truth.scale[:, None] * (np.eye(3) + truth.misalignment_rad)
    runs = [
        TurntableRun(
            axis=axis,
            rate_rad_s=way * float(np.radians(speed)),
            mean_raw=KE @ (way * np.radians(speed) * axis) + truth.bias + 1e-6 * truth.scale * rng.standard_normal(3),
            covariance_raw=np.diag((1e-6 * truth.scale) ** 2),
        )
        for axis in np.eye(3)
        for speed in (10.0, 20.0, 30.0)
        for way in (1.0, -1.0)
    ]
    with_table = calibrate_gyroscope(replace(session.given, turntable=runs))
    assert sentence("result.table", pairs=9) in with_table.calibration.path
    check = cross_check_gyroscope(with_table, rng=np.random.default_rng(0))
    assert check is not None
    assert check.agree, check.sentence


def test_a_static_bias_is_a_mean_and_nothing_is_searched(session: Session) -> None:
    given = session.given
    none = cut_moves(no_slots(), given.observations.start_s, given.observations.duration_s)
    found = calibrate_gyroscope(replace(given, moves=none, nominal_scale=1.0))
    assert cross_check_gyroscope(found, rng=np.random.default_rng(0)) is None
    assert solve_gyroscope_with("bsas", found, rng=np.random.default_rng(0)) == (found, None)
