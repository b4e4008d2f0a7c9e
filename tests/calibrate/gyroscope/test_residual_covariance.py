"""Sizes of the scatters on residuals whose likelihood can be searched."""

from __future__ import annotations

import numpy as np
import pytest

from imufield.calibrate.gyroscope.residual_covariance import Covariances, Scatter, next_scatter

# A quiet residual stands out from its noise, and loud ones are quieter than theirs: the likelihood of what all share bends more
# than twice as much as expected.
SQUARES = np.array([0.20, 0.96, 0.33, 0.37, 0.23, 0.07, 4.2])
OWN = np.array([11.5, 0.256, 3.4, 8.4, 1.69, 1.38, 5.6])


def test_a_scatter_settles_at_its_largest_likelihood() -> None:
    """A navigation-grade fit once went to and fro between none and too much for ever."""
    none, jacobian = np.zeros((8, 8)), np.zeros((8, 1))
    jacobian[7] = 1.0
    parts = Covariances(
        known={"noise": np.diag(np.append(OWN, 1.0))},
        drift=np.diag(np.append(np.ones(7), 0.0)),
        wander=none,
        turn=none,
        with_accelerometer=np.zeros((8, 16)),
    )
    scatter, residual = Scatter(2.0, 0.0, 0.0), np.append(np.sqrt(SQUARES), 0.0)
    for _ in range(30):
        scatter = next_scatter(scatter, residual, jacobian, parts)
    variance = np.linspace(0, 2, 20001)[:, None] + OWN
    best = np.argmin(np.sum(np.log(variance) + SQUARES / variance, axis=1)) * 1e-4
    assert scatter.drift_rad_s**2 == pytest.approx(best, abs=1e-4)
