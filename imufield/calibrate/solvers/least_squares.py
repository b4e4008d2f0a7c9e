"""Least squares: Levenberg-Marquardt on the analytic Jacobian, or a trust region where the loss is robust.

Bounds say where a swarm looks, and a start outside them is a mistake for every method; they do not hold the minimum, which
here is wherever the residuals are least.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from imufield.calibrate.solvers.base import Callback, Problem, SolverResult, SolverStatus
from imufield.calibrate.solvers.population import check_start
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

Loss = Literal["linear", "soft_l1", "huber", "cauchy"]

# Relative change of cost and coordinates at which it stops: a few ulp above what double precision can resolve.
_TOLERANCE = 1e-14
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
    callback: Callback | None = None,
    loss: Loss = "linear",
    max_evaluations: int = 200,
) -> SolverResult:
    """Minimise the sum of squared residuals from the problem's start.

    Parameters
    ----------
    problem : Problem
    rng : Generator, optional
        Not used: the method is deterministic.
    callback : callable, optional
        Told the end result once.
    loss : {"linear", "soft_l1", "huber", "cauchy"}
        As scipy.optimize.least_squares has them, on residuals in units of sigma.
    max_evaluations : int

    Returns
    -------
    SolverResult
        ``cost`` is the plain sum of squared residuals (chi squared), whatever the loss.

    Raises
    ------
    CalibrationError
        If the start is outside the bounds, or not finite.
    """
    import scipy.optimize  # here, because it takes longer to load than the fit to run

    check_start(problem)
    start = problem.start
    # MINPACK takes neither a robust loss nor fewer residuals than coordinates.
    plain = loss == "linear" and len(problem.residuals(start)) >= len(start)
    left_domain = sentence("least_squares.left_domain")
    failed = SolverResult(x=start, cost=np.inf, status=SolverStatus.FAILED, message=left_domain, evaluations=0)
    try:
        fit = scipy.optimize.least_squares(
            problem.residuals,
            start,
            jac=problem.jacobian,
            method="lm" if plain else "trf",
            loss=loss,
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
            max_nfev=max_evaluations,
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        # A candidate outside the model's domain has NaN residuals; scipy and LAPACK refuse those.
        return replace(failed, message=sentence("least_squares.refused_values", cause=error))
    x: FloatArray = fit.x
    cost = float(np.sum(problem.residuals(x) ** 2))
    if not np.isfinite(cost):
        return replace(failed, evaluations=int(fit.nfev))
    if callback is not None:
        callback(int(fit.nfev), x, cost)
    return SolverResult(
        x=x,
        cost=cost,
        status=SolverStatus(min(int(fit.status), SolverStatus.CONVERGED)),  # scipy tells convergence by 1 to 4
        message=sentence(_ENDINGS[int(fit.status)]) if fit.status in _ENDINGS else str(fit.message),
        evaluations=int(fit.nfev) + int(fit.njev or 0),
        history=np.array([cost]),
    )
