from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from calibration_truth import GRAVITY, campaign, random_parameters

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.accelerometer.methods import cross_check, problem_for, restart, solve_with
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.calibrate.solvers import library
from imufield.calibrate.solvers.agreement import AGREEMENT_SIGMA, SEARCH_AGREEMENT_SIGMA, CrossCheck
from imufield.calibrate.solvers.registry import METHODS
from imufield.earth import Gravity
from imufield.errors import CalibrationError, Reason, UsageError
from imufield.sentences import Sentences
from tests.refused import refused
from tests.told import told

KNOWN_GRAVITY = Gravity(gravity_m_s2=GRAVITY, sigma_m_s2=0.018, source="assumed")


def measured(seed: int, quadratic: float = 0.0) -> tuple[Observations, AccelerometerParameters]:
    rng = np.random.default_rng(seed)
    truth = random_parameters(rng, quadratic)
    return campaign(truth, rng), truth


@cache
def calibrated(seed: int, quadratic: float = 0.0) -> tuple[Observations, Calibration]:
    """Return a session and its calibration, which are not to be changed."""
    observations, _ = measured(seed, quadratic)
    return observations, calibrate_accelerometer(observations, KNOWN_GRAVITY)


@pytest.mark.parametrize("method", ["bsas", "ide"])
def test_a_polished_method_is_least_squares_from_elsewhere(method: str) -> None:
    observations, plain = calibrated(1)
    found = solve_with(method, observations, plain, rng=np.random.default_rng(0), seed=0)
    assert found.solver.method == method
    assert found.solver.converged
    assert found.solver.seed == 0
    sigma = np.sqrt(np.diag(plain.covariance)[:-1])
    moved = np.abs(to_vector(found.accelerometer) - to_vector(plain.accelerometer))[:12]
    assert np.all(moved <= 1e-3 * np.maximum(sigma[:12], 1e-12))
    assert found.quality.residual_rms_m_s2 == pytest.approx(plain.quality.residual_rms_m_s2, rel=1e-6)


def test_without_polish_the_method_keeps_its_own_minimum() -> None:
    observations, plain = calibrated(1)
    found = solve_with("bsas", observations, plain, rng=np.random.default_rng(0), polish=False)
    again = restart(observations, plain)
    absolute = [float(np.abs(c.positions.residual_m_s2).sum()) for c in (found, plain)]
    assert absolute[0] < absolute[1]
    assert found.solver.cost == pytest.approx(absolute[0], rel=1e-9)
    assert problem_for(again, "bsas").cost_name == "absolute"


def test_a_method_that_did_not_converge_is_called_poor_and_told_so_first() -> None:
    observations, plain = calibrated(1)
    found = solve_with("bas", observations, plain, rng=np.random.default_rng(0))
    assert not found.solver.converged
    assert found.quality.verdict == "poor"
    assert "bas did not converge" in found.quality.main_reason


@pytest.mark.parametrize(("seed", "quadratic", "moved"), [(1, 0.0, 12), (2, 0.05, 15)])
def test_the_staged_form_moves_the_fitted_parameters_themselves(seed: int, quadratic: float, moved: int) -> None:
    observations, plain = calibrated(seed, quadratic)
    assert problem_for(restart(observations, plain), "bsas-staged").basis.tolist() == np.eye(15)[:, :moved].tolist()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("seed", "quadratic", "polish"), [(1, 0.0, False), (2, 0.05, True)])
