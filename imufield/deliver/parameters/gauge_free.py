"""The numbers of a calibration that no choice of the body frame changes, with 1 sigma: what may be compared over time.

The accelerometer's are those of ``[accelerometer.intrinsic]``. The gyroscope's are taken against the accelerometer's own axes:
both triads are turned together so that the sensing x axis is the body's and the sensing y axis lies in its xy plane (gauge
"lower"). That frame is found from parameters that are uncertain themselves, so sigma is that of the whole function, ``J C J^T``
with the joint covariance C; it is smooth and nearly linear.

The numbers of one calibration are correlated: for a known gravity their covariance is ``J (C - c c^T / C_gg) J^T``, with c the
column of gravity in C. Much of that is the same in every session of an instrument, so that it is no reason for two of them to
differ: what a term that was not fitted may hide, a prior. What differs is the covariance of the fit alone, rebuilt from the
positions: ``(r^T W r / n) (A^T W A)^-1`` with A the Jacobian of the norms, that of a fitted drift with it, W their weights, r
the residuals and n their degrees of freedom. Scaled by its own residuals it is Student's with n; a sigma that may not fall
below the noise of a hold would be right on the average only. Where a quadratic term or a drift was fitted, the numbers of the
linear model are told, too: sessions of which only one has such a term are compared in that.

The way back, into the gauge "lower": there the unit sensing axes u_i are lower triangular, and follow from the cosines between
them, with c = -sin(angle)

    u_x = (1, 0, 0),    u_y = (c_xy, sqrt(1 - c_xy^2), 0),    u_z = (c_xz, (c_yz - c_xz c_xy) / u_yy, rest)

T_i = u_i / u_ii, and scale, bias and quadratic term are those along u_i with the powers of u_ii that T leaves to them. The
gyroscope's numbers are its parameters in that gauge, divided by its scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.accelerometer.fit import column_basis
from imufield.calibrate.model.coverage_factors import degrees_of_freedom
from imufield.calibrate.model.gauge import GaugeChange, change_gauge, intrinsic, turn_gyroscope
from imufield.calibrate.model.models import PARAMETERS, QUADRATIC, to_vector
from imufield.calibrate.model.observability import LOWER_GAUGE_COLUMNS
from imufield.calibrate.model.result import (
    ACCELEROMETER_NAMES,
    ANGLES,
    GRAVITY_NAME,
    GYROSCOPE_NAMES,
    MISALIGNMENTS,
    PAIRS,
    Calibration,
    GyroscopeParameters,
    QuadraticAxes,
    names_of,
)
from imufield.calibrate.model.rotation import skew
from imufield.calibrate.model.uncertainty import without_gravity
from imufield.calibrate.sessions.kinds import PPM, SCALES, kind_of
from imufield.calibrate.solvers.norm_problem import NormProblem
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MICRO_G_M_S2, MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.samples import AXES, FloatArray

NAMES = (
    *names_of("{} {}", scale=AXES, bias=AXES, angle=ANGLES, quadratic=AXES),
    *names_of("gyroscope {} {}", bias=AXES, scale=AXES, misalignment=MISALIGNMENTS),
    *(f"g-sensitivity {pair}" for pair in PAIRS),
)
"""Of every gauge-free number, in the order of ``si_values``."""
UNITS = {
    "bias": ("mg", MILLI_G_M_S2),
    "scale": ("ppm", PPM),
    "angle": ("mrad", 1e-3),
    "quadratic": ("ug/g^2", MICRO_G_M_S2 / STANDARD_GRAVITY_M_S2**2),
    "gyroscope bias": ("deg/h", DEG_PER_HOUR_RAD_S),
    "gyroscope scale": ("ppm", PPM),
    "gyroscope misalignment": ("mrad", 1e-3),
    "g-sensitivity": ("deg/h/g", DEG_PER_HOUR_RAD_S / STANDARD_GRAVITY_M_S2),
}
"""Of a kind of numbers in an adjustment: its unit for people and that unit in SI, of scales relative."""
_GYROSCOPE = 12  # Where the numbers of the gyroscope begin.
_ACCELEROMETER_NAMES = frozenset(NAMES[:_GYROSCOPE])
_LINEAR_NAMES = frozenset(NAMES[:9])  # Those that the linear model has.
_ROUNDING = 1e-9  # Of a drift: what of three axes is smaller than the largest by this is no form of it.
_TINY = np.finfo(np.float64).tiny
# Of the whole over its part: what choosing counts are other residuals, with a third of the variance at least.
_LEAST_RATIO = 0.3
FIXED_NAMES = names_of("accelerometer.{}.{}", misalignment_rad=ANGLES)
"""Zero in the lower gauge."""
PARAMETER_NAMES = (*ACCELEROMETER_NAMES, *GYROSCOPE_NAMES)
"""Of what ``lower_parameters`` returns, as covariances name them."""
_STEP = 1e-6  # Of differences, relative to the size of a number; the function is smooth, and angles are small beside 1.


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """One gauge-free number of a calibration."""

    name: str
    unit: str
    value: float
    sigma: float
    common: float = 0.0
    """Part of sigma that comes from gravity."""
    freedom: float = math.inf
    """Degrees of freedom of sigma; 0 where nothing was to spare to find it from."""
    scatter_freedom: float = math.inf
    """Those of the part that another session draws anew."""

    @property
    def is_scale(self) -> bool:
        """Whether an adjustment takes it in ppm of itself."""
        return kind_of(self.name) in SCALES

    @property
    def adjusted_size(self) -> float:
        """Size of the unit that an adjustment takes it in, with the sign of a scale."""
        return PPM * self.value if self.is_scale else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearFit:
    """What the linear model makes of the accelerometer's k numbers where a quadratic term or a drift was fitted."""

    change: FloatArray
    """Of the numbers, shape (k,)."""
    scatter: FloatArray
    """Their covariance by that fit alone, shape (k, k)."""
    freedom: float


