import math
from dataclasses import replace

import numpy as np
import pytest

from imufield.earth import MEASURED_GRAVITY_SIGMA_M_S2, MICRO_G_M_S2, choose_gravity
from imufield.guide.cross_checks.running_fit import (
    EXPECTED_FREEDOM,
    EXPECTED_SCATTER_M_S2,
    FEWEST,
    LINEAR,
    SUSPECT_M_S2,
    SUSPECT_SHARE,
    running_fit,
)
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.view.plain import known_words
from imufield.samples import FloatArray
from imufield.simulate.truth.grades import GRADES
from tests.guide.guided import BUMPED, observations

pytestmark = pytest.mark.numerical

G = 9.80665
GRAVITY = choose_gravity(G, sigma_m_s2=MEASURED_GRAVITY_SIGMA_M_S2)
SI = RoughScale(accelerometer=1.0, gyroscope=1.0)


def test_there_is_none_before_the_fourth() -> None:
    some = observations("tactical", 0)
    assert running_fit(some[: FEWEST - 1], SI, GRAVITY) is None
    fit = running_fit(some[:FEWEST], SI, GRAVITY)
    assert fit is not None
    assert 0 < fit.rank < 9
    assert running_fit(some, RoughScale(), GRAVITY) is None


@pytest.mark.parametrize("grade", GRADES)
def test_the_forecast_shrinks_and_holds(grade: str) -> None:
    some = observations(grade, 1)
    fits = [running_fit(some[:count], SI, GRAVITY) for count in (6, 12, 24)]
    known = [fit.forecast() for fit in fits if fit is not None]
    assert len(known) == 3
    for key in known[0]:
        assert known[0][key] > known[1][key] > known[2][key] > 0
    assert fits[2].rank == 12
    assert fits[2].condition < 20


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("seed", range(3))
def test_a_bumped_position_is_found_and_no_other(grade: str, seed: int) -> None:
    fit = running_fit(observations(grade, seed, bump=3e-3), SI, GRAVITY)
    doubtful = [one for one in fit.disagreements() if one.is_suspect]
    assert [one.name for one in doubtful] == [f"p{BUMPED}"]
    assert doubtful[0].leave_one_out_m_s2 == pytest.approx(3e-3 * G, rel=0.2)
    assert not any(one.is_suspect for one in running_fit(observations(grade, seed), SI, GRAVITY).disagreements())


@pytest.mark.parametrize("grade", ["mems", "tactical"])
@pytest.mark.parametrize(("place", "most_later"), [(8, 6), (10, 4), (12, 4), (14, 0), (16, 0), (20, 0)])
def test_a_bump_is_found_as_soon_as_degrees_of_freedom_are_spare(grade: str, place: int, most_later: int) -> None:
    """5.8 mg in the hold of that number, in the order proposed: nine parameters and a hold to spare, and no good one named."""
    some = observations(grade, 1)
    some[place - 1] = replace(some[place - 1], mean_raw=some[place - 1].mean_raw * (1 + 5.8e-3))
    suspects: list[str] = []
    for count in range(max(place, FEWEST), place + most_later + 1):
        fit = running_fit(some[:count], SI, GRAVITY)
        assert fit is not None
        suspects = [one.name for one in fit.disagreements() if one.is_suspect]
        assert set(suspects) <= {f"p{place - 1}"}
    assert suspects


def test_a_fit_that_runs_away_is_none_before_lapack_complains(monkeypatch: pytest.MonkeyPatch) -> None:
    """It writes to the screen what no Python sees."""
    lstsq = np.linalg.lstsq

    def asked(rows: FloatArray, goal: FloatArray, rcond: None) -> object:
        assert np.isfinite(rows).all()
        return lstsq(rows, goal, rcond=rcond)

    monkeypatch.setattr(np.linalg, "lstsq", asked)
    some = observations("mems", 2)[:8]
    far = [replace(each, mean_raw=each.mean_raw * factor) for each, factor in zip(some, [1, 30] * 4, strict=True)]
    assert running_fit(far, SI, GRAVITY) is None


