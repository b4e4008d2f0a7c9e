"""Other methods than least squares for the gyroscope, and their agreement as proof.

Model, weights and uncertainties are those of ``calibrate_gyroscope``; a method looks for the parameters again from where that
began (preset, driver, or the rough start), in whitened coordinates: moves against gravity, whole turns and turntable rates
(vector form) together, or the norm of the Earth's rate and its vertical part where the session has stills alone. A static bias
is a mean over positions; there is nothing to search. What is known of the Earth's rate goes along as rows of its own; azimuths
start where the fit left them.

Integrating the moves of a session takes milliseconds, and a swarm asks for 72 000 costs. Near a point the residuals ``r`` (in
units of sigma) are linear in the parameters, so a method searches the cost of ``r + J (x - x0)``; then everything is integrated
anew at what it found, and it searches again, until a round moves by less than a sigma. What is not linear in that last step is
of second order: nothing.

Coordinates are whitened as for the accelerometer (``accelerometer.swarm_coordinates``): with ``J = U D V^T``, and ``|r|`` at
the start of a round as unit,

    x = x0 + |r| V D^-1 z,        r(z) = r + |r| U z
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imufield.calibrate.gyroscope.fit import make_prior
from imufield.calibrate.gyroscope.move_integration import PARAMETERS
from imufield.calibrate.gyroscope.residuals import evaluate
from imufield.calibrate.gyroscope.result import (
    GyroscopeResult,
    JointSolution,
    StaticSolution,
    forward,
    joint_result,
    static_norm_result,
)
from imufield.calibrate.gyroscope.stills_alone import linearise_static
from imufield.calibrate.model.result import GYROSCOPE_NAMES
from imufield.calibrate.solvers.agreement import LEAST_SQUARES, Attempt, CrossCheck, compare
from imufield.calibrate.solvers.base import SolverResult, SolverStatus
from imufield.calibrate.solvers.norm_problem import Coordinates, CostName
from imufield.calibrate.solvers.registry import find_method, load_solver
from imufield.dataclass import dataclass, replace
from imufield.samples import FloatArray, IntArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_REACH = 5.0  # Bounds of the coordinates: the solution is about one unit away, and this leaves room.
# Of a round, in the problem's unit: the size of the papers' costs, for which the first steps of their swarms are made.
_COST_AT_START = 0.01
_ROUNDS = 20  # At most; then it says that it did not converge.
_HALVINGS = 6  # Of a step that does not lower the cost: down to a sixty-fourth.
# Move of a round, per root of the number of coordinates, after which what is not linear is of second order.
_SETTLED_SIGMA = 1.0
# Singular values below this share of the largest are directions that nothing shows; they stay where they are.
_INVISIBLE = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedFit:
    """A fit that can be searched again, at the weights it ended with."""

    solution: JointSolution | StaticSolution
    p: FloatArray
    """All parameters where the fit ended."""
    free: IntArray
    """Which of ``p`` are searched, shape (n,)."""
    start: FloatArray
    """The free parameters where the fit began, shape (n,)."""
    root: FloatArray
    """Cholesky factor of the covariance of all residuals, where the fit ended."""

    def all_parameters(self, x: FloatArray) -> FloatArray:
        """Return ``p`` with the free parameters replaced."""
        p = self.p.copy()
        p[self.free] = x
        return p

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals in units of sigma, shape (m,), and their derivative, shape (m, n)."""
        solution, p = self.solution, self.all_parameters(x)
        if isinstance(solution, JointSolution):
            now = evaluate(p, solution.data)
            residual, jacobian = now.residual, now.jacobian
            known, by_known = make_prior(solution.data, heading=solution.chosen.fit.heading_fitted).rows(p, self.free)
        else:
            residual, jacobian, _ = linearise_static(p, solution.data)
            known, by_known = np.empty(0), np.empty((0, len(x)))
        rows = np.asarray(np.linalg.solve(self.root, np.column_stack([residual, jacobian[:, self.free]])), dtype=np.float64)
        return np.concatenate([rows[:, 0], known]), np.vstack([rows[:, 1:], by_known])

    def instrument(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the 21 numbers of the instrument and their derivative by ``x``, shape (21, n)."""
        solution, p = self.solution, self.all_parameters(x)
        fitted_all = isinstance(solution, JointSolution)
        values, J = forward(p[:PARAMETERS] if fitted_all else np.append(p[:12], np.zeros(9)), solution.given.rest_raw)
        own = self.free < PARAMETERS  # the others are the Earth's rate
        by_free = np.zeros((PARAMETERS, len(own)))
        by_free[:, own] = J[:, self.free[own]]
        return values, by_free

    def result(self, x: FloatArray, solved: SolverResult) -> GyroscopeResult:
        """Return the calibration with these parameters."""
        solution, p = self.solution, self.all_parameters(x)
        if isinstance(solution, StaticSolution):
            return static_norm_result(replace(solution, fitted=replace(solution.fitted, x=p[:12], converged=solved.converged)))
        fit = replace(solution.chosen.fit, p=p, evaluation=evaluate(p, solution.data), solved=solved)
        return joint_result(replace(solution, chosen=replace(solution.chosen, fit=fit)))


def searched_fit(result: GyroscopeResult) -> SearchedFit | None:
    """Return the fit behind a result, ready to be searched; None for a static bias."""
    solution = result.basis
    if solution is None:
        return None
    if isinstance(solution, JointSolution):
        fit = solution.chosen.fit
        start, free, covariance = fit.p.copy(), fit.free, fit.parts.total(fit.scatter)
        start[:PARAMETERS] = solution.start[:PARAMETERS]  # azimuths stay as fitted
        p = fit.p
    else:
        start, free = solution.fitted.start, np.array(solution.fitted.columns, dtype=np.int64)
        p = np.concatenate([solution.fitted.x, start[12:]])
        covariance = linearise_static(p, solution.data)[2].total(solution.fitted.scatter)
    root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    return SearchedFit(solution=solution, p=p, free=free, start=start[free], root=root)


def rows_cost(residual: FloatArray, cost_name: CostName) -> FloatArray:
    """Return a cost of residuals in units of sigma, shape (..., m) -> (...).

    "absolute" is their sum, "weighted" the sum of their squares, "squares" its root over m - 1: for rows that are no norms
    the form of eq. 7 and the least squares have one minimum.
    """
    if cost_name == "absolute":
        return np.asarray(np.abs(residual).sum(axis=-1))
    squares = np.einsum("...m,...m->...", residual, residual)
    return np.asarray(squares if cost_name == "weighted" else np.sqrt(squares / (residual.shape[-1] - 1)))


@dataclass(frozen=True, slots=True, kw_only=True)
class RowsProblem(Coordinates):
    """One round: linear residuals in whitened coordinates (satisfies ``solvers.base.Problem``).

    Attributes
    ----------
    residual : ndarray, shape (m,)
        At the start of the round, in units of sigma.
    by_coordinates : ndarray, shape (m, n)
    cost_name : {"absolute", "squares", "weighted"}
    cost_unit : float
        The mutation factor of differential evolution (eq. 17 of its paper) is not free of units and stays up where costs are
        large; in the paper they are 0.005 at the end.
    """

    residual: FloatArray
    by_coordinates: FloatArray
    cost_name: CostName
    cost_unit: float

    def vector(self, z: FloatArray) -> FloatArray:
        """Return parameters of coordinates, shape (n,) -> (k,)."""
        return np.asarray(self.origin + self.basis @ z)

    def cost(self, candidates: FloatArray) -> FloatArray:
        """Return the cost of a population in its unit, shape (c, n) -> (c,)."""
        return rows_cost(self.residual + candidates @ self.by_coordinates.T, self.cost_name) / self.cost_unit

    def residuals(self, z: FloatArray) -> FloatArray:
        """Return the residuals, shape (m,)."""
        return np.asarray(self.residual + self.by_coordinates @ z)

    def jacobian(self, z: FloatArray) -> FloatArray:  # noqa: ARG002  (linear)
        """Return the derivative of ``residuals``, shape (m, n)."""
        return self.by_coordinates


def rows_problem(fitted: SearchedFit, x: FloatArray, cost_name: CostName) -> RowsProblem:
    """Return the problem of one round at ``x``."""
    residual, jacobian = fitted.linearise(x)
    size = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    U, D, Vt = np.linalg.svd(jacobian / size, full_matrices=False)
    visible = _INVISIBLE * D[0] < D
    # A unit is at least a sigma, or a fit without residuals would leave no room to search.
    unit = max(float(np.linalg.norm(residual)), 1.0)
    return RowsProblem(
        residual=residual,
        by_coordinates=unit * U[:, visible],
        origin=x,
        basis=unit * (Vt[visible].T / D[visible]) / size[:, None],
        cost_name=cost_name,
        reach=_REACH,
        cost_unit=max(float(rows_cost(residual, cost_name)), 1.0) / _COST_AT_START,
    )


def search(
    fitted: SearchedFit,
    method: str,
    cost_name: CostName,
    *,
    rng: np.random.Generator,
    start: FloatArray | None = None,
    settings: Mapping[str, str] | None = None,
) -> SolverResult:
    """Search for the parameters again; ``x`` of the result holds parameters.

    An absolute cost has edges: ten thousand sigmas off, with two dozen coordinates, a swarm stalls in one. So the method first
    comes near by the sum of squares, then looks for the absolute minimum from there.

    Raises
    ------
    UsageError
        If there is no such method.
    CalibrationError
        If it cannot start.
    """
    x = fitted.start if start is None else start
    evaluations = 0
    if cost_name == "absolute" and start is None:
        near = search(fitted, method, "weighted", rng=rng, settings=settings)
        x, evaluations = near.x, near.evaluations
    number = 0
    while True:
        number += 1
        problem = rows_problem(fitted, x, cost_name)
        found = load_solver(method, settings)(problem, rng=rng)
        evaluations += found.evaluations
        step = problem.vector(found.x) - x
        moved = float(np.linalg.norm(problem.by_coordinates @ found.x))
        # Take the step, or the half of it that first lowers the cost.
        before = rows_cost(problem.residual, cost_name)
        halving = 0
        while halving < _HALVINGS and not rows_cost(fitted.linearise(x + step / 2**halving)[0], cost_name) <= before:
            halving += 1
        x = x + step / 2**halving
        cost = float(rows_cost(fitted.linearise(x)[0], cost_name))
        ended = replace(found, x=x, cost=cost, evaluations=evaluations)
        # A round that came near but not all the way is followed by one with a smaller unit; only the last has to converge.
        if found.status is SolverStatus.FAILED or moved <= _SETTLED_SIGMA * np.sqrt(len(found.x)):
            return replace(ended, message=sentence("methods.round", message=found.message, round=number))
        if number == _ROUNDS:
            message = sentence("methods.round_limit", moved_sigma=moved, rounds=_ROUNDS)
            return replace(ended, status=SolverStatus.ITERATION_LIMIT, message=message)


def solve_gyroscope_with(
    method: str,
    result: GyroscopeResult,
    *,
    rng: np.random.Generator,
    polish: bool = True,
    settings: Mapping[str, str] | None = None,
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
    settings : mapping of str, optional
        Of the method, as ``load_solver`` takes them.

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
    fitted = searched_fit(result)
    if method == LEAST_SQUARES or fitted is None:
        return result, None
    found = search(fitted, method, cost_name, rng=rng, settings=settings)
    if polish and found.converged:
        found = search(fitted, LEAST_SQUARES, "weighted", rng=rng, start=found.x).as_polish_of(found)
    return fitted.result(found.x, found), found


def cross_check_gyroscope(result: GyroscopeResult, *, rng: np.random.Generator) -> CrossCheck | None:
    """Search with several methods and compare in units of sigma of the fit alone; None for a static bias.

    Raises
    ------
    CalibrationError
        If a method cannot start.
    """
    fitted = searched_fit(result)
    if fitted is None:
        return None

    def attempt(method: str, cost_name: CostName) -> Attempt:
        found = search(fitted, method, cost_name, rng=rng)
        return fitted.instrument(found.x)[0], "" if found.converged else found.message

    best = search(fitted, LEAST_SQUARES, "weighted", rng=rng).x
    A = fitted.linearise(best)[1]
    J = fitted.instrument(best)[1]
    variance = np.einsum("ij,jk,ik->i", J, np.linalg.pinv(A.T @ A, hermitian=True), J)
    return compare("gyroscope", attempt, GYROSCOPE_NAMES, np.sqrt(np.maximum(variance, 0.0)))
