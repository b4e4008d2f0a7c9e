"""Other methods than least squares for the gyroscope, and their agreement as proof.

Model, weights and uncertainties are those of ``calibrate_gyroscope``; a method looks for the parameters again from where that
began (preset, driver, or the rough start), in whitened coordinates: moves against gravity, whole turns and turntable rates
(vector form) together, or the norm of the Earth's rate and its vertical part where the session has stills alone. A static bias
is a mean over positions; there is nothing to search.

What is known of the Earth's rate goes along as rows of its own; azimuths start where the fit left them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from imufield.calibrate.gyroscope.fit import JointFit, make_prior
from imufield.calibrate.gyroscope.linear_rows import search
from imufield.calibrate.gyroscope.model import evaluate
from imufield.calibrate.gyroscope.move_integration import PARAMETERS
from imufield.calibrate.gyroscope.report import (
    GYROSCOPE_NAMES,
    Described,
    GyroscopeResult,
    StaticNorm,
    describe,
    forward,
    static_norm_result,
)
from imufield.calibrate.gyroscope.static_norm import linearise_static
from imufield.calibrate.solvers.agreement import CROSS_CHECKED, LEAST_SQUARES, Attempt, CrossCheck, compare
from imufield.calibrate.solvers.base import SolverResult
from imufield.calibrate.solvers.costs import CostName
from imufield.calibrate.solvers.registry import find_method
from imufield.samples import FloatArray


class Searchable(Protocol):
    """A path that a method can search."""

    @property
    def start(self) -> FloatArray:
        """Free parameters where the fit began, shape (n,)."""
        ...

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals in units of sigma, shape (m,), and their derivative, shape (m, n)."""
        ...

    def instrument(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the 21 numbers of the instrument and their derivative by ``x``, shape (21, n)."""
        ...

    def result(self, x: FloatArray, solved: SolverResult) -> GyroscopeResult:
        """Return the calibration with these parameters."""
        ...


@dataclass(frozen=True, slots=True)
class JointSearch:
    """Moves, stills, stops and turntable."""

    what: Described
    root: FloatArray
    """Cholesky factor of the covariance of all residuals, where the fit ended."""

    @property
    def start(self) -> FloatArray:
        """The start of the fit, azimuths as fitted."""
        fit = self.what.fit
        p = fit.p.copy()
        p[:PARAMETERS] = self.what.start[:PARAMETERS]
        return p[fit.free]

    def _whole(self, x: FloatArray) -> FloatArray:
        p = self.what.fit.p.copy()
        p[self.what.fit.free] = x
        return p

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Integrate all moves at ``x``."""
        fit, p = self.what.fit, self._whole(x)
        now = evaluate(p, self.what.data)
        whitened = np.linalg.solve(self.root, np.column_stack([now.residual, now.jacobian[:, fit.free]]))
        prior = make_prior(self.what.data, self.what.earth, heading=fit.heading_fitted)
        residual, jacobian = prior.rows(p, fit.free)
        rows = np.asarray(whitened, dtype=np.float64)
        return np.concatenate([rows[:, 0], residual]), np.vstack([rows[:, 1:], jacobian])

    def instrument(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the instrument's numbers."""
        values, J = forward(self._whole(x)[:PARAMETERS], self.what.data.rest_raw)
        own = self.what.fit.free < PARAMETERS
        by_free = np.zeros((PARAMETERS, len(own)))
        by_free[:, own] = J[:, self.what.fit.free[own]]
        return values, by_free

    def result(self, x: FloatArray, solved: SolverResult) -> GyroscopeResult:
        """Describe what was found."""
        p = self._whole(x)
        fit: JointFit = replace(self.what.fit, p=p, evaluation=evaluate(p, self.what.data), solved=solved)
        return describe(replace(self.what, fit=fit))


@dataclass(frozen=True, slots=True)
class StaticSearch:
    """The norm of the Earth's rate and its vertical part at still positions."""

    what: StaticNorm
    root: FloatArray

    @property
    def start(self) -> FloatArray:
        """The preset."""
        return self.what.start[self.what.columns]

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return norm and invariant of every still."""
        residual, jacobian, _ = linearise_static(self._whole(x), self.what.data)
        whitened = np.linalg.solve(self.root, np.column_stack([residual, jacobian[:, self.what.columns]]))
        return np.asarray(whitened[:, 0], dtype=np.float64), np.asarray(whitened[:, 1:], dtype=np.float64)

    def _whole(self, x: FloatArray) -> FloatArray:
        p = self.what.start.copy()
        p[self.what.columns] = x
        return p

    def instrument(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the instrument's numbers."""
        values, J = forward(np.concatenate([self._whole(x)[:12], np.zeros(9)]), self.what.rest_raw)
        return values, J[:, self.what.columns]

    def result(self, x: FloatArray, solved: SolverResult) -> GyroscopeResult:
        """Describe what was found."""
        fitted = replace(self.what.fitted, x=self._whole(x)[:12], converged=solved.converged)
        return static_norm_result(replace(self.what, fitted=fitted))


def searchable(result: GyroscopeResult) -> Searchable | None:
    """Return the path behind a result, ready to be searched; None for a static bias."""
    basis = result.basis
    if isinstance(basis, Described):
        return JointSearch(basis, _root(basis.fit.parts.total(basis.fit.scatter)))
    if isinstance(basis, StaticNorm):
        at_fit = np.concatenate([basis.fitted.x, basis.start[12:]])
        parts = linearise_static(at_fit, basis.data)[2]
        return StaticSearch(basis, _root(parts.total(basis.fitted.scatter)))
    return None


def _root(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def solve_gyroscope_with(
    method: str, result: GyroscopeResult, *, rng: np.random.Generator, polish: bool = True
) -> tuple[GyroscopeResult, SolverResult | None]:
    """Return the gyroscope with parameters found by another method, and how that ended.

    Parameters
    ----------
    method : str
        A name of ``solvers.registry.METHODS``.
    result : GyroscopeResult
        From ``calibrate_gyroscope``: model, weights and uncertainties.
    rng : Generator
    polish : bool
        Finish by least squares.

    Returns
    -------
    result : GyroscopeResult
    solved : SolverResult or None
        None where there was nothing to search: least squares asked for, or a static bias.

    Raises
    ------
    UsageError
        If there is no such method.
    CalibrationError
        If it cannot start.
    """
    cost_name = find_method(method).cost_name
    again = searchable(result)
    if method == LEAST_SQUARES or again is None:
        return result, None
    found = search(again, method, cost_name, rng=rng)
    if polish and found.converged:
        solved = search(again, LEAST_SQUARES, "weighted", rng=rng, start=found.x)
        evaluations = found.evaluations + solved.evaluations
        message = f"{found.message}; polished by least squares: {solved.message}"
        found = replace(solved, message=message, evaluations=evaluations)
    return again.result(found.x, found), found


def cross_check_gyroscope(
    result: GyroscopeResult, *, rng: np.random.Generator, methods: Sequence[str] = CROSS_CHECKED
) -> CrossCheck | None:
    """Search with several methods and compare in units of sigma of the fit alone; None for a static bias.

    Raises
    ------
    UsageError
        If there is no such method.
    CalibrationError
        If a method cannot start.
    """
    again = searchable(result)
    if again is None:
        return None

    def attempt(method: str, cost_name: CostName) -> Attempt:
        found = search(again, method, cost_name, rng=rng)
        return again.instrument(found.x)[0], "" if found.converged else found.message

    best = search(again, LEAST_SQUARES, "weighted", rng=rng).x
    A = again.linearise(best)[1]
    J = again.instrument(best)[1]
    variance = np.einsum("ij,jk,ik->i", J, np.linalg.pinv(A.T @ A, hermitian=True), J)
    return compare("gyroscope", attempt, GYROSCOPE_NAMES, np.sqrt(np.maximum(variance, 0.0)), methods=methods)