def test_what_only_the_prior_says_is_not_forecast() -> None:
    """Faces tell scale and bias, not angles; the plain words say so of what is left out."""
    some = observations("mems", 2)
    assert "bias_ug" not in running_fit(some[:4], SI, GRAVITY).forecast()
    whole = running_fit(some, SI, GRAVITY)
    assert {"bias_ug", "scale_ppm", "misalignment_urad"} <= set(whole.forecast())
    sigma = np.sqrt(np.diag(whole.covariance))
    assert whole.forecast()["bias_ug"] == pytest.approx(sigma[3:6].max() / 9.80665e-6)
    assert known_words({}, "bias_ug") == "not known yet"
    assert [known_words({"bias_ug": ug}, "bias_ug") for ug in (0.51, 172.3, 25800.0)] == ["0.51 ug", "172 ug", "25.8 mg"]
    assert [known_words({"scale_ppm": ppm}, "scale_ppm") for ppm in (172.3, 26000.0)] == ["172 ppm", "2.6 %"]


def test_the_forecast_has_what_gravity_leaves_open() -> None:
    """Scale goes with 1/g and bias with g: a forecast without it promises a scale that no session can have."""
    some = observations("mems", 2)
    measured, by_latitude = (
        running_fit(some, SI, GRAVITY),
        running_fit(some, SI, choose_gravity(latitude_deg=45.0, height_m=0.0)),
    )
    unknown = running_fit(some, SI, choose_gravity())
    scale_ppm = measured.forecast()["scale_ppm"]
    assert by_latitude.forecast()["scale_ppm"] == pytest.approx(math.hypot(scale_ppm, 51.0), rel=0.01)
    assert unknown.forecast()["scale_ppm"] == pytest.approx(math.hypot(scale_ppm, 1835.5), rel=0.01)
    # Some tens of mg of bias, known no better than gravity in proportion; an angle does not depend on it.
    bias_ug = np.abs(unknown.vector[3:6]).max() / MICRO_G_M_S2
    assert unknown.forecast()["bias_ug"] == pytest.approx(
        math.hypot(measured.forecast()["bias_ug"], bias_ug * 1835.5e-6), rel=0.05
    )
    assert unknown.forecast()["misalignment_urad"] == pytest.approx(measured.forecast()["misalignment_urad"], rel=1e-3)


@pytest.mark.parametrize("grade", GRADES)
def test_the_forecast_for_a_target_has_what_no_residual_shows(grade: str) -> None:
    """A second route: what one more term of a typical size does to the fit itself."""
    some, typical = observations(grade, 1), GRADES[grade]
    fit = running_fit(some, SI, GRAVITY)
    assert fit is not None
    moved = []
    for axis in range(3):
        # In raw units, which are close to SI here: asymmetry, cubic.
        for share, power in ((typical.asymmetry, 1), (typical.cubic, 3)):
            force = [one.mean_raw[axis] / G for one in some]
            add = [share * G * (abs(force_g) if power == 1 else force_g**3) for force_g in force]
            bent = [replace(one, mean_raw=one.mean_raw + more * np.eye(3)[axis]) for one, more in zip(some, add, strict=True)]
            other = running_fit(bent, SI, GRAVITY)
            assert other is not None
            moved.append(other.vector[3:6] - fit.vector[3:6])
    by_these_ug = float(np.linalg.norm(moved, axis=0).max()) / MICRO_G_M_S2
    without, whole = fit.forecast()["bias_ug"], fit.forecast(fit.unseen(typical))["bias_ug"]
    assert whole > math.hypot(without, 0.5 * by_these_ug)
    nothing = fit.unseen(replace(typical, cubic=0.0, cross=0.0, asymmetry=0.0))
    assert fit.forecast(nothing) == pytest.approx(fit.forecast())


