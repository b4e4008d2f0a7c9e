"""Leave-one-out and jackknife against fits made again."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_truth import GRAVITY, campaign, random_parameters

from imufield.calibrate.accelerometer.ellipsoid_start import closed_form_start
from imufield.calibrate.accelerometer.fit import FitData, column_basis, fit
from imufield.calibrate.accelerometer.leave_one_out import influence, jackknife_sigma, position_pairs
from imufield.calibrate.model.models import from_vector, recover
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS

pytestmark = pytest.mark.numerical

LINEAR = LOWER_GAUGE_COLUMNS[:9]


def test_leave_one_out_and_jackknife_against_refits() -> None:
    rng = np.random.default_rng(7)
    observations = campaign(random_parameters(rng), rng, between_m_s2=2e-3)
    raw = observations.mean_raw
    start = closed_form_start(raw, GRAVITY, np.ones(3))
    basis = column_basis(start, LINEAR, GRAVITY)
    whole = fit(FitData(raw=raw, covariance_raw=None, gravity_m_s2=GRAVITY, quadratic_axes="sensing"), start, basis)
    spread = influence(whole.residual_m_s2, whole.jacobian)
    shifts = np.empty((24, 9))
    for k in range(24):
        part = fit(
            FitData(raw=np.delete(raw, k, axis=0), covariance_raw=None, gravity_m_s2=GRAVITY, quadratic_axes="sensing"),
            start,
            basis,
        )
        left_out = np.linalg.norm(recover(from_vector(part.vector), raw[k : k + 1])) - GRAVITY
        assert spread.leave_one_out[k] == pytest.approx(left_out, rel=5e-3, abs=1e-7)
        shifts[k] = np.linalg.lstsq(basis, part.vector - whole.vector, rcond=None)[0]
    assert spread.shift == pytest.approx(shifts, abs=5e-3 * np.abs(shifts).max())
    assert jackknife_sigma(spread.shift) == pytest.approx(jackknife_sigma(shifts), rel=1e-2)
    assert spread.leverage.sum() == pytest.approx(9)
    assert spread.share.sum(axis=0) == pytest.approx(np.ones(9))


def test_a_position_alone_cannot_be_left_out() -> None:
    jacobian = np.array([[1.0, 0], [1.0, 0], [0.0, 1.0]])
    spread = influence(np.array([0.1, -0.1, 0.0]), jacobian)
    assert spread.leverage == pytest.approx([0.5, 0.5, 1.0])
    assert np.isnan(spread.leave_one_out[2])
    assert spread.leave_one_out[:2] == pytest.approx([0.2, -0.2])


def test_a_position_that_carries_with_any_other_is_told_of_once() -> None:
    jacobian = np.random.default_rng(4).normal(size=(12, 3))
    # The first position shows the first coordinate, and the others hardly do.
    jacobian[1:, 0] *= 0.05
    pairs = [pair for pair in position_pairs(influence(np.zeros(12), jacobian)) if 0 in pair.positions]
    assert [pair.coordinate for pair in pairs] == [0]
    shares = influence(np.zeros(12), jacobian).share[:, 0]
    assert pairs[0].share == pytest.approx(shares[0] + max(shares[1:]))
