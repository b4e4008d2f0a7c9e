"""One least-squares fit of one model in the lower gauge, with weights from the data themselves.

Residual and Jacobian are those of ``solvers.norm_problem``, by ``model.models``; ``solvers.least_squares`` finds the minimum,
and weights are those of ``model.uncertainty``.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.calibrate.model.higher_terms import HigherTerms
from imufield.calibrate.model.observability import parameter_scale
from imufield.calibrate.model.result import QuadraticAxes, SolverSummary
from imufield.calibrate.model.uncertainty import SPARE_POSITIONS, between_position_sigma, within_variance
from imufield.calibrate.solvers.base import SolverResult
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.dataclass import dataclass, replace
from imufield.samples import FloatArray

_REWEIGHTINGS = 4  # At most; where tau has not settled by then, the last weights count.
_SETTLED = 1e-3  # Relative change of tau at which weights count as settled: it moves parameters by far less than their sigma.


@dataclass(frozen=True, slots=True, kw_only=True)
class FitData:
    """What every fit of one calibration shares."""

    raw: FloatArray
    """Zeroed mean outputs, shape (m, 3)."""
    covariance_raw: FloatArray | None
    """Shape (m, 3, 3); None where it is not known."""
    gravity_m_s2: float
    quadratic_axes: QuadraticAxes
    least_scatter_m_s2: float = 0.0
    """Typical scatter between positions, taken where there are too few to show it."""
    typical_quadratic_m_s2: float = math.inf
    """Typical quadratic term at 1 g, 1 sigma, for one that is not admitted; infinite where nothing says it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A fitted model: ``vector = origin + basis z``."""

    vector: FloatArray
    basis: FloatArray
    """Shape (15, n); zero for the coordinates of drift or higher terms, which are the last ones."""
    drift_m_s2: FloatArray
    """Bias at each position less ``vector``'s, which is their mean, shape (m, 3)."""
    higher: HigherTerms | None
    residual_m_s2: FloatArray
    """norm(a) - g, shape (m,)."""
    jacobian: FloatArray
    """d residual / d z, shape (m, n)."""
    sigma_m_s2: FloatArray
    """s_i, shape (m,)."""
    tau_m_s2: float
    has_typical_scatter: bool
    """Whether tau is not from the residuals."""
    solved: SolverResult

    @property
    def drift_span_m_s2(self) -> float:
        """How far the bias of an axis moved over the positions, at most."""
        return float(np.ptp(self.drift_m_s2, axis=0).max())

    @property
    def degrees_of_freedom(self) -> int:
        """Positions less fitted parameters."""
        positions, parameters = self.jacobian.shape
        return int(positions - parameters)

    @property
    def effective_degrees_of_freedom(self) -> float:
        """Degrees of freedom of the sigmas; 0 where no residual is to spare, infinite where the scatter is a typical one.

        Only tau is estimated from the few residuals; the noise within a hold is known from thousands of samples. Welch and
        Satterthwaite's rule for such a sum, with tau^2 one standard error of a variance larger: a zero from few residuals
        does not show that there is none.
        """
        if self.has_typical_scatter:
            return math.inf
        if self.degrees_of_freedom < 1:
            return 0.0
        found = np.mean(self.tau_m_s2**2 / self.sigma_m_s2**2)
        share = min(1.0, float(found) + np.sqrt(2 / self.degrees_of_freedom))
        return float(self.degrees_of_freedom / share**2)


def summarise(solved: SolverResult, method: str, seed: int | None) -> SolverSummary:
    """Return what a calibration tells of its solver."""
    return SolverSummary(
        method=method,
        status=int(solved.status),
        message=solved.message,
        cost=solved.cost,
        evaluations=solved.evaluations,
        seed=seed,
    )


def column_basis(vector: FloatArray, free: tuple[int, ...], gravity_m_s2: float) -> FloatArray:
    """Return the basis that frees some of the 15 parameters, scaled to m/s^2 at 1 g, shape (15, n)."""
    return np.diag(parameter_scale(vector, gravity_m_s2))[:, list(free)]