@dataclass(frozen=True, slots=True)
class GaugeFree:
    """The gauge-free numbers of a calibration, n of them."""

    numbers: tuple[Number, ...]
    error: FloatArray
    """Covariance of their errors for a known gravity, in their units, shape (n, n)."""
    scatter: FloatArray
    """The part of it that another session with the same positions and model draws anew, shape (n, n)."""
    linear: LinearFit | None = None
    """None where the model is linear, or its residuals do not tell."""

    def in_linear_model(self) -> GaugeFree:
        """Return the numbers that the linear model makes of the session; those of its own model where they are the same."""
        if self.linear is None:
            return self
        kept = [k for k, number in enumerate(self.numbers) if kind_of(number.name) != "quadratic"]
        numbers = [self.numbers[k] for k in kept]
        own = linear_places(numbers)
        change = np.zeros(len(kept))
        change[own] = self.linear.change
        for place in own:
            value = numbers[place].value + float(change[place])
            numbers[place] = replace(numbers[place], value=value, scatter_freedom=self.linear.freedom)
        error, scatter = (part[np.ix_(kept, kept)] for part in (self.error, self.scatter))
        # The gyroscope's numbers depend on the frame of the other fit.
        scatter[own] = scatter[:, own] = 0.0
        scatter[np.ix_(own, own)] = self.linear.scatter
        # A term that is there and is not fitted moves the numbers by as much.
        return GaugeFree(tuple(numbers), error + np.outer(change, change), scatter)

    def against(self, reference: Mapping[str, Number], rows: Sequence[int]) -> GaugeFree:
        """Return some of the numbers as an adjustment takes them: scales as their deviation from those of a reference."""
        numbers = [self.numbers[row] for row in rows]
        origins = [reference.get(number.name, number) for number in numbers]
        sizes = np.array([origin.adjusted_size for origin in origins])
        adjusted = (
            replace(
                number,
                unit=unit_of(number.name),
                value=(number.value - origin.value * origin.is_scale) / origin.adjusted_size,
                sigma=number.sigma / abs(origin.adjusted_size),
                common=number.common / abs(origin.adjusted_size),
            )
            for number, origin in zip(numbers, origins, strict=True)
        )
        error, scatter = (part[np.ix_(rows, rows)] / np.outer(sizes, sizes) for part in (self.error, self.scatter))
        return GaugeFree(tuple(adjusted), error, scatter)


