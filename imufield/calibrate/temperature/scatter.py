"""How far sessions and ramps scatter about the polynomials of ``fit``: variances by restricted maximum likelihood.

The rows of one axis, bias and scale of each session first, then the blocks of ramps, are

    y = X beta + e,    cov e = V = diag(S_1, ..., S_m, 0) + s_b^2 Z_b + s_k^2 Z_k + f^2 R

``S_j`` is the covariance of bias and scale of session j, ``Z_b`` and ``Z_k`` pick the rows of each: from day to day bias and
scale change independently, however their errors within a session are correlated. ``R`` has the variances given for ramps, lower
bounds, so f >= 1. The three variances are those of all axes of a triad together. Fisher scoring [1]_ solves, with
``P = V^-1 - V^-1 X (X^T V^-1 X)^-1 X^T V^-1`` and the matrix Z_i of each variance,

    sum_j tr(P Z_i P Z_j) (v_j' - v_j) = y^T P Z_i P y - tr(P Z_i)

A step goes no further than ``solvers.scoring`` lets it. Half of the matrix is the information on the variances, from which
the degrees of freedom of what is stated come [2]_.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related problems", Journal of the
   American Statistical Association 72 (1977) 320.
.. [2] F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics Bulletin 2 (1946) 110.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.model.uncertainty import inverse_root
from imufield.calibrate.solvers.scoring import cut_at_top
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

BIAS, SCALE, RAMP = range(3)
"""Kinds of rows, each with a variance."""
LEAST = np.array([0.0, 0.0, 1.0])
"""What the variances are at least."""
FEWEST_FREEDOM = 0.5
"""Free rows of one kind: with fewer the others fit them, and they show no scatter."""
_MOST_LEFT = 0.9  # Share of a variance: of what is stated for another day it is half at most.
_STEPS = 50  # Of the scoring, at most; it takes 5 to 20.
_SETTLED = 1e-6  # Relative change of a variance, against a sampling error of a fifth and more.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Equations:
    """Rows of one axis: n of k unknowns."""

    matrix: FloatArray
    """X, shape (n, k)."""
    values: FloatArray
    """y, shape (n,)."""
    own: FloatArray
    """Of the rows of sessions, s of them: the covariance of their errors, shape (s, s)."""
    sigma: FloatArray
    """Of the rows of ramps, shape (n - s,)."""
    kind: NDArray[np.intp]
    """Of each row, shape (n,)."""

    def covariance(self, variances: FloatArray) -> FloatArray:
        """Return V of the rows of sessions, shape (s, s)."""
        return self.own + np.diag(variances[self.kind[: len(self.own)]])


class Whitened(NamedTuple):
    """Equations over the root of V."""

    matrix: FloatArray
    values: FloatArray
    root: FloatArray
    """Inverse of the root of V of the rows of sessions, shape (s, s)."""
    weight: FloatArray
    """The same of the others, shape (n - s,)."""

    def residual(self) -> FloatArray:
        """Return what the best fit leaves, shape (n,)."""
        return np.asarray(self.values - self.matrix @ np.linalg.lstsq(self.matrix, self.values, rcond=None)[0])

    def inverse(self) -> FloatArray:
        """Return the rows that give each unknown from the values before they were whitened, shape (k, n)."""
        inverse, sessions = np.linalg.pinv(self.matrix), len(self.root)
        return np.hstack([inverse[:, :sessions] @ self.root, inverse[:, sessions:] * self.weight])


class Scatter(NamedTuple):
    """Variances of bias and scale from day to day, and the factor on those of ramps."""

    variances: FloatArray
    """Shape (3,)."""
    covariance: FloatArray
    """Of their errors, shape (3, 3); zero for what no row shows."""
    freedom: FloatArray
    """How many rows of each kind the fit leaves free, shape (3,)."""

    @property
    def weights(self) -> FloatArray:
        """What each of ``shares_of`` counts, shape (4,)."""
        return np.append(1.0, self.variances)

    def freedom_of(self, shares: FloatArray, kind: int, left: FloatArray) -> FloatArray:
        """Return the degrees of freedom of errors of a kind for Student's distribution, shape (n,).

        Parameters
        ----------
        shares : ndarray, shape (4, n)
            What the variances of the errors are the sum of, as ``shares_of``.
        kind : int
        left : ndarray, shape (n,)
            Variance of the part of each error that is in the residuals: where that part is large, so is the scatter found.
        """
        total = self.weights @ shares
        spread = np.einsum("in,ij,jn->n", shares[1:], self.covariance, shares[1:])
        # Variances at their bound would make less of it than the rows that they come from.
        freedom = np.fmax(2 * total**2 / np.maximum(spread, np.finfo(np.float64).tiny), self.freedom[kind])
        share = np.minimum(left / total, _MOST_LEFT)
        return np.asarray(freedom + np.maximum(freedom - 1, 0.0) * share / (1 - share))


def shares_of(rows: FloatArray, equations: Equations) -> FloatArray:
    """Return what the covariance of linear functions of the values, shape (k, n), is the sum of, shape (4, k, k).

    First the sessions' own errors, then what one unit of each variance adds.
    """
    sessions = len(equations.own)
    of_sessions, of_ramps = rows[:, :sessions], rows[:, sessions:] * equations.sigma
    of_kind = [of_sessions[:, equations.kind[:sessions] == kind] for kind in (BIAS, SCALE)]
    return np.array([of_sessions @ equations.own @ of_sessions.T, *(of @ of.T for of in (*of_kind, of_ramps))])


def whitened(equations: Equations, variances: FloatArray) -> Whitened:
    """Return equations over the root of V."""
    root = inverse_root(equations.covariance(variances))
    weight = 1 / (equations.sigma * np.sqrt(variances[RAMP]))
    both = np.column_stack([equations.matrix, equations.values])
    both = np.vstack([root @ both[: len(root)], weight[:, None] * both[len(root) :]])
    return Whitened(both[:, :-1], both[:, -1], root, weight)


def scatter_of(axes: Sequence[Equations]) -> Scatter:
    """Return the variances of the largest restricted likelihood of all axes."""
    variances = _first(axes)
    information, observed_part, squares, traces, freedom = _sums(axes, variances)
    for _ in range(_STEPS):
        score = squares - traces
        step = _bounded(information, information @ variances + score, variances) - variances
        before, variances = variances, variances + cut_at_top(step, score, 2 * observed_part - information)
        information, observed_part, squares, traces, freedom = _sums(axes, variances)
        if np.all(np.abs(variances - before) <= _SETTLED * variances):
            break
    size = np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    covariance = 2 * np.linalg.pinv(information / np.outer(size, size), hermitian=True) / np.outer(size, size)
    return Scatter(variances, covariance, freedom)


def scatter_ratio(axes: Sequence[Equations]) -> float:
    """Return the scatter about the best fit over the sigma given, of the kind of rows where it is largest; 1 at least.

    Hundreds of blocks of a ramp that lie on the curve say nothing of three scales that do not.
    """
    *_, squares, traces, freedom = _sums(axes, LEAST)
    shown = freedom >= FEWEST_FREEDOM
    return math.sqrt(np.max(squares[shown] / traces[shown], initial=1.0))


def _first(axes: Sequence[Equations]) -> FloatArray:
    """Return variances that are rather too large: from above, the first step is that of rows that count alike."""
    kind = np.concatenate([each.kind for each in axes])
    off = np.concatenate([each.values - _means_by_kind(each) for each in axes])
    mean_square = np.bincount(kind, off**2, minlength=3) / np.maximum(np.bincount(kind, minlength=3), 1)
    return np.asarray(np.maximum(mean_square * [1.0, 1.0, 0.0], LEAST))


def _means_by_kind(equations: Equations) -> FloatArray:
    """Return for each value the mean of its kind: the outputs of a ramp are gravity, beside which biases are nothing."""
    counts = np.bincount(equations.kind, minlength=3)
    return np.asarray((np.bincount(equations.kind, equations.values, minlength=3) / np.maximum(counts, 1))[equations.kind])


class _Terms(NamedTuple):
    """What the variances of the kinds follow from."""

    information: FloatArray
    """tr(P Z_i P Z_j), shape (3, 3)."""
    observed_part: FloatArray
    """y^T P Z_i P Z_j P y, shape (3, 3)."""
    squares: FloatArray
    """y^T P Z_i P y, shape (3,)."""
    traces: FloatArray
    """tr(P Z_i): what the squares are expected to be, shape (3,)."""
    freedom: FloatArray
    """How many rows of each kind are free, shape (3,)."""


def _sums(axes: Sequence[Equations], variances: FloatArray) -> _Terms:
    """Return the terms of all axes."""
    return _Terms(*(np.sum(terms, axis=0) for terms in zip(*(_terms(each, variances) for each in axes), strict=True)))


def _terms(equations: Equations, variances: FloatArray) -> _Terms:
    white, sessions = whitened(equations, variances), len(equations.own)
    U, size, _ = np.linalg.svd(white.matrix, full_matrices=False)
    U = U[:, size > size[0] * np.finfo(np.float64).eps * max(white.matrix.shape)]
    residual = white.values - U @ (U.T @ white.values)
    blocks = len(U) - sessions
    rows = [white.root[:, equations.kind[:sessions] == kind] for kind in (BIAS, SCALE)]
    # Z_i between the roots; of ramps it is the unit matrix over f^2.
    parts = np.array([of_kind @ of_kind.T for of_kind in rows])
    fitted = np.zeros((3, *U.shape))
    fitted[:RAMP, :sessions] = parts @ U[:sessions]
    fitted[RAMP, sessions:] = U[sessions:] / variances[RAMP]
    inside = U.T @ fitted
    whole = np.zeros((3, 3))
    whole[:RAMP, :RAMP] = np.einsum("iab,jba->ij", parts, parts)
    whole[RAMP, RAMP] = blocks / variances[RAMP] ** 2
    information = whole - 2 * np.einsum("inp,jnp->ij", fitted, fitted) + np.einsum("ipq,jqp->ij", inside, inside)
    traces = np.append(np.trace(parts, axis1=1, axis2=2), blocks / variances[RAMP]) - np.trace(inside, axis1=1, axis2=2)
    ZPy = np.zeros((3, len(U)))
    ZPy[:RAMP, :sessions] = parts @ residual[:sessions]
    ZPy[RAMP, sessions:] = residual[sessions:] / variances[RAMP]
    observed_part = ZPy @ ZPy.T - (ZPy @ U) @ (ZPy @ U).T
    # Of rows that count alike the share of free ones.
    share = np.diag(information) / np.maximum(np.diag(whole), np.finfo(np.float64).tiny)
    return _Terms(information, observed_part, ZPy @ residual, traces, np.bincount(equations.kind, minlength=3) * share)


def _bounded(information: FloatArray, right: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the solution of the normal equations, none below its bound."""
    found = variances.copy()
    for _ in range(_STEPS):
        for k in range(3):
            if information[k, k] > 0:
                found[k] += (right[k] - information[k] @ found) / information[k, k]
            found[k] = max(found[k], LEAST[k])
    return found