def fit(
    data: FitData, origin: FloatArray, basis: FloatArray, *, drift: FloatArray | None = None, higher: FloatArray | None = None
) -> Fit:
    """Fit ``origin + basis z``: first unweighted, then with s_i^2 = within^2 + tau^2 until tau settles.

    Parameters
    ----------
    data : FitData
    origin : ndarray, shape (15,)
    basis : ndarray, shape (15, n)
    drift : ndarray, shape (m, k), optional
        Forms of a drift of the bias, each fitted to the three axes; of mean zero, so that the bias is its mean.
    higher : ndarray, shape (12, k), optional
        Combinations of higher terms; not with a drift.
    """
    problem = _problem(data, origin, basis, drift, higher)
    # Unweighted first: within needs parameters to carry raw covariances to the norm.
    solved = solve_least_squares(problem)
    current = _evaluate(data, problem, solved)
    evaluations = solved.evaluations
    for _ in range(_REWEIGHTINGS if data.covariance_raw is not None else 0):
        problem = replace(problem, origin=current.vector, sigma_m_s2=current.sigma_m_s2)
        solved = solve_least_squares(problem)
        evaluations += solved.evaluations
        before, current = current, _evaluate(data, problem, solved)
        if abs(current.tau_m_s2 - before.tau_m_s2) <= _SETTLED * before.tau_m_s2:
            break
    chi_squared = float(np.sum((current.residual_m_s2 / current.sigma_m_s2) ** 2))
    return replace(current, solved=replace(solved, evaluations=evaluations, cost=chi_squared))


def fit_beside(data: FitData, fitted: Fit, basis: FloatArray, drift: FloatArray | None) -> Fit:
    """Return the fit with more terms that one step from a fit without them leads to, exact where they are small beside 1 g."""
    problem = _problem(data, fitted.vector, basis, drift)
    sigma = fitted.sigma_m_s2
    jacobian = problem.derivatives(np.zeros(problem.basis.shape[1]))[1]
    step = np.linalg.lstsq(jacobian / sigma[:, None], -fitted.residual_m_s2 / sigma, rcond=None)[0]
    return _evaluate(data, problem, replace(fitted.solved, x=step.astype(np.float64)))


def _problem(
    data: FitData, origin: FloatArray, basis: FloatArray, drift: FloatArray | None, higher: FloatArray | None = None
) -> NormProblem:
    extra = (0 if drift is None else 3 * drift.shape[1]) + (0 if higher is None else higher.shape[1])
    return NormProblem(
        raw=data.raw,
        gravity_m_s2=data.gravity_m_s2,
        sigma_m_s2=np.ones(len(data.raw)),
        origin=origin,
        basis=np.hstack([basis, np.zeros((len(basis), extra))]),
        quadratic_axes=data.quadratic_axes,
        drift=drift,
        higher=higher,
    )


def _evaluate(data: FitData, problem: NormProblem, solved: SolverResult) -> Fit:
    derivatives, jacobian = problem.derivatives(solved.x)
    residual = derivatives.norm - data.gravity_m_s2
    within = within_variance(derivatives.raw_gradient, data.covariance_raw)
    tau = between_position_sigma(residual, jacobian, within)
    is_typical = len(residual) - jacobian.shape[1] < SPARE_POSITIONS and tau < data.least_scatter_m_s2
    if is_typical:
        tau = data.least_scatter_m_s2
    sigma = np.sqrt(within + tau**2)
    # Without covariances and without redundancy nothing says how sure a position is; equal weights then.
    sigma = np.where(sigma > 0, sigma, 1.0)
    return Fit(
        vector=problem.vector(solved.x),
        basis=problem.basis,
        drift_m_s2=problem.bias_drift(solved.x),
        higher=problem.higher_terms(solved.x),
        residual_m_s2=residual,
        jacobian=jacobian,
        sigma_m_s2=sigma,
        tau_m_s2=tau,
        has_typical_scatter=is_typical,
        solved=solved,
    )
