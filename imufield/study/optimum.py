"""References that solvers are compared with: exact minima, global optima and the Cramér-Rao bound.

The minimum of eq. 13 of [1]_ is a linear programme once ``norm(a)`` is linear in the coordinates,

    minimise sum t_i   subject to   -t <= r + A z <= t,

and a few rounds of linearising give the minimum of the cost itself. Residuals are divided by their size first: HiGHS has
absolute tolerances of 1e-7, far above a residual of 3e-8 m/s^2.

The Cramér-Rao bound of the gauge-free numbers (``gauge.intrinsic``) for normal noise of sigma ``s`` in every norm is
``s^2 I B (A^T A)^-1 B^T I^T`` with ``A`` the Jacobian in coordinates, ``B`` their basis and ``I`` the derivative of the
gauge-free numbers.

References
----------
.. [1] P. Wang et al., "In-Field Calibration of Triaxial Accelerometer Based on Beetle Swarm Antenna Search Algorithm",
   Sensors, 2020.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from imufield.calibrate.accelerometer.swarm_coordinates import observable_basis
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import norm_derivatives
from imufield.calibrate.model.observability import generators
from imufield.calibrate.model.result import ANGLES, QuadraticAxes, names_of
from imufield.calibrate.solvers.base import Problem, Solver, SolverResult
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.dataclass import dataclass
from imufield.samples import AXES, FloatArray

INTRINSIC_NAMES = names_of("{} {}", scale=AXES, bias=AXES, angle=ANGLES, K2=AXES)
_ROUNDS = 4  # Of linearising: the norm is nearly linear over the errors of a preset.


def exact_absolute_minimum(problem: NormProblem) -> tuple[float, FloatArray]:
    """Return the exact minimum of eq. 13 and the coordinates where it is."""
    z = problem.start
    for _ in range(_ROUNDS):
        derivatives = norm_derivatives(problem.vector(z), problem.raw, problem.quadratic_axes)
        residual = derivatives.norm - problem.gravity_m_s2
        z = z + _absolute_step(residual, derivatives.jacobian @ problem.basis)
    return float(problem.cost(z[None])[0]), z


def _absolute_step(residual: FloatArray, A: FloatArray) -> FloatArray:
    """Return the step that minimises sum |r + A z|."""
    from scipy.optimize import linprog  # slow to load, and only a study needs it

    m, n = A.shape
    # Near the end the residuals that matter are the small ones.
    size = float(np.median(np.abs(residual))) or 1.0
    # Unknowns are the n entries of z and the m bounds t of the absolute residuals; only the bounds cost anything.
    eye = np.eye(m)
    solved = linprog(
        np.concatenate([np.zeros(n), np.ones(m)]),
        A_ub=np.block([[A / size, -eye], [-A / size, -eye]]),
        b_ub=np.concatenate([-residual, residual]) / size,
        bounds=[(None, None)] * n + [(0, None)] * m,
        method="highs",
    )
    return np.zeros(n) if solved.x is None else np.asarray(solved.x[:n], dtype=np.float64)


def squares_optimum(problem: Problem) -> tuple[float, FloatArray]:
    """Return the minimum of a root-sum-of-squares cost within the bounds and where it is, from their middle."""
    from scipy.optimize import least_squares  # slow to load, and only a study needs it

    x = solve_least_squares(problem).x
    lower, upper = problem.bounds
    if not np.all((lower <= x) & (x <= upper)):
        tolerance = 1e-14
        bounded = least_squares(
            problem.residuals,
            problem.start,
            jac=cast("Any", problem.jacobian),  # pyright's stubs of scipy know strings only
            bounds=problem.bounds,
            # Half the bounds is the size of a coordinate; an entry with equal bounds must not scale by zero.
            x_scale=np.maximum((upper - lower) / 2, 1e-12),
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            max_nfev=2000,
        )
        x = np.asarray(bounded.x, dtype=np.float64)
    return float(problem.cost(x[None])[0]), x


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """What a solver found, and the optimum of the same data."""

    found: SolverResult
    optimum: float


def compare(solver: Solver, problem: Problem, rng: np.random.Generator) -> ComparedRun:
    """Solve a problem whose cost is a root of a sum of squares."""
    optimum, _ = squares_optimum(problem)
    return ComparedRun(solver(problem, rng=rng), optimum)


def cramer_rao_bound(
    truth: FloatArray,
    raw: FloatArray,
    gravity_m_s2: float,
    sigma_m_s2: float,
    *,
    quadratic_axes: QuadraticAxes,
    turn_sigma_rad: float = 0.0,
) -> FloatArray:
    """Return the least standard deviation of the 12 gauge-free numbers, shape (12,).

    Parameters
    ----------
    truth : ndarray, shape (15,)
    raw : ndarray, shape (m, 3)
    gravity_m_s2 : float
    sigma_m_s2 : float
        Of every norm.
    quadratic_axes : {"sensing", "body"}
    turn_sigma_rad : float
        1 sigma, per axis, of what is not known of the body frame. It matters on body axes only, where a turn is not quite
        invisible; 0 is the plain bound of a known frame, other values give the Bayesian bound.
    """
    basis = observable_basis(truth, raw, gravity_m_s2, quadratic_axes)
    prior = np.zeros((basis.shape[1], basis.shape[1]))
    if turn_sigma_rad > 0:
        basis = np.hstack([basis, generators(truth) * turn_sigma_rad])
        prior = np.diag(np.concatenate([np.zeros(len(prior)), np.ones(3)]))
    A = norm_derivatives(truth, raw, quadratic_axes).jacobian @ basis
    gauge_free = intrinsic(truth, quadratic_axes)[1] @ basis
    # Information A^T A / s^2; a known spread of the turns adds its own to it (Bayesian bound).
    covariance = gauge_free @ np.linalg.inv(A.T @ A / sigma_m_s2**2 + prior) @ gauge_free.T
    return np.asarray(np.sqrt(np.diag(covariance)))
