"""Other methods than least squares for a calibration, and their agreement as proof.

The model, the gauge, the weights and the uncertainties are those of ``calibrate_accelerometer``; a method only looks for the
parameters again, from its own start (the preset, or the outputs' extremes without one), in whitened coordinates, and minimises
the cost of its paper.

Sigma is that of the fit alone. Uncertainty of gravity is common to all methods and must not hide a disagreement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imufield.calibrate.accelerometer.fit import FitData, summarise
from imufield.calibrate.accelerometer.model_choice import find_origin
from imufield.calibrate.accelerometer.swarm_coordinates import whitened_problem
from imufield.calibrate.model.gauge import change_gauge, intrinsic, make_intrinsic
from imufield.calibrate.model.models import (
    BIAS,
    MISALIGNMENT,
    PARAMETERS,
    QUADRATIC,
    SCALE,
    from_vector,
    norm_derivatives,
    to_vector,
    without_higher,
)
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import ANGLES, AccelerometerParameters, Calibration, names_of, without_drift
from imufield.calibrate.model.uncertainty import known_covariance, rms, within_variance
from imufield.calibrate.solvers.agreement import CROSS_CHECKED, LEAST_SQUARES, Attempt, CrossCheck, compare
from imufield.calibrate.solvers.least_squares import solve_least_squares
from imufield.calibrate.solvers.norm_problem import CostName, NormProblem
from imufield.calibrate.solvers.registry import find_method, load_solver
from imufield.dataclass import dataclass, replace
from imufield.samples import AXES, FloatArray, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

GAUGE_FREE_NAMES = names_of("intrinsic.{}.{}", scale=AXES, bias_raw=AXES, angle_rad=ANGLES, quadratic=AXES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Restart:
    """A calibration's problem, ready to be solved again by any method."""

    calibration: Calibration
    problem: NormProblem
    """In whitened coordinates, from a start that knows nothing of the calibration; weighted cost."""
    vector: FloatArray
    """The calibration's parameters, shape (15,)."""
    preset: FloatArray | None
    free: tuple[int, ...]
    """Parameters that may move."""

    def in_gauge(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return parameters that were found, and the basis of the coordinates, in the calibration's gauge."""
        change = change_gauge(vector, self.calibration.gauge, self.preset)
        return change.vector, change.jacobian @ self.problem.basis

    def gauge_free_sigma(self) -> FloatArray:
        """Return 1 sigma of the 12 gauge-free numbers from the fit alone, shape (12,); 0 where a number is not fitted."""
        at_fit = norm_derivatives(self.vector, self.problem.raw, self.problem.quadratic_axes)
        change = change_gauge(self.problem.origin, self.calibration.gauge, self.preset)
        basis = change.jacobian @ self.problem.basis
        # Covariance of the fit alone, (A^T A)^-1, carried to the gauge-free numbers.
        A = (at_fit.jacobian @ basis) / self.problem.sigma_m_s2[:, None]
        J = intrinsic(self.vector, self.problem.quadratic_axes)[1] @ basis
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", J, np.linalg.inv(A.T @ A), J)))


def restart(observations: Observations, calibration: Calibration, preset: AccelerometerParameters | None = None) -> Restart:
    """Return the problem behind a calibration, to be solved again.

    Parameters
    ----------
    observations : Observations
        The ones it was calibrated from.
    calibration : Calibration
    preset : AccelerometerParameters, optional
        The preset it was given; the start where there is one.

    Raises
    ------
    CalibrationError
        If the preset is in another unit, or the positions do not show what is to be fitted.
    """
    used, fits_quadratic = calibration.accelerometer, calibration.quadratic_fitted
    vector, before = to_vector(used), None if preset is None else to_vector(preset)
    gravity = calibration.gravity.gravity_m_s2
    # The drift and the higher terms that were found are taken out: the other methods look for the parameters alone.
    raw = without_higher(used, without_drift(observations, calibration).mean_raw) - used.raw_zero
    data = FitData(raw=raw, covariance_raw=None, gravity_m_s2=gravity, quadratic_axes=used.quadratic_axes)
    origin, observability = find_origin(data, np.sign(used.scale), before, "auto" if fits_quadratic else "linear")
    free = tuple(k for k in observability.free if k < QUADRATIC.start or fits_quadratic)
    if sum(MISALIGNMENT.start <= k < MISALIGNMENT.stop for k in free) == 3:
        # All misalignments move, less the three turns of the frame: the start's frame is kept.
        free = tuple(sorted({*free, *range(MISALIGNMENT.start, MISALIGNMENT.stop)}))
    if before is not None:
        start = before.copy()
    else:
        # Scale and bias from the extremes of the outputs.
        start = origin.copy()
        half, middle = np.ptp(raw, axis=0) / 2, (raw.max(axis=0) + raw.min(axis=0)) / 2
        start[SCALE] = np.sign(vector[SCALE]) * half / gravity
        start[BIAS] = middle / start[SCALE]
        start[MISALIGNMENT] = 0.0
    if not fits_quadratic:
        start[QUADRATIC] = vector[QUADRATIC]
    # s_i of every position, as the calibration weighted them.
    gradient = norm_derivatives(vector, raw, used.quadratic_axes).raw_gradient
    within = within_variance(gradient, known_covariance(observations.covariance_raw))
    sigma = np.sqrt(within + calibration.quality.between_position_sigma_m_s2**2)
    problem = whitened_problem(
        start,
        raw,
        gravity,
        quadratic_axes=used.quadratic_axes,
        cost_name="weighted",
        sigma_m_s2=np.where(sigma > 0, sigma, 1.0),
        free=free,
    )
    return Restart(calibration=calibration, problem=problem, vector=vector, preset=before, free=free)


def solve_with(
    method: str,
    observations: Observations,
    calibration: Calibration,
    *,
    rng: np.random.Generator,
    preset: AccelerometerParameters | None = None,
    polish: bool = True,
    settings: Mapping[str, str] | None = None,
    seed: int | None = None,
) -> Calibration:
    """Return the calibration with parameters found by another method.

    Parameters
    ----------
    method : str
        A name of ``solvers.registry.METHODS``.
    observations : Observations
    calibration : Calibration
        From ``calibrate_accelerometer``: model, gauge, weights and uncertainties.
    rng : Generator
    preset : AccelerometerParameters, optional
        The one ``calibration`` was given.
    polish : bool
        Finish by least squares.
    settings : mapping of str, optional
        Of the method, as ``load_solver`` takes them.
    seed : int, optional
        Written to the result.

    Returns
    -------
    Calibration
        Where the method did not converge, ``solver.status`` says so, the verdict is "poor" and its first reason tells why.

    Raises
    ------
    UsageError
        If there is no such method.
    CalibrationError
        If the method cannot start.
    """
    if find_method(method).name == LEAST_SQUARES:
        return calibration
    again = restart(observations, calibration, preset)
    problem = problem_for(again, method)
    found = load_solver(method, settings)(problem, rng=rng)
    vector, basis = again.in_gauge(problem.vector(found.x))
    if polish and found.converged:
        problem = replace(again.problem, origin=vector, basis=basis)
        found = solve_least_squares(problem).as_polish_of(found)
        vector = problem.vector(found.x)
    axes, old, used = problem.quadratic_axes, calibration.intrinsic, calibration.accelerometer
    residual = norm_derivatives(vector, problem.raw, axes).norm - calibration.gravity.gravity_m_s2
    quality = replace(
        calibration.quality,
        residual_rms_m_s2=rms(residual),
        residual_max_m_s2=float(np.abs(residual).max()),
    )
    if not found.converged:
        quality = quality.lowered("poor", sentence("methods.not_converged", method=method, message=found.message))
    return replace(
        calibration,
        accelerometer=replace(from_vector(vector, used.raw_zero, axes), higher=used.higher),
        intrinsic=make_intrinsic(intrinsic(vector, axes)[0], old.sigmas),
        positions=replace(calibration.positions, residual_m_s2=residual),
        solver=summarise(found, method, seed),
        quality=quality,
    )


def problem_for(again: Restart, method: str) -> NormProblem:
    """Return the problem with the cost, and for the staged form the coordinates, that the method's paper uses."""
    problem = replace(again.problem, cost_name=find_method(method).cost_name)
    if method != "bsas-staged":
        return problem
    # The paper's own coordinates: the parameters themselves, in their own units.
    return replace(problem, basis=np.eye(PARAMETERS)[:, list(again.free)], reach=np.inf)


def cross_check(
    observations: Observations,
    calibration: Calibration,
    *,
    rng: np.random.Generator,
    preset: AccelerometerParameters | None = None,
    methods: Sequence[str] = CROSS_CHECKED,
) -> CrossCheck:
    """Solve with several methods from a start of their own and compare in units of sigma.

    Parameters
    ----------
    observations : Observations
    calibration : Calibration
        From ``calibrate_accelerometer``.
    rng : Generator
    preset : AccelerometerParameters, optional
    methods : sequence of str

    Raises
    ------
    UsageError
        If there is no such method.
    CalibrationError
        If a method cannot start.
    """
    again = restart(observations, calibration, preset)

    def attempt(method: str, cost_name: CostName) -> Attempt:
        problem = replace(problem_for(again, method), cost_name=cost_name)
        if method != LEAST_SQUARES:
            # Relative to their median: a swarm's costs should be near those of its paper, in m/s^2.
            problem = replace(problem, sigma_m_s2=problem.sigma_m_s2 / median(problem.sigma_m_s2))
        found = load_solver(method)(problem, rng=rng)
        numbers = intrinsic(again.in_gauge(problem.vector(found.x))[0], problem.quadratic_axes)[0]
        return numbers, "" if found.converged else found.message

    return compare("accelerometer", attempt, GAUGE_FREE_NAMES, again.gauge_free_sigma(), methods=methods)