def linear_places(numbers: Sequence[Number]) -> list[int]:
    """Return which of the numbers are the accelerometer's in the linear model."""
    return [k for k, number in enumerate(numbers) if number.name in _LINEAR_NAMES]


def unit_of(name: str) -> str:
    """Return the unit of a number of an adjustment."""
    return UNITS[kind_of(name)][0]


def gauge_free(calibration: Calibration, mean_raw: FloatArray, sigma_raw: FloatArray) -> GaugeFree:
    """Return the gauge-free numbers of a calibration, those that were estimated, and how their errors are correlated.

    Parameters
    ----------
    calibration : Calibration
    mean_raw : ndarray, shape (m, 3)
        Of the positions it came from.
    sigma_raw : ndarray, shape (m, 3)
        1 sigma of these means, NaN where it is not known.

    Raises
    ------
    CalibrationError
        If the accelerometer's axes are left-handed or nearly in one plane.
    """
    names, C = calibration.covariance_names, calibration.covariance
    lower = change_gauge(to_vector(calibration.accelerometer), "lower")
    values = _si_values(calibration, lower.rotation)
    J = _jacobian(calibration, lower)
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, C, J), 0.0))
    numbers = (*_accelerometer(calibration), *_gyroscope(calibration, values[_GYROSCOPE:], sigma[_GYROSCOPE:]))
    error = J @ without_gravity(names, C) @ J.T
    scatter = error.copy()
    fit = _linearised_fit(calibration, lower.vector, mean_raw, sigma_raw)
    if fit is not None:
        numbers = tuple(
            replace(number, scatter_freedom=fit.freedom) if number.name in _ACCELEROMETER_NAMES else number
            for number in numbers
        )
        # A part is no larger than the whole: correlations between the axes of a mean are not in the file.
        of_fit = _scatter(fit.J, fit.A, fit.residual, fit.freedom)
        ratio = np.diag(error)[:_GYROSCOPE] / np.maximum(np.diag(of_fit), _TINY)
        size = np.sqrt(np.where(ratio < _LEAST_RATIO, ratio, 1.0))
        scatter[:_GYROSCOPE, :_GYROSCOPE] = of_fit * np.outer(size, size)
    places = [NAMES.index(number.name) for number in numbers]
    stated = np.sqrt([max(number.sigma**2 - number.common**2, 0.0) for number in numbers])
    own = np.sqrt(np.maximum(np.diag(error)[places], 0.0))
    # ``stated`` is in the unit of each number, ``own`` in SI: their ratio is that unit.
    unit = np.divide(stated, own, out=np.zeros_like(own), where=own > 0)
    error, scatter = (part[np.ix_(places, places)] * np.outer(unit, unit) for part in (error, scatter))
    # What the covariance does not hold stands by itself.
    alone = np.flatnonzero(own == 0)
    error[alone, alone] = scatter[alone, alone] = stated[alone] ** 2
    linear = None if fit is None else _without_terms(fit)
    if linear is not None:
        own_places = linear_places(numbers)
        size, rows = unit[own_places], [places[k] for k in own_places]
        of_rows = linear.scatter[np.ix_(rows, rows)] * np.outer(size, size)
        linear = LinearFit(change=linear.change[rows] * size, scatter=of_rows, freedom=linear.freedom)
    return GaugeFree(numbers, error, scatter, linear)


class _LinearisedFit(NamedTuple):
    """A fit of k coordinates to m positions: its weighted residuals are r + A step."""

    A: FloatArray
    """Shape (m, k)."""
    residual: FloatArray
    """r, shape (m,)."""
    J: FloatArray
    """d values of the accelerometer / d coordinates, shape (12, k)."""
    coordinates: FloatArray
    """Found by the fit, shape (k,)."""
    is_term: NDArray[np.bool_]
    """Whether a coordinate is of the quadratic term or of a drift, shape (k,)."""
    freedom: float


