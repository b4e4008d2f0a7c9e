"""How large the misfit of held-out positions of its own session may be by chance.

The calibrations that predict the groups share most of their positions, and each has a scatter tau of its own from the few
residuals that its group leaves it: their pooled misfit has no textbook distribution (that of F is far too wide for a scatter
well seen, and too narrow for 3 residuals to spare). So sessions are simulated that have the stated noise and nothing else, in
the linearised model, and taken through the same steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imufield.samples import FloatArray

RUNS = 4000
"""Four times what the rarest statement, 1 in 1000, needs."""
_NEWTON_STEPS = 20
_TINY = 1e-22
"""Square of a nanogal, as in the misfit itself."""


@dataclass(frozen=True, slots=True)
class Session:
    """The linearised session: residual = jacobian z + noise."""

    jacobian: FloatArray
    """Independent columns, shape (m, n)."""
    within: FloatArray
    """Variance of each mean, shape (m,)."""
    tau_m_s2: float


def simulated_misfits(session: Session, groups: list[NDArray[np.bool_]], seed: int = 0) -> FloatArray:
    """Return the pooled misfit of simulated sessions whose noise is as stated, shape (RUNS,).

    Parameters
    ----------
    session : Session
    groups : list of ndarray of bool, shape (m,)
        Positions left out together; every position in one of them.
    seed : int
    """
    m = len(session.within)
    sigma = np.sqrt(session.within + session.tau_m_s2**2)
    noise = sigma * np.random.default_rng(seed).standard_normal((RUNS, m))
    squares = [_squares(session, held, noise, sigma) for held in groups]
    return np.asarray(np.sum(squares, axis=0) / m)


def _squares(session: Session, held: NDArray[np.bool_], noise: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return r^T S^-1 r of one group of every run, shape (RUNS,)."""
    rest = ~held
    J, H = session.jacobian[rest], session.jacobian[held]
    # Q spans the weighted columns; the fit at the true weights stands for that at the estimated ones.
    Q, R = np.linalg.qr(J / sigma[rest, None])
    whitened = noise[:, rest] / sigma[rest]
    z = np.linalg.solve(R, Q.T @ whitened.T).T
    left = noise[:, rest] - z @ J.T
    tau2 = _scatter(left, session.within[rest], int(rest.sum()) - J.shape[1])
    residual = noise[:, held] - z @ H.T
    weight = 1 / (session.within[rest] + tau2[:, None] + _TINY)
    normal = np.einsum("ai,ra,aj->rij", J, weight, J, optimize=True)
    S = H @ np.linalg.solve(normal, np.broadcast_to(H.T, (len(normal), *H.T.shape)))
    diagonal = np.arange(len(H))
    S[:, diagonal, diagonal] += session.within[held] + tau2[:, None] + _TINY
    return np.asarray(np.einsum("rh,rh->r", residual, np.linalg.solve(S, residual[..., None])[..., 0]))


def _scatter(left: FloatArray, within: FloatArray, freedom: int) -> FloatArray:
    """Return tau^2 of every run, as ``between_position_sigma`` finds it: Newton's method from below never overshoots."""
    tau2 = np.zeros(len(left))
    if not np.any(within):
        return np.asarray(np.sum(left**2, axis=1) / freedom)
    for _ in range(_NEWTON_STEPS):
        weight = 1 / (within + tau2[:, None])
        weighted = left**2 * weight
        excess = np.sum(weighted, axis=1) - freedom
        tau2 += np.maximum(excess, 0.0) / np.sum(weighted * weight, axis=1)
    return tau2
