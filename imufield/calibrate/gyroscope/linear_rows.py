"""Residuals that are nearly linear in what is sought, for methods that ask for thousands of costs.

Integrating the moves of a session takes milliseconds, and a swarm asks for 72 000 costs. Near a point the residuals ``r`` (in
units of sigma) are linear in the parameters, so a method searches the cost of ``r + J (x - x0)``; then everything is integrated
anew at what it found, and it searches again, until a round moves by less than a sigma. What is not linear in that last step is
of second order: nothing.

Coordinates are whitened as for the accelerometer (``whitening``): with ``J = U D V^T``, and ``|r|`` at the start of
a round as unit,

    x = x0 + |r| V D^-1 z,        r(z) = r + |r| U z
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from imufield.calibrate.solvers.base import Callback, SolverResult, SolverStatus
from imufield.calibrate.solvers.costs import CostName
from imufield.calibrate.solvers.registry import load_solver
from imufield.samples import FloatArray

_REACH = 5.0  # Bounds of the coordinates: the solution is about one unit away, and this leaves room.
# Of a round, in the problem's unit: the size of the papers' costs, for which the first steps of their swarms are made.
_COST_AT_START = 0.01
_ROUNDS = 20  # At most; then it says that it did not converge.
_HALVINGS = 6  # Of a step that does not lower the cost: down to a sixty-fourth.
# Move of a round, per root of the number of coordinates, after which what is not linear is of second order.
_SETTLED_SIGMA = 1.0
# Singular values below this share of the largest are directions that nothing shows; they stay where they are.
_INVISIBLE = 1e-12

Linearise = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Parameters, shape (n,), to residuals in units of sigma, shape (m,), and their derivative, shape (m, n)."""


class Fitted(Protocol):
    """A fit that can be searched again at the weights it ended with."""

    @property
    def start(self) -> FloatArray:
        """Parameters that know nothing of the fit, shape (n,)."""
        ...

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals in units of sigma and their derivative."""
        ...


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
class RowsProblem:
    """One round: linear residuals in whitened coordinates (satisfies ``solvers.base.Problem``).

    Attributes
    ----------
    residual : ndarray, shape (m,)
        At the start of the round, in units of sigma.
    by_coordinates : ndarray, shape (m, n)
    origin : ndarray, shape (k,)
        Parameters at the start of the round.
    basis : ndarray, shape (k, n)
    cost_name : {"absolute", "squares", "weighted"}
    cost_unit : float
        The mutation factor of differential evolution (eq. 17 of its paper) is not free of units and stays up where costs are
        large; in the paper they are 0.005 at the end.
    """

    residual: FloatArray
    by_coordinates: FloatArray
    origin: FloatArray
    basis: FloatArray
    cost_name: CostName
    cost_unit: float = 1.0

    @property
    def start(self) -> FloatArray:
        """Where the round starts."""
        return np.zeros(self.basis.shape[1])

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Limits of the coordinates."""
        reach = np.full(self.basis.shape[1], _REACH)
        return -reach, reach

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


def rows_problem(linearise: Linearise, x: FloatArray, cost_name: CostName) -> RowsProblem:
    """Return the problem of one round at ``x``."""
    residual, jacobian = linearise(x)
    size = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    U, D, Vt = np.linalg.svd(jacobian / size, full_matrices=False)
    seen = _INVISIBLE * D[0] < D
    unit = max(float(np.linalg.norm(residual)), 1.0)
    basis = unit * (Vt[seen].T / D[seen]) / size[:, None]
    cost_unit = max(float(rows_cost(residual, cost_name)), 1.0) / _COST_AT_START
    return RowsProblem(
        residual=residual, by_coordinates=unit * U[:, seen], origin=x, basis=basis, cost_name=cost_name, cost_unit=cost_unit
    )


def search(
    fitted: Fitted,
    method: str,
    cost_name: CostName,
    *,
    rng: np.random.Generator,
    start: FloatArray | None = None,
    callback: Callback | None = None,
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
        near = search(fitted, method, "weighted", rng=rng, callback=callback)
        x, evaluations = near.x, near.evaluations
    number = 0
    while True:
        number += 1
        problem = rows_problem(fitted.linearise, x, cost_name)
        found = load_solver(method)(problem, rng=rng, callback=callback)
        evaluations += found.evaluations
        step = problem.vector(found.x) - x
        moved = float(np.linalg.norm(problem.by_coordinates @ found.x))
        x = _walk(fitted.linearise, x, step, cost_name)
        cost = float(rows_cost(fitted.linearise(x)[0], cost_name))
        ended = replace(found, x=x, cost=cost, evaluations=evaluations)
        # A round that came near but not all the way is followed by one with a smaller unit; only the last has to converge.
        if found.status in (SolverStatus.FAILED, SolverStatus.STOPPED) or moved <= _SETTLED_SIGMA * np.sqrt(len(found.x)):
            return replace(ended, message=f"{found.message} (round {number})")
        if number == _ROUNDS:
            return replace(
                ended, status=SolverStatus.ITERATION_LIMIT, message=f"still moves by {moved:.2g} sigma after {_ROUNDS} rounds"
            )


def _walk(linearise: Linearise, x: FloatArray, step: FloatArray, cost_name: CostName) -> FloatArray:
    """Take the step, or the half of it that first lowers the cost."""
    cost = partial(rows_cost, cost_name=cost_name)
    before = cost(linearise(x)[0])
    for halving in range(_HALVINGS):
        trial = x + step / 2**halving
        if cost(linearise(trial)[0]) <= before:
            return np.asarray(trial)
    return np.asarray(x + step / 2**_HALVINGS)