def _linearised_fit(
    calibration: Calibration, vector: FloatArray, mean_raw: FloatArray, sigma_raw: FloatArray
) -> _LinearisedFit | None:
    """Return the fit that the calibration comes from; ``vector`` is in the lower gauge.

    None where the residuals do not tell the weights, or the file does not say which parameters were fitted.
    """
    used, quality, positions = calibration.accelerometer, calibration.quality, calibration.positions
    columns = tuple(
        k
        for k in LOWER_GAUGE_COLUMNS
        if ACCELEROMETER_NAMES[k] not in calibration.unobservable and (k < QUADRATIC.start or calibration.quadratic_fitted)
    )
    rows = positions.used
    basis = column_basis(vector, columns, calibration.gravity.gravity_m_s2)
    drift = positions.bias_drift_m_s2[rows]
    # The forms of a fitted drift are what its three axes have in common.
    left, size, _ = np.linalg.svd(drift, full_matrices=False)
    forms = left[:, size > _ROUNDING * size[0]]
    problem = NormProblem(
        raw=mean_raw[rows] - used.raw_zero,
        gravity_m_s2=calibration.gravity.gravity_m_s2,
        sigma_m_s2=np.ones(len(drift)),
        origin=vector,
        basis=np.hstack([basis, np.zeros((len(vector), 3 * forms.shape[1]))]),
        quadratic_axes=used.quadratic_axes,
        drift=forms if forms.size else None,
    )
    coordinates = np.concatenate([np.zeros(len(columns)), (forms.T @ drift).ravel()])
    derivatives, jacobian = problem.derivatives(coordinates)
    within = np.sum((derivatives.raw_gradient * np.nan_to_num(sigma_raw[rows])) ** 2, axis=1)
    variance = within + quality.between_position_sigma_m_s2**2
    if jacobian.shape[1] != quality.parameters_fitted or quality.degrees_of_freedom < 1 or not np.all(variance > 0):
        return None
    return _LinearisedFit(
        A=jacobian / np.sqrt(variance)[:, None],
        residual=positions.residual_m_s2[rows] / np.sqrt(variance),
        J=_accelerometer_values(vector, used.quadratic_axes)[1] @ problem.basis,
        coordinates=coordinates + vector @ np.linalg.pinv(problem.basis).T,
        is_term=np.array([k >= len(columns) or columns[k] >= QUADRATIC.start for k in range(len(coordinates))]),
        freedom=float(quality.degrees_of_freedom),
    )


def _without_terms(fit: _LinearisedFit) -> LinearFit | None:
    """Return the same fit without quadratic term and drift, of the values in SI; None where it has neither."""
    if not fit.is_term.any():
        return None
    # Set the left-out terms to zero in the linearised fit; what bends beyond it goes with their squares.
    step, stays = np.where(fit.is_term, -fit.coordinates, 0.0), ~fit.is_term
    step[stays] = -np.linalg.lstsq(fit.A[:, stays], fit.residual + fit.A @ step, rcond=None)[0]
    freedom = fit.freedom + np.count_nonzero(fit.is_term)
    scatter = _scatter(fit.J[:, stays], fit.A[:, stays], fit.residual + fit.A @ step, freedom)
    return LinearFit(change=fit.J @ step, scatter=scatter, freedom=freedom)


def _scatter(J: FloatArray, A: FloatArray, residual: FloatArray, freedom: float) -> FloatArray:
    """Return the covariance of the values by the residuals of their fit alone, shape (12, 12)."""
    birge = float(np.sum(residual**2)) / freedom
    return np.asarray(birge * J @ np.linalg.inv(A.T @ A) @ J.T)


def _accelerometer(calibration: Calibration) -> Iterator[Number]:
    own, g = calibration.intrinsic, calibration.gravity
    K, unit = own.scale, calibration.accelerometer_raw_unit
    freedom = degrees_of_freedom(calibration.quality.student_factor_95)
    common = np.abs(K) * g.sigma_m_s2 / g.gravity_m_s2
    bias, spread = own.bias_raw / K, own.bias_raw_sigma / np.abs(K)
    size = STANDARD_GRAVITY_M_S2 / K * 1e6
    zeros = calibration.accelerometer.raw_zero
    yield from _numbers("bias", "mg", bias / MILLI_G_M_S2, spread / MILLI_G_M_S2, freedom=freedom, zeros=zeros)
    yield from _numbers("scale", f"{unit} per m/s^2", K, own.scale_sigma, freedom=freedom, common=common)
    yield from _numbers("angle", "mrad", own.angle_rad * 1e3, own.angle_sigma_rad * 1e3, freedom=freedom)
    yield from _numbers("quadratic", "ug/g^2", own.quadratic * size, own.quadratic_sigma * np.abs(size), freedom=freedom)


