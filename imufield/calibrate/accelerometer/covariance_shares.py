"""The shares of the accelerometer's covariance: what each part of its sum contributes to each parameter.

With the weighted Jacobian ``J = Q R`` of the parameters a fit is ``R^-1 Q^T`` times the residuals. The variance that counts for
a residual is ``ratio`` times that of its weight (``Choice.variance_ratio``). What of it is the noise of the mean of the hold is
known; the rest is scatter between holds. So the fit's covariance is the sum of two,

    R^-1 Q^T (D_within + D_between) Q R^-T,    D_within + D_between = ratio I

A drift, or higher terms, fitted beside the parameters makes it larger by ``ratio (C_with - C_without)``, which is no negative
variance for any combination of them: a Schur complement.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from imufield.calibrate.accelerometer.f_tests import Choice
from imufield.calibrate.accelerometer.fit import Fit, FitData
from imufield.calibrate.accelerometer.unfitted_terms import Unshown
from imufield.calibrate.model.aliasing import HIGHER_COLUMNS, LEFT_OUT_SHARES
from imufield.calibrate.model.budget import Kind, Share, root_of
from imufield.calibrate.model.uncertainty import rms
from imufield.samples import FloatArray

_RESIDUALS = "accelerometer"


def fit_shares(fitted: Fit, data: FitData, choice: Choice, *, factors: FloatArray, parameters: int) -> Iterator[Share]:
    """Yield the shares of the fit in the uncertainty of the 15 parameters.

    Parameters
    ----------
    fitted : Fit
        In the wanted gauge.
    data : FitData
    choice : Choice
    factors : ndarray, shape (n,)
        By which the uncertainty of the coordinates is raised, where a single position carries one.
    parameters : int
        How many of the n coordinates are no drift and no higher terms.
    """
    own, ratio, variance = slice(parameters), choice.variance_ratio, fitted.sigma_m_s2**2
    J, basis = fitted.jacobian / fitted.sigma_m_s2[:, None], (fitted.basis * factors)[:, own]
    Q, R = np.linalg.qr(J[:, own])
    gain = basis @ np.linalg.solve(R, Q.T)
    known = np.zeros(len(J)) if data.covariance_raw is None else 1 - fitted.tau_m_s2**2 / variance
    within = np.minimum(known, ratio)
    freedom = fitted.effective_degrees_of_freedom * choice.freedom_ratio
    of_residuals = partial(Share, residuals=_RESIDUALS, degrees_of_freedom=freedom, input_unit="m/s^2")
    size, sigma = rms(np.sqrt(within * variance)), root_of(gain**2 @ within)
    yield of_residuals(name="within_hold", kind="A", input_sigma=size, sigma=sigma)
    kind: Kind = "B" if fitted.has_typical_scatter else "A"
    size, sigma = rms(np.sqrt((ratio - within) * variance)), root_of(gain**2 @ (ratio - within))
    yield of_residuals(name="between_holds", kind=kind, input_sigma=size, sigma=sigma)
    inverse, alone = np.linalg.inv(np.linalg.qr(J)[1]), np.linalg.inv(R)
    more = ratio * ((inverse @ inverse.T)[own, own] - alone @ alone.T)
    sigma = root_of(np.einsum("pi,ij,pj->p", basis, more, basis)) if J.shape[1] > parameters else np.zeros(len(basis))
    name = "drift" if fitted.higher is None else "higher_terms"
    yield of_residuals(name=name, kind="A", input_sigma=rms(np.sqrt(ratio * variance)), sigma=sigma)


def hidden_shares(hidden: Unshown, open_misalignments: int, freedom: float) -> Iterator[Share]:
    """Yield the shares that no residual shows in the uncertainty of the 15 parameters.

    Parameters
    ----------
    hidden : Unshown
        Its typical terms are the columns of ``open_terms``.
    open_misalignments : int
        How many of them, behind those of higher terms, are of misalignments; the last ones are of quadratic terms.
    freedom : float
        Degrees of freedom of the residuals that the choice of the model rests on.
    """
    yield Share(name="model_choice", kind="A", residuals=_RESIDUALS, degrees_of_freedom=freedom, sigma=_lengths(hidden.choice))
    first = HIGHER_COLUMNS.stop
    columns = np.split(hidden.typical, [first, first + open_misalignments], axis=1)
    for name, root in zip(("nonlinearity", *LEFT_OUT_SHARES), columns, strict=True):
        yield Share(name=name, kind="B", sigma=_lengths(root))


def gravity_share(sensitivity: FloatArray, sigma_m_s2: float) -> Share:
    """Return the share of gravity, whose sensitivity is d parameters / d gravity."""
    sigma = np.abs(sensitivity) * sigma_m_s2
    return Share(name="gravity", kind="B", input_sigma=sigma_m_s2, input_unit="m/s^2", sigma=sigma)


def _lengths(root: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(root, axis=1))