@pytest.mark.parametrize("noise_ug", [20.0, 300.0])
def test_noise_within_holds_is_counted_once(noise_ug: float) -> None:
    """Positions that differ by the noise of their means alone, not twice by it."""
    noise, rng, sigmas = noise_ug * MICRO_G_M_S2, np.random.default_rng(1), []
    some = observations("tactical", 3)
    for _ in range(20):
        means = [
            replace(one, mean_raw=G * one.direction + rng.normal(0, noise, 3), covariance_raw=noise**2 * np.eye(3))
            for one in some
        ]
        fit = running_fit(means, SI, GRAVITY)
        assert fit is not None
        sigmas.append(float(np.mean(fit.sigma_m_s2)))
    # The expected scatter has the weight of two residuals among 17.
    expected = math.hypot(noise, EXPECTED_SCATTER_M_S2 * math.sqrt(EXPECTED_FREEDOM / (EXPECTED_FREEDOM + 24 - LINEAR)))
    assert np.mean(sigmas) == pytest.approx(expected, rel=0.15)


def test_leave_one_out_is_that_of_a_fit_without_it() -> None:
    some = observations("tactical", 3)
    fit = running_fit(some, SI, GRAVITY)
    without = running_fit(some[1:], SI, GRAVITY)
    from imufield.calibrate.model.models import norm_derivatives

    norm = norm_derivatives(without.vector, some[0].mean_raw[None, :]).norm[0]
    assert fit.disagreements()[0].leave_one_out_m_s2 == pytest.approx(norm - G, rel=0.15, abs=3e-5)


def test_the_gain_is_largest_where_nothing_was_measured() -> None:
    some = [one for one in observations("tactical", 4) if one.direction[0] < 0.5]
    fit = running_fit(some, SI, GRAVITY)
    gain = fit.gain(np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]]))
    assert np.argmax(gain) == 0
    assert np.all(gain > 0)


def test_quadratic_terms_that_matter_show() -> None:
    some = observations("navigation", 5, scatter=1e-5)
    bent = [replace(one, mean_raw=one.mean_raw + 2e-4 * one.mean_raw**2 / G) for one in some]
    assert running_fit(bent, SI, GRAVITY).quadratic_sigmas() > 3
    assert running_fit(some, SI, GRAVITY).quadratic_sigmas() < 3


def test_few_positions_need_a_larger_disagreement() -> None:
    from scipy.special import stdtrit

    fit = running_fit(observations("tactical", 6), SI, GRAVITY)
    weighted = fit.jacobian / fit.expected_m_s2[:, None]
    information = weighted.T @ weighted
    freedom = 24 - np.trace(information @ np.linalg.inv(information + np.diag(fit.prior_sigma**-2.0)))
    assert 10 < freedom < 16
    (limit,) = {one.limit_sigmas for one in fit.disagreements()}
    assert limit == pytest.approx(max(stdtrit(EXPECTED_FREEDOM + freedom - 1, 1 - SUSPECT_SHARE / 2), 5.0), rel=0.01)
    few = running_fit(observations("tactical", 6)[:8], SI, GRAVITY)
    assert few.disagreements()[0].limit_sigmas > 10


@pytest.mark.parametrize("seed", [0, 15, 21, 41, 47])
def test_no_good_position_is_doubted_at_any_look(seed: int) -> None:
    """Chips whose positions scatter more than their noise lets expect: a fixed 5 sigma doubts one in each of these seeds."""
    some = [replace(one, covariance_raw=one.covariance_raw / 16) for one in observations("mems", seed, scatter=2e-3)]
    fits = [running_fit(some[:count], SI, GRAVITY) for count in range(FEWEST, 25)]
    found = [one for fit in fits if fit is not None for one in fit.disagreements()]
    assert not [one.name for one in found if one.is_suspect]
    assert [one.name for one in found if abs(one.sigmas) > 5 and abs(one.leave_one_out_m_s2) > SUSPECT_M_S2]
