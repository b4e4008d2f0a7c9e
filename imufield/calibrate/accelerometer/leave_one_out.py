"""Leave one out: what each position does to the parameters, and the jackknife.

With weighted residuals ``r``, weighted Jacobian ``J = Q R`` and leverage ``h_i = norm(Q_i)^2``, the fit without position i
has the residual ``r_i / (1 - h_i)`` there and moves by ``R^-1 Q_i^T r_i / (1 - h_i)`` (exact for a linear model).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from imufield.dataclass import dataclass
from imufield.samples import FloatArray

NOT_LEFT_OUT = 1 - 1e-6
"""Leverage above which nothing else determines what this position determines."""

CARRYING_LEVERAGE = 0.8
CARRYING_SHARE = 0.35
"""A position with this leverage that gives this share of a parameter's variance carries it: in the schemes with 24 positions
they reach 0.76 and 0.33, in a real hand-held session that shows one direction once 0.88 and 0.42."""
PAIR_LEVERAGE = 0.97
"""Part of an error that two positions may share which the fit follows: no residual shows it then."""
PAIR_SHARE = 0.5
"""Two positions that give this share of a parameter's variance carry it: of a plane of paper24 two edges give 0.82 of an angle
where the two others are left out; two faces 0.65 of a quadratic term likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Influence:
    """What each of m positions does to n coordinates."""

    covariance: FloatArray
    """(J^T J)^-1 of the weighted Jacobian, shape (n, n)."""
    leverage: FloatArray
    """Shape (m,), 0 to 1."""
    leave_one_out: FloatArray
    """Residual of each position, in sigma, from a fit without it, shape (m,); NaN where it cannot be left out."""
    shift: FloatArray
    """Change of the coordinates when a position is left out, shape (m, n); NaN likewise."""
    share: FloatArray
    """Part of each coordinate's variance that comes from each position, shape (m, n); columns add up to 1."""
    hat: FloatArray
    """What the fit follows of errors of the positions, shape (m, m), with the leverages on its diagonal."""


def influence(residual: FloatArray, jacobian: FloatArray) -> Influence:
    """Return covariance, leverage and leave-one-out figures of a weighted linearised fit.

    Parameters
    ----------
    residual : ndarray, shape (m,)
        In units of sigma.
    jacobian : ndarray, shape (m, n)
        In sigma per coordinate.
    """
    Q, R = np.linalg.qr(jacobian)
    inverse = np.linalg.inv(R)
    leverage = np.sum(Q**2, axis=1)
    # r_i / (1 - h_i) without fitting again
    rest = np.where(leverage < NOT_LEFT_OUT, 1 - leverage, np.nan)
    without = residual / rest
    covariance = inverse @ inverse.T
    gain = Q @ inverse.T
    return Influence(
        covariance=covariance,
        leverage=leverage,
        leave_one_out=without,
        shift=gain * without[:, None],
        share=gain**2 / np.diag(covariance),
        hat=Q @ Q.T,
    )


def jackknife_sigma(shift: FloatArray) -> FloatArray:
    """Return the jackknife sigma of n coordinates from the shifts of m fits without one position, shape (n,).

    Positions that cannot be left out (NaN) are passed over; NaN where there is no other.
    """
    possible = shift[np.isfinite(shift).all(axis=1)]
    if not len(possible):
        return np.full(shift.shape[1], np.nan)
    m = len(shift)
    # (m - 1) / m times the sum of squares: the delete-one jackknife
    return np.asarray(np.sqrt((m - 1) / m * np.sum((possible - possible.mean(axis=0)) ** 2, axis=0)))


@dataclass(frozen=True, slots=True)
class SinglePosition:
    """A position on which parameters rest."""

    position: int
    coordinates: tuple[int, ...]
    leverage: float


def single_positions(spread: Influence) -> tuple[SinglePosition, ...]:
    """Return the positions that carry coordinates nearly alone, in the order of the positions."""
    found = []
    for position in np.flatnonzero(spread.leverage > CARRYING_LEVERAGE):
        coordinates = tuple(int(k) for k in np.flatnonzero(spread.share[position] > CARRYING_SHARE))
        if coordinates:
            found.append(SinglePosition(int(position), coordinates, float(spread.leverage[position])))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class PositionPair:
    """Two positions on which a parameter rests."""

    positions: tuple[int, int]
    coordinate: int
    share: float
    """Of its variance."""


def position_pairs(spread: Influence) -> tuple[PositionPair, ...]:
    """Return the pairs that carry a coordinate between them, and that no other position checks.

    Where one position carries a coordinate with any other, only its pair of the largest share is returned.
    """
    h, found = spread.leverage, dict[tuple[int, int], PositionPair]()
    for i, j in combinations(range(len(h)), 2):
        # The larger eigenvalue of the two rows and columns.
        followed = (h[i] + h[j]) / 2 + np.hypot((h[i] - h[j]) / 2, spread.hat[i, j])
        share = spread.share[i] + spread.share[j]
        if followed > PAIR_LEVERAGE and share.max() > PAIR_SHARE:
            k = int(share.argmax())
            pair, carrier = PositionPair((i, j), k, float(share[k])), i if spread.share[i, k] > spread.share[j, k] else j
            if (carrier, k) not in found or pair.share > found[carrier, k].share:
                found[carrier, k] = pair
    return tuple(found.values())


def single_position_factors(spread: Influence, singles: tuple[SinglePosition, ...]) -> FloatArray:
    """Return by how much the sigma of each coordinate is raised where it rests on a single position, shape (n,).

    There the Jacobian trusts one hold as much as the average of many; the jackknife shows what it is worth.
    """
    factors = np.ones(spread.shift.shape[1])
    ratio = jackknife_sigma(spread.shift) / np.sqrt(np.diag(spread.covariance))
    for single in singles:
        rows = list(single.coordinates)
        factors[rows] = np.fmax(factors[rows], ratio[rows])  # NaN where the jackknife has nothing to say
    return factors
