"""Least squares by Levenberg and Marquardt's method on the analytic Jacobian.

Each step is that of Gauss and Newton, by singular values; where it does not lower the cost as foretold, a damping in units of
the columns shortens it. It ends as MINPACK's ``lmder`` does [1]_.

Bounds say where a swarm looks, and a start outside them is a mistake for every method; they do not hold the minimum, which
here is wherever the residuals are least.

References
----------
.. [1] J. J. More, "The Levenberg-Marquardt algorithm: implementation and theory", Lecture Notes in Mathematics 630 (1978).
.. [2] H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05, Technical University of Denmark (1999).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imufield.calibrate.solvers.base import Problem, SolverResult, SolverStatus
from imufield.calibrate.solvers.population import check_start
from imufield.dataclass import replace
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# Relative change of cost and coordinates at which it stops: a few ulp above what double precision can resolve.
_TOLERANCE = 1e-14
_LEAST_GAIN = 1e-4  # Share of the gain foretold above which a step is taken, as in ``lmder``.
_POOR = 0.25  # Share below which the next step is damped more, as in ``lmder``.
_GOOD = 0.75  # Share above which the next step is damped less, as in ``lmder``.
# Where there was none: it shortens a step only along singular values below a thousandth of a column, whose length is one.
_FIRST_DAMPING = 1e-6
_MORE = 4.0  # Shortens to a quarter what is damped already, within the tenth to half by which ``lmder`` shortens.
_LESS = 3.0  # As in [2]_; no power of it is one of ``_MORE``, so that no damping is tried twice.
# By the status of ``scipy.optimize.least_squares``, whose own words are about the names of its settings.
_ENDINGS = {
    0: "least_squares.evaluation_limit",
    1: "least_squares.no_slope",
    2: "least_squares.cost_settled",
    3: "least_squares.parameters_settled",
    4: "least_squares.both_settled",
}


def solve_least_squares(
    problem: Problem,
    *,
    rng: np.random.Generator | None = None,  # noqa: ARG001 (one signature for all solvers)
    max_evaluations: int = 200,
) -> SolverResult:
    """Minimise the sum of squared residuals from the problem's start.

    Parameters
    ----------
    problem : Problem
    rng : Generator, optional
        Not used: the method is deterministic.
    max_evaluations : int

    Returns
    -------
    SolverResult
        ``cost`` is the sum of squared residuals (chi squared).

    Raises
    ------
    CalibrationError
        If the start is outside the bounds, or not finite.
    """
    check_start(problem)
    left_domain = sentence("least_squares.left_domain")
    failed = SolverResult(x=problem.start, cost=np.inf, status=SolverStatus.FAILED, message=left_domain, evaluations=0)
    try:
        end = _end(problem, max_evaluations)
    except np.linalg.LinAlgError as error:
        # A candidate outside the model's domain has NaN residuals; scipy and LAPACK refuse those.
        return replace(failed, message=sentence("least_squares.refused_values", cause=error))
    if not np.isfinite(end.cost):
        return replace(failed, evaluations=end.evaluations)
    return SolverResult(
        x=end.x,
        cost=end.cost,
        status=SolverStatus(min(end.status, SolverStatus.CONVERGED)),  # Convergence is told by 1 to 4.
        message=sentence(_ENDINGS[end.status]) if end.status in _ENDINGS else end.message,
        evaluations=end.evaluations,
        history=np.array([end.cost]),
    )


class _End(NamedTuple):
    x: FloatArray
    cost: float  # Chi squared.
    status: int  # As in scipy.optimize, see ``_ENDINGS``.
    evaluations: int
    message: str = ""


def _end(problem: Problem, most: int) -> _End:
    """Minimise by SciPy's trust region where residuals are fewer than coordinates, else by Marquardt's method."""
    residual = problem.residuals(problem.start)
    if len(residual) >= len(problem.start):
        return _marquardt(problem, residual, most)
    end = _trust_region(problem, most)
    return end._replace(evaluations=end.evaluations + 1)


def _trust_region(problem: Problem, most: int) -> _End:
    import scipy.optimize  # here, because it takes longer to load than the fit to run

    try:
        fit = scipy.optimize.least_squares(
            problem.residuals,
            problem.start,
            jac=problem.jacobian,
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
            max_nfev=most,
        )
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from error
    cost = float(np.sum(np.asarray(fit.fun) ** 2))
    return _End(fit.x, cost, int(fit.status), int(fit.nfev) + int(fit.njev or 0), str(fit.message))


def _marquardt(problem: Problem, residual: FloatArray, most: int) -> _End:
    """Minimise from the start, whose residuals are given."""
    x = problem.start
    jacobian = problem.jacobian(x)
    size, damping, evaluations = np.zeros(len(x)), 0.0, 2
    while True:
        norms = np.linalg.norm(jacobian, axis=0)
        # Coordinates differ by many powers of ten; a column that vanishes once must not send its coordinate away.
        size = np.maximum(size, norms)
        unit = np.where(size > 0, size, 1.0)
        cost = float(residual @ residual)
        slope = np.abs(jacobian.T @ residual)
        if np.all(slope <= _TOLERANCE * norms * np.sqrt(cost)):
            return _End(x, cost, 1, evaluations)
        directions, length = _directions(residual, jacobian / unit), np.linalg.norm(unit * x)
        while True:
            if evaluations >= most:
                return _End(x, cost, 0, evaluations)
            step, foretold = _damped_step(directions, cost, damping)
            trial = x + step / unit
            residual_there = problem.residuals(trial)
            evaluations += 1
            gain = 1 - float(residual_there @ residual_there) / cost
            gain = gain if math.isfinite(gain) else -1.0
            # What is foretold to gain nothing can lose by rounding: residuals are small beside what they are made of.
            has_settled = gain <= _TOLERANCE and foretold <= _TOLERANCE
            stands = bool(np.linalg.norm(step) <= _TOLERANCE * length)
            is_better = gain > _LEAST_GAIN * foretold
            if gain < _POOR * foretold:
                damping = max(_MORE * damping, _FIRST_DAMPING)
            elif gain > _GOOD * foretold:
                damping = damping / _LESS if damping > _FIRST_DAMPING else 0.0
            if is_better:
                x, residual = trial, residual_there
            if has_settled or stands:
                return _End(x, float(residual @ residual), 1 + has_settled + 2 * stands, evaluations)
            if is_better:
                break
        jacobian = problem.jacobian(x)
        evaluations += 1


class _Directions(NamedTuple):
    """The singular values of a Jacobian that are not lost in rounding, k of them, and the residuals along them."""

    sigma: FloatArray  # Shape (k,).
    v: FloatArray  # Shape (k, n).
    along: FloatArray  # Shape (k,).


def _directions(residual: FloatArray, jacobian: FloatArray) -> _Directions:
    u, sigma, v = np.linalg.svd(jacobian, full_matrices=False)
    known = sigma > sigma[0] * len(residual) * np.finfo(float).eps
    return _Directions(sigma[known], v[known], (u.T @ residual)[known])


def _damped_step(directions: _Directions, cost: float, damping: float) -> tuple[FloatArray, float]:
    """Return the step in units of the columns, and the share of the cost by which it should fall."""
    s, v, along = directions
    damped = along / (s**2 + damping)
    step, left = -(s * damped) @ v, damping * damped
    return step, float((along @ along - left @ left) / cost)
