"""Monte-Carlo draws of an unchanged instrument, for the tests between sessions."""

from __future__ import annotations

import math

import numpy as np

from imufield.samples import FloatArray

FAMILY_CHANCE = 0.05
"""Share of unchanged pairs, and of unchanged histories, that are called changed."""


def symmetric_root(covariance: FloatArray) -> FloatArray:
    """Return R with R^T R the covariance: the symmetric one, as another sign of an eigenvector would be other draws."""
    own = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # A difference of two covariances may be negative: such a number has no variance, and is correlated with no other.
    inverse = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0)
    values, vectors = np.linalg.eigh(covariance * np.outer(inverse, inverse))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * own)


def variance_share(freedom: FloatArray, draws: int, rng: np.random.Generator) -> FloatArray:
    """Draw estimated over true variances by chi squared, shape (draws, n).

    Parameters
    ----------
    freedom : ndarray, shape (n,)
        Degrees of freedom. Numbers with the same share one draw, as their sigmas come from the same residuals; where they are
        infinite, or 0, the share is 1.
    draws : int
    rng : Generator
    """
    share = np.ones((draws, len(freedom)))
    for n in np.unique(freedom):
        if n > 0 and math.isfinite(n):
            share[:, freedom == n] = rng.chisquare(n, (draws, 1)) / n
    return share