def _gyroscope(calibration: Calibration, values: FloatArray, sigma: FloatArray) -> Iterator[Number]:
    gyroscope = calibration.gyroscope
    if gyroscope is None or not np.isfinite(gyroscope.parameters.scale).all():
        return
    # In the order of NAMES. What is not in the covariance was not estimated.
    keys = (("bias", AXES), ("scale", AXES), ("misalignment_rad", MISALIGNMENTS), ("g_sensitivity", PAIRS))
    own = [f"gyroscope.{key}.{place}" in calibration.covariance_names for key, places in keys for place in places]
    sigma = np.where(own, sigma, np.nan)
    # A bias depends on the scatter between the stills, and everything else on their biases.
    freedom = float(np.count_nonzero(calibration.positions.used) - 1)
    units = UNITS | {"gyroscope scale": (f"{gyroscope.raw_unit} per rad/s", 1.0)}
    kinds = dict.fromkeys(kind_of(name) for name in NAMES[_GYROSCOPE:])
    for kind, place in zip(kinds, (slice(3), slice(3, 6), slice(6, 12), slice(12, 21)), strict=True):
        unit, size = units[kind]
        zeros = gyroscope.parameters.raw_zero if kind == "gyroscope bias" else None
        yield from _numbers(kind, unit, values[place] / size, sigma[place] / size, freedom=freedom, zeros=zeros)


def _numbers(
    what: str,
    unit: str,
    values: FloatArray,
    sigmas: FloatArray,
    *,
    freedom: float,
    common: FloatArray | None = None,
    zeros: FloatArray | None = None,
) -> Iterator[Number]:
    names = [name for name in NAMES if kind_of(name) == what]
    shared, origins = (np.zeros(len(values)) if each is None else each for each in (common, zeros))
    for name, zero, value, sigma, part in zip(names, origins, values, sigmas, shared, strict=True):
        # Sigma 0 is fixed by the gauge, NaN was not estimated: neither can have changed.
        if sigma > 0 and math.isfinite(value):
            yield Number(
                name=name,
                # Counted from another raw zero a bias is another number, as in another unit.
                unit=f"{unit} from {zero:g}" if zero else unit,
                value=float(value),
                sigma=float(sigma),
                common=min(float(part), float(sigma)),
                freedom=freedom,
                scatter_freedom=freedom,
            )


def _jacobian(calibration: Calibration, change: GaugeChange) -> FloatArray:
    """Return d values / d parameters of the covariance; ``change`` is that to the lower gauge."""
    used, gyroscope = calibration.accelerometer, calibration.gyroscope
    J = np.zeros((_GYROSCOPE, len(PARAMETER_NAMES)))
    J[:, :PARAMETERS] = _accelerometer_values(to_vector(used), used.quadratic_axes)[1]
    if gyroscope is not None:
        J = np.concatenate([J, _gyroscope_jacobian(gyroscope.parameters, change)])
    # Gravity is none of the parameters that the values depend on.
    known = [k for k, name in enumerate(calibration.covariance_names) if name != GRAVITY_NAME]
    chosen = np.zeros((len(J), len(calibration.covariance_names)))
    chosen[:, known] = J[:, [PARAMETER_NAMES.index(calibration.covariance_names[k]) for k in known]]
    return chosen


def _accelerometer_values(vector: FloatArray, quadratic_axes: QuadraticAxes) -> tuple[FloatArray, FloatArray]:
    """Return the accelerometer's values and their derivatives, shapes (12,) and (12, 15)."""
    values, J = intrinsic(vector, quadratic_axes)
    over = [*range(3, 6), *range(9, 12)]
    scale, slope = np.tile(values[:3], 2), np.tile(J[:3] / values[:3, None], (2, 1))
    # Bias and quadratic term over the scale.
    J[over] = (J[over] - values[over, None] * slope) / scale[:, None]
    values[over] /= scale
    return values, J


