from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imufield.calibrate.model.result import Calibration
from imufield.deliver.report.correlations import Correlations, correlations


def test_correlations_are_those_of_the_joint_covariance(calibration: Calibration) -> None:
    found = correlations(calibration)
    assert np.diag(found.matrix) == pytest.approx(np.ones(len(found.names)))
    assert found.matrix == pytest.approx(found.matrix.T)
    assert np.abs(found.matrix).max() <= 1 + 1e-12
    rng = np.random.default_rng(0)
    names = calibration.covariance_names
    i, j = names.index("accelerometer.bias_m_s2.x"), names.index("accelerometer.quadratic.x")
    draws = rng.multivariate_normal(np.zeros(len(names)), calibration.covariance, 20000, method="eigh")
    expected = np.corrcoef(draws[:, i], draws[:, j])[0, 1]
    value = found.matrix[found.names.index("acc bias x"), found.names.index("acc quadratic x")]
    assert value == pytest.approx(expected, abs=0.03)


def test_what_is_known_exactly_has_no_correlation(calibration: Calibration) -> None:
    covariance = calibration.covariance.copy()
    covariance[0] = covariance[:, 0] = 0.0
    found = correlations(replace(calibration, covariance=covariance))
    assert len(found.names) == len(correlations(calibration).names) - 1
    assert "acc scale x" not in found.names


def test_the_strongest_come_first() -> None:
    matrix = np.array([[1.0, 0.2, -0.9], [0.2, 1.0, 0.5], [-0.9, 0.5, 1.0]])
    found = Correlations(("p", "q", "r"), matrix)
    assert found.strongest(2) == [("p", "r", -0.9), ("q", "r", 0.5)]
