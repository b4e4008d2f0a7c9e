"""Holds that were touched: found among others, named, and left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.accelerometer.fit import FitData, column_basis, fit
from imufield.calibrate.accelerometer.outliers import find_outliers
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS
from imufield.calibrate.model.observations import Observations, leave_out
from imufield.calibrate.model.result import Calibration
from imufield.earth import MILLI_G_M_S2, Gravity
from imufield.errors import Reason, UsageError
from tests.calibrate.calibration_truth import GRAVITY, campaign, outputs, paper24, random_parameters
from tests.refused import refused
from tests.told import told

EXACT = Gravity(gravity_m_s2=GRAVITY, sigma_m_s2=1e-5, source="typed")
BOTH = ("quality.gross_outlier", "quality.outlier")


def session(seed: int, touched_mg: dict[int, float], noise: float = 1.0) -> Observations:
    """A session with 0.1 mg between positions (times ``noise``), some of which show a norm that is longer by so many mg."""
    rng = np.random.default_rng(seed)
    truth = random_parameters(rng)
    observations = campaign(truth, rng, within_m_s2=3e-4 * noise, between_m_s2=1e-3 * noise)
    for position, off_mg in touched_mg.items():
        mean = observations.mean_raw[position]
        zero = outputs(truth, np.zeros((1, 3)))[0]
        mean += (mean - zero) / np.linalg.norm((mean - zero) / truth.scale) * off_mg * MILLI_G_M_S2
    return observations


def named(calibration: Calibration, *keys: str) -> dict[str, float]:
    return {one.values["position"]: one.values["off_mg"] for key in keys for one in told(calibration.quality.reasons, key)}


@pytest.mark.numerical
@pytest.mark.parametrize("touched", [{7: 20.0}, {7: 20.0, 11: -20.0}, {7: 20.0, 11: 20.0, 18: 20.0}])
def test_gross_ones_are_named_with_their_size_however_many(touched: dict[int, float]) -> None:
    calibration = calibrate_accelerometer(session(3, touched), EXACT)
    assert calibration.quality.verdict == "poor"
    found = named(calibration, "quality.gross_outlier")
    assert found == {f"p{position + 1:02d}": pytest.approx(off_mg, abs=0.7) for position, off_mg in touched.items()}
    for one in told(calibration.quality.reasons, "quality.gross_outlier"):
        assert one.values["option"] == f"--without={one.values['position']}"
    assert calibration.quality.suspects == tuple(found)


@pytest.mark.parametrize(("off_mg", "noise", "verdict"), [(1.0, 0.01, "usable"), (9.0, 1.0, "poor")])
def test_size_and_not_sigma_makes_one_poor(off_mg: float, noise: float, verdict: str) -> None:
    """1 mg in an instrument so quiet that this is 1000 sigma, and 9 mg where it is 90."""
    calibration = calibrate_accelerometer(session(3, {7: off_mg}, noise=noise), EXACT)
    assert calibration.quality.verdict == verdict
    found = named(calibration, "quality.gross_outlier" if verdict == "poor" else "quality.outlier")
    assert found == {"p08": pytest.approx(off_mg, abs=0.7 * noise)}
    assert calibration.quality.suspects == ("p08",)


def test_without_them_the_numbers_are_those_of_a_session_that_never_had_them() -> None:
    kept, left_out = leave_out(session(3, {7: 20.0, 11: -20.0}), ("p08", "p12"))
    clean, _ = leave_out(session(3, {}), ("p12", "p08"))
    assert left_out.name == ("p08", "p12")
    found, wanted = (calibrate_accelerometer(each, EXACT) for each in (kept, clean))
    assert np.array_equal(found.accelerometer.bias_m_s2, wanted.accelerometer.bias_m_s2)
    assert found.quality.verdict == "good"
    assert found.quality.suspects == ()
    with refused(UsageError, Reason.USAGE, key="observations.not_there"):
        leave_out(clean, ("p12",))


def test_a_still_goes_by_its_number_too() -> None:
    found = session(3, {})
    free = replace(found, name=tuple(f"free {k + 1}: near +x" for k in range(len(found))))
    kept, left_out = leave_out(free, ("free 1",))
    assert left_out.name == kept.left_out == ("free 1: near +x",)
    assert len(kept) == len(found) - 1
    named = replace(free, name=("free 2", *free.name[1:]))
    assert leave_out(named, ("free 2",))[1].name == ("free 2",)
    with refused(UsageError, Reason.USAGE, key="observations.not_there"):
        leave_out(free, ("",))


def test_two_edges_that_nothing_checks_are_not_good() -> None:
    """+2 mg on two opposite edges of a plane is, but for an angle, what +2 mg on the two others are."""
    up = paper24()
    one, *plane = np.flatnonzero((np.abs(up[:, 0]) < 0.1) & (np.abs(up[:, 1:]).min(axis=1) > 0.5))
    (opposite,) = (row for row in plane if up[row] @ up[one] < -0.9)
    others = {f"p{row + 1:02d}" for row in plane if row != opposite}
    touched = session(3, {int(one): 2.0, int(opposite): 2.0}, noise=0.2)
    quality = calibrate_accelerometer(leave_out(touched, others)[0], EXACT).quality
    assert (quality.verdict, quality.suspects) == ("usable", ())
    (carried,) = told(quality.reasons, "quality.carried_by_two")
    assert carried.values["positions"] == [f"p{one + 1:02d}", f"p{opposite + 1:02d}"]
    assert set(carried.values["left_out"]) == others
    assert carried.values["share"] > carried.values["limit"]
    # Of two planes one edge each: the others check them.
    other = np.flatnonzero((np.abs(up[:, 1]) < 0.1) & (np.abs(up[:, [0, 2]]).min(axis=1) > 0.5))[0]
    apart = leave_out(session(3, {}), (f"p{one + 1:02d}", f"p{other + 1:02d}"))[0]
    assert calibrate_accelerometer(apart, EXACT).quality.verdict == "good"


def test_a_hold_that_alone_shows_a_parameter_is_not_taken_out() -> None:
    """Whatever its residual is, of a fit that did not converge too: without it the others do not tell their parameters."""
    faces = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 3, axis=0)
    alone = np.array([[1, 1, 0], [1, 0, 1], [0, 1, 1]]) / np.sqrt(2)
    data = FitData(raw=GRAVITY * np.vstack([alone, faces]), covariance_raw=None, gravity_m_s2=GRAVITY, quadratic_axes="sensing")
    perfect = np.repeat([1.0, 0.0], [3, 12])
    fitted = fit(data, perfect, column_basis(perfect, LOWER_GAUGE_COLUMNS[:9], GRAVITY))
    rest = np.random.default_rng(0).normal(0, 1e-3, len(data.raw))
    rest[[0, 7]] = 1e14, 1.0
    found = find_outliers(replace(fitted, residual_m_s2=rest, sigma_m_s2=np.full(len(rest), 1e-3)))
    assert [outlier.position for outlier in found] == [7]


@pytest.mark.statistical
def test_clean_sessions_have_none() -> None:
    """1 % is what the level says: five of 120 would come by chance in less than 1 % of such tests."""
    found = [
        bool(named(calibrate_accelerometer(session(seed, {}), EXACT, model=model), *BOTH))
        for seed in range(60)
        for model in ("linear", "quadratic")
    ]
    assert sum(found) < 5