def _gyroscope_jacobian(parameters: GyroscopeParameters, change: GaugeChange) -> FloatArray:
    """Return d values of the gyroscope / d ``PARAMETER_NAMES``, shape (21, 36).

    With M = (I + E) R^T and D = diag(M) the values are e / (K D), K D, M / D and G R^T / (K D); the
    parameters of the accelerometer turn R, dR^T = -R^T [w].
    """
    scale, misalignment, bias, sensitivity = np.split(np.eye(len(PARAMETER_NAMES))[:, PARAMETERS:], (3, 9, 12), axis=1)
    off_diagonal = ~np.eye(3, dtype=np.bool_)
    dE = np.zeros((len(PARAMETER_NAMES), 3, 3))
    dE[:, off_diagonal] = misalignment
    w = np.zeros((len(PARAMETER_NAMES), 3))
    w[:PARAMETERS] = change.turn.T
    R, turned = change.rotation, turn_gyroscope(parameters, change.rotation)
    D, K, G = turned.scale / parameters.scale, turned.scale, turned.g_sensitivity
    own = np.eye(3) + turned.misalignment_rad  # M / D
    dM = dE @ R.T - D[:, None] * own @ skew(w)
    dD = np.diagonal(dM, axis1=1, axis2=2)
    dG = sensitivity.reshape(-1, 3, 3) @ R.T - G @ skew(w)
    dK = scale * D + parameters.scale * dD
    parts = (
        bias / K - turned.bias / K**2 * dK,
        dK,
        ((dM - own * dD[:, :, None]) / D[:, None])[:, off_diagonal],
        ((dG - G * (dK / K)[:, :, None]) / K[:, None]).reshape(-1, 9),
    )
    return np.concatenate(parts, axis=1).T


def si_values(calibration: Calibration) -> FloatArray:
    """Return the values of ``NAMES`` in SI, those of the accelerometer alone without a gyroscope.

    The quadratic term and the bias of the accelerometer are divided by its scale, those of the gyroscope by its own.
    """
    if calibration.gyroscope is None:
        return _si_values(calibration, np.eye(3))
    return _si_values(calibration, change_gauge(to_vector(calibration.accelerometer), "lower").rotation)


def _si_values(calibration: Calibration, rotation: FloatArray) -> FloatArray:
    own = _accelerometer_values(to_vector(calibration.accelerometer), calibration.accelerometer.quadratic_axes)[0]
    if calibration.gyroscope is None:
        return own
    turned = turn_gyroscope(calibration.gyroscope.parameters, rotation)
    K, off_diagonal = turned.scale, ~np.eye(3, dtype=np.bool_)
    sensitivity = (turned.g_sensitivity / K[:, None]).ravel()
    return np.concatenate([own, turned.bias / K, K, turned.misalignment_rad[off_diagonal], sensitivity])


def lower_parameters(values: FloatArray) -> FloatArray:
    """Return the parameters of gauge-free numbers in SI, ``si_values``, shape (12,) -> (15,) or (33,) -> (36,)."""
    scale, bias, angle, quadratic = values[:_GYROSCOPE].reshape(4, 3)
    xy, xz, yz = -np.sin(angle)
    u = np.array([[1.0, 0.0, 0.0], [xy, np.sqrt(1 - xy**2), 0.0], [xz, 0.0, 0.0]])
    u[2, 1] = (yz - xz * xy) / u[1, 1]
    u[2, 2] = np.sqrt(1 - u[2, 0] ** 2 - u[2, 1] ** 2)
    d = np.diag(u)
    T = u / d[:, None]
    accelerometer = np.concatenate([scale * d, bias / d, T[~np.eye(3, dtype=np.bool_)], quadratic * scale * d**2])
    if len(values) == _GYROSCOPE:
        return accelerometer
    bias, K, misalignment, sensitivity = np.split(values[_GYROSCOPE:], (3, 6, 12))
    return np.concatenate([accelerometer, K, misalignment, bias * K, sensitivity * np.repeat(K, 3)])


def lower_jacobian(values: FloatArray) -> FloatArray:
    """Return d ``lower_parameters`` / d values."""
    columns = []
    for k, value in enumerate(values):
        step = np.zeros_like(values)
        step[k] = _STEP * max(abs(float(value)), 1.0)
        columns.append((lower_parameters(values + step) - lower_parameters(values - step)) / (2 * step[k]))
    return np.stack(columns, axis=1)
