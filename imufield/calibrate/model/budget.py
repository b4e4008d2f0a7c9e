"""The uncertainty budget: which shares the covariance is made of, and the degrees of freedom of their sum.

The solver builds the covariance of the parameters as a sum of independent parts, and each part is a ``Share`` here: its
contribution u_i(p) to the standard uncertainty of each parameter p, so that ``sum u_i(p)^2`` is the variance of p. A standard
uncertainty u(x_i) of one input quantity and its sensitivity ``c_i = u_i(p) / u(x_i)`` are known where the part has one [1]_.

By Welch and Satterthwaite the sum has ``u^4 / sum(u_i^4 / nu_i)`` degrees of freedom, for independent estimates u_i^2 [1]_.
Shares whose sizes come from the same residuals are no independent estimates: they are added first.

References
----------
.. [1] JCGM 100:2008 (GUM), 5.1.3 and annex G.4, equation G.2b.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from imufield.dataclass import dataclass, replace
from imufield.samples import FloatArray

Kind = Literal["A", "B"]
"""Evaluated from the data of the session, or known from elsewhere (JCGM 100:2008, 3.3)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """One part of the uncertainty of n parameters."""

    name: str
    """Key: "within_hold", "gravity" ..."""
    kind: Kind
    residuals: str = ""
    """Which residuals tell its size: shares with the same name are added before degrees of freedom are; empty: by itself."""
    degrees_of_freedom: float = math.inf
    """Of those residuals."""
    input_sigma: float = math.nan
    """Standard uncertainty of the input quantity; NaN where it is no single one."""
    input_unit: str = ""
    sigma: FloatArray
    """Contribution to each parameter, 1 sigma in its unit, shape (n,); NaN where it is not known."""


def root_of(variance: FloatArray) -> FloatArray:
    """Return standard deviations; a variance that rounding brought below zero counts as zero."""
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def picked(shares: Iterable[Share], places: Sequence[int]) -> tuple[Share, ...]:
    """Return the shares of some of the parameters, in the order of ``places``; those that contribute nothing are left out."""
    chosen = (replace(share, sigma=share.sigma[list(places)]) for share in shares)
    return tuple(share for share in chosen if np.any(share.sigma != 0))


def joined_shares(
    ours: Iterable[Share], our_places: Sequence[int], theirs: Iterable[Share], their_places: Sequence[int]
) -> tuple[Share, ...]:
    """Return the shares of two groups of parameters as those of all; a share that both have is one."""
    size = len({*our_places, *their_places})
    found: dict[str, Share] = {}
    for shares, places in ((ours, our_places), (theirs, their_places)):
        for share in shares:
            known = found.get(share.name)
            sigma = np.zeros(size) if known is None else known.sigma
            sigma[list(places)] = share.sigma
            found[share.name] = replace(known or share, sigma=sigma)
    return tuple(found.values())


def combined_sigma(shares: Sequence[Share]) -> FloatArray:
    """Return the root of the sum of squares of the contributions, shape (n,)."""
    return np.asarray(np.sqrt(np.sum([share.sigma**2 for share in shares], axis=0)))


def welch_satterthwaite(variances: FloatArray, freedom: FloatArray) -> FloatArray:
    """Return the degrees of freedom of sums of independent variances.

    Parameters
    ----------
    variances : ndarray, shape (k, ...)
    freedom : ndarray, shape (k,)
        Of each; infinite where it is known beforehand, 0 where nothing was left to tell it.

    Returns
    -------
    ndarray, shape (...)
        Infinite where no part of a sum has a finite number.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.where(variances > 0, variances**2 / freedom.reshape(-1, *[1] * (variances.ndim - 1)), 0.0)
        return np.asarray(np.sum(variances, axis=0) ** 2 / np.sum(parts, axis=0))


def effective_freedom(shares: Sequence[Share]) -> FloatArray:
    """Return the effective degrees of freedom of ``combined_sigma``, shape (n,)."""
    # A share by itself is a group of its own.
    groups: dict[str, list[Share]] = {}
    for share in shares:
        groups.setdefault(share.residuals or f"{share.name} alone", []).append(share)
    variances = np.array([combined_sigma(group) ** 2 for group in groups.values()])
    return welch_satterthwaite(variances, np.array([group[0].degrees_of_freedom for group in groups.values()]))
