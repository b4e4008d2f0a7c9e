"""The F tests that decide whether a quadratic term and a bias drift are fitted, and the uncertainty that choosing adds.

Candidates are the quadratic term and a drift of the bias (``drift``). A joint F test of all of them rejects at 5 %, or none
is admitted; within it Holm's order [1]_ on the F test of each term given the other refutes one of them. Where the joint test
rejects and neither is refuted, both are admitted.

With the linearised fit ``p_k`` of each combination k of terms, its covariance ``C_k``, the admitted one ``p`` and weights
``w_k`` that add up to 1, what is known of the parameters is

    sum_k w_k (C_k + (p_k - p) (p_k - p)^T)

The weights are posterior probabilities by Zellner's g prior with g = m [2]_, each combination as likely before. A quadratic
term that is not admitted counts as present in all: no test sees one the size of its own sigma, and it moves the bias by three
times the sigma of the linear model. So stated intervals hold the truth for terms of any size (docs/maths.md, simulated).

Where the grade says what is typical, such a term k of variance V is drawn from N(0, S): with f = S / (S + V) it is known as
N(f k, f V), so of p_k and C_k the share f beyond those without it counts. S is the typical variance, or by the fit's own F,
(F - 1) V, where that is more: an instrument that has a larger term is held too.

References
----------
.. [1] S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Statistics 6 (1979).
.. [2] F. Liang et al., "Mixtures of g priors for Bayesian variable selection", J. Am. Stat. Assoc. 103 (2008), equation 6.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import Literal

import numpy as np

from imufield.calibrate.accelerometer.fit import Fit
from imufield.calibrate.model.coverage_factors import f_tail, sigma_of_mixture
from imufield.calibrate.model.models import BIAS, PARAMETERS
from imufield.dataclass import dataclass, field, replace
from imufield.samples import FloatArray

Term = Literal["quadratic", "drift"]
Terms = frozenset[Term]

_ROUNDING = 1e-12
LEVEL = 0.05
"""Chance that a term is admitted where there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """The fit of one combination of terms, in the linearisation of the fit of all."""

    chi_squared: float
    freedom: int
    change: FloatArray
    """From the parameters of the fit of all, shape (15,)."""
    covariance: FloatArray
    """Of the 15 parameters at unit sigma, shape (15, 15)."""
    quadratic_variance: float
    """Mean variance of the quadratic terms at unit sigma, (m/s^2)^2 at 1 g; 0 without."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What choosing makes of the covariance of the 15 parameters."""

    root: FloatArray = field(default_factory=lambda: np.zeros((PARAMETERS, 0)))
    """Of what it adds, in columns, shape (15, k)."""
    variance_ratio: float = 1.0
    """Variance of the residuals over that of the fit: a term that counts and is not fitted is among its residuals."""
    freedom_ratio: float = 1.0
    """Of the degrees of freedom of that variance."""