def test_every_method_gives_a_result_of_the_same_model(
    seed: int, quadratic: float, polish: bool, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The studies give these two all of the paper's generations; a small swarm converges in fewer, the genes never do.
    for name, settings in (
        ("solve_ga", library.LibrarySettings(generations=20)),
        ("solve_pso", library.LibrarySettings(population=25, generations=250, tolerance=1e-3)),
    ):
        monkeypatch.setattr(library, name, partial(getattr(library, name), settings=settings))
    observations, plain = calibrated(seed, quadratic)
    found = solve_with(method, observations, plain, rng=np.random.default_rng(0), polish=polish)
    assert np.isfinite(to_vector(found.accelerometer)).all()
    assert plain.quadratic_fitted or not np.any(found.accelerometer.quadratic)
    if found.solver.converged:
        # Each cost has a minimum of its own, a little from that of the squares.
        assert found.quality.residual_rms_m_s2 < 1.5 * plain.quality.residual_rms_m_s2
    else:
        assert found.quality.verdict == "poor"


def test_least_squares_is_what_there_is_already() -> None:
    observations, plain = calibrated(1)
    assert solve_with("least-squares", observations, plain, rng=np.random.default_rng(0)) is plain


def outcome(key: str, checked: CrossCheck) -> str:
    """Return what a check of the accelerometer says of its numbers."""
    told_by = Sentences("imufield.calibrate.solvers")
    return told_by(
        key,
        what="accelerometer",
        methods=list(checked.found),
        own=checked.own_costs,
        limit_sigma=AGREEMENT_SIGMA,
        shared=checked.one_cost,
        shared_limit_sigma=SEARCH_AGREEMENT_SIGMA,
    )


def test_an_unknown_method_is_refused() -> None:
    observations, plain = calibrated(1)
    with refused(UsageError, Reason.USAGE, "least-squares, bsas", key="registry.unknown") as caught:
        solve_with("magic", observations, plain, rng=np.random.default_rng(0))
    assert caught.value.values["method"] == "magic"


@pytest.mark.parametrize(("seed", "quadratic"), [(1, 0.0), (2, 0.05)])
def test_methods_agree(seed: int, quadratic: float) -> None:
    observations, plain = calibrated(seed, quadratic)
    assert plain.quadratic_fitted is bool(quadratic)
    checked = cross_check(observations, plain, rng=np.random.default_rng(3))
    assert checked.agree, checked.sentence
    assert 0.0 < checked.own_costs.sigma < 3.0
    assert checked.one_cost.sigma < 0.01
    assert list(checked.found) == ["bsas", "ide", "least-squares"]
    assert checked.sentence == outcome("agreement.agree", checked)


def test_methods_agree_from_a_preset_too() -> None:
    observations, truth = measured(4)
    preset = replace(truth, scale=truth.scale * 1.0005, bias_m_s2=truth.bias_m_s2 + 0.01)
    plain = calibrate_accelerometer(observations, KNOWN_GRAVITY, preset=preset)
    checked = cross_check(observations, plain, rng=np.random.default_rng(3), preset=preset)
    assert checked.agree, checked.sentence


def test_sigma_of_the_check_is_that_of_the_fit_not_of_gravity() -> None:
    observations, plain = calibrated(1)
    sigma = restart(observations, plain).gauge_free_sigma()
    # Gravity is known to 0.018 m/s^2 here: 1800 ppm of scale, which would hide any disagreement.
    assert np.all(sigma[:3] < 1e-4 * np.abs(plain.accelerometer.scale))
    assert np.all(sigma[:3] < 0.1 * plain.intrinsic.scale_sigma)


def test_methods_that_stop_short_prove_nothing() -> None:
    observations, plain = calibrated(1)
    checked = cross_check(observations, plain, rng=np.random.default_rng(0), methods=("bas", "least-squares"))
    assert not checked.agree
    assert told(checked.not_converged, "agreement.open_run")[0].values["method"] == "bas"
    assert checked.sentence == "; ".join([outcome("agreement.disagree", checked), *checked.not_converged])


def test_a_preset_of_another_instrument_is_named() -> None:
    observations, plain = calibrated(1)
    foreign = replace(plain.accelerometer, scale=plain.accelerometer.scale * 9.80665)
    with refused(CalibrationError, Reason.UNITS, key="swarm_coordinates.foreign_preset") as caught:
        cross_check(observations, plain, rng=np.random.default_rng(0), preset=foreign)
    assert caught.value.values["parameter"] == "accelerometer.scale"
    assert caught.value.reason is Reason.UNITS
