"""Variances of the sessions against a search of their likelihood."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.temperature.scatter import BIAS, SCALE, Equations, scatter_of

OWN = np.array([11.5, 0.256, 3.4, 8.4, 1.69, 1.38, 5.6])
SQUARES = np.array([0.20, 0.96, 0.33, 0.37, 0.23, 0.07, 4.2])


def test_scatter_has_the_largest_likelihood_beside_sessions_of_unequal_sigma() -> None:
    """It bends more than twice as much as expected: scoring once ended anywhere between two values."""
    rows = len(OWN) + 1
    one = Equations(
        # One scale, which its unknown fits: it shows no scatter.
        matrix=np.eye(rows)[:, -1:],
        values=np.append(np.sqrt(SQUARES), 0.0),
        own=np.diag(np.append(OWN, 1.0)),
        sigma=np.empty(0),
        kind=np.array([*[BIAS] * len(OWN), SCALE]),
    )
    variance = np.linspace(0, 2, 20001)[:, None] + OWN
    best = np.argmin(np.sum(np.log(variance) + SQUARES / variance, axis=1)) * 1e-4
    np.testing.assert_allclose(scatter_of([one]).variances[BIAS], best, atol=1e-4)