class Gate:
    """The candidates of one calibration, and the fit of all of them.

    Parameters
    ----------
    fit : Fit
        Of all terms.
    coordinates : dict of term to tuple of int
        Which coordinates of the fit each candidate has.
    value : ndarray, shape (n,)
        Coordinates of the fit, from zero where a term vanishes; those of candidates count.
    """

    def __init__(self, fit: Fit, coordinates: dict[Term, tuple[int, ...]], value: FloatArray) -> None:
        self._fit, self._coordinates, self._value = fit, coordinates, value
        self.all: Terms = frozenset(coordinates)
        within = fit.sigma_m_s2**2 - fit.tau_m_s2**2
        # Part of each variance that is known before the fit: no combination scatters by less.
        self._least = float(np.mean(within / fit.sigma_m_s2**2)) if np.any(within > 1e-9 * fit.sigma_m_s2**2) else 0.0
        self._weighted = fit.jacobian / fit.sigma_m_s2[:, None], fit.residual_m_s2 / fit.sigma_m_s2
        every = sorted(self.all)
        self._parts = {
            frozenset(kept): self._part(frozenset(kept))
            for count in range(len(every) + 1)
            for kept in combinations(every, count)
        }

    def _part(self, kept: Terms) -> _Part:
        fit = self._fit
        out = [k for term in self.all - kept for k in self._coordinates[term]]
        stays = [k for k in range(len(self._value)) if k not in out]
        J, r = self._weighted
        step = np.zeros(len(self._value))
        step[out] = -self._value[out]
        Q, R = np.linalg.qr(J[:, stays])
        goal = r + J @ step
        inverse = np.linalg.inv(R)
        step[stays] = -inverse @ (Q.T @ goal)
        rest = r + J @ step
        to_parameters = fit.basis[:, stays] @ inverse
        quadratic = [row for row, k in enumerate(stays) if k in self._coordinates.get("quadratic", ())]
        return _Part(
            # Ideal outputs leave nothing but rounding, and no ratio of it means anything.
            chi_squared=max(float(rest @ rest), _ROUNDING * len(rest)),
            freedom=len(r) - len(stays),
            change=fit.basis @ step,
            covariance=to_parameters @ to_parameters.T,
            quadratic_variance=float(np.mean(np.sum(inverse[quadratic] ** 2, axis=1))) if quadratic else 0.0,
        )

    def chance(self, terms: Terms) -> float:
        """Return the p of the F test of some terms, given the others."""
        full, without = self._parts[self.all], self._parts[self.all - terms]
        count = without.freedom - full.freedom
        F = (without.chi_squared - full.chi_squared) / count / (full.chi_squared / full.freedom)
        return f_tail(count, full.freedom, F)

    def admitted(self, level: float = LEVEL) -> Terms:
        """Return the terms that pass."""
        if not self.chance(self.all) < level:
            return frozenset()
        alone: list[tuple[float, Term]] = sorted((self.chance(frozenset({term})), term) for term in self.all)
        # Holm: the smallest p against level / 2, the other against level. Without a first rejection nothing is refuted.
        if len(alone) == 2 and alone[0][0] < level / 2 and not alone[1][0] < level:
            kept: Terms = frozenset({alone[0][1]})
            return kept
        return self.all

    def choice(self, kept: Terms, typical_quadratic_m_s2: float = math.inf) -> Choice:
        """Return what choosing some terms makes of the covariance.

        Parameters
        ----------
        kept : set of terms
        typical_quadratic_m_s2 : float
            1 sigma of a quadratic term that is not admitted, at 1 g; infinite where nothing says it.
        """
        own = self._parts[kept]
        counted = [terms for terms in self._parts if "quadratic" not in self.all - kept or "quadratic" in terms]
        log_odds = np.array([self._log_odds(terms) for terms in counted])
        weights = np.exp(log_odds - log_odds.max())
        weights /= weights.sum()
        parts = [self._drawn(terms, math.inf if "quadratic" in kept else typical_quadratic_m_s2) for terms in counted]
        variances = np.array([self._variance(part) for part in parts])
        shift = np.array([part.change - own.change for part in parts])
        covariance = np.array([part.covariance for part in parts]) * variances[:, None, None]
        total = np.tensordot(weights, covariance + shift[:, :, None] * shift[:, None, :], axes=1)
        smallest = math.sqrt(np.finfo(float).tiny)
        size = np.maximum(np.sqrt(np.diag(total)), smallest)
        limit = np.maximum(sigma_of_mixture(weights, shift, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))), smallest)
        variance = float(weights @ variances)
        # As correlations: parameters differ in unit by ten powers of ten.
        more = total / np.outer(size, size) - own.covariance * variance / np.outer(limit, limit)
        values, vectors = np.linalg.eigh(more)
        return Choice(
            root=limit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)),
            variance_ratio=variance / self._variance(own),
            freedom_ratio=float(weights @ [part.freedom for part in parts]) / own.freedom,
        )

    def _drawn(self, terms: Terms, typical_m_s2: float) -> _Part:
        """Return a part with its quadratic term drawn from what is typical."""
        part, without = self._parts[terms], self._parts[terms - {"quadratic"}]
        if typical_m_s2 == math.inf or part is without:
            return part
        unit, V = self._variance(part), self._variance(part) * part.quadratic_variance
        F = (without.chi_squared - part.chi_squared) / (without.freedom - part.freedom) / unit
        f = 1 / (1 + V / max(typical_m_s2**2, (F - 1) * V))
        return replace(
            part,
            change=without.change + f * (part.change - without.change),
            covariance=without.covariance + f * (part.covariance - without.covariance),
        )

    def bias_shift_m_s2(self) -> float:
        """Return by how much all terms together move the bias, at most over the axes."""
        with_all, without = self._parts[self.all], self._parts[frozenset()]
        return float(np.abs(with_all.change - without.change)[BIAS].max())

    def confusion(self) -> float:
        """Return how much less sure the bias is with all terms than with the worse of them alone."""
        if len(self.all) < 2:
            return 1.0
        # Over the three axes together: one of them depends on how two or three positions happened to be placed.
        variance = {terms: float(np.trace(part.covariance[BIAS, BIAS])) for terms, part in self._parts.items()}
        alone = max(variance[terms] for terms in variance if len(terms) == 1)
        return math.sqrt(variance[self.all] / alone)

    def _variance(self, part: _Part) -> float:
        """Return the variance of residuals, in units of the sigmas of the fit of all."""
        return max(part.chi_squared / part.freedom, self._least)

    def _log_odds(self, terms: Terms) -> float:
        """Return the logarithm of the Bayes factor against no term at all ([2]_ eq. 6)."""
        none, part = self._parts[frozenset()], self._parts[terms]
        m = len(self._fit.residual_m_s2)
        unexplained = part.chi_squared / none.chi_squared
        return 0.5 * (part.freedom * math.log1p(m) - none.freedom * math.log1p(m * unexplained))
