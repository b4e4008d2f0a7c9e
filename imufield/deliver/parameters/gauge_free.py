"""The numbers of a calibration that no choice of the body frame changes, with 1 sigma: what may be compared over time.

The accelerometer's are those of ``[accelerometer.intrinsic]``. The gyroscope's misalignment and g-sensitivity are taken against
the accelerometer's own axes: both triads are turned together so that the sensing x axis is the body's and the sensing y axis
lies in its xy plane (gauge "lower"). That frame is found from parameters that are uncertain themselves, so sigma is that of
the whole function, ``J C J^T`` with the joint covariance C and J by central differences; it is smooth and nearly linear.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imufield.calibrate.model.gauge import change_gauge, turn_gyroscope
from imufield.calibrate.model.models import to_vector
from imufield.calibrate.model.result import ACCELEROMETER_NAMES, Calibration, GyroscopeParameters
from imufield.deliver.parameters.document import gyroscope_bias_rad_s
from imufield.deliver.parameters.numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.samples import AXES, FloatArray

# Places of the numbers, in the order of the file.
_ANGLES = ("xy", "xz", "yz")
_MISALIGNMENTS = ("xy", "xz", "yx", "yz", "zx", "zy")
_SENSITIVITIES = tuple(row + column for row in AXES for column in AXES)
_STEP_SIGMA = 0.1  # Of the central differences: far above rounding, far below what bends the function.


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """One gauge-free number of a calibration."""

    name: str
    unit: str
    value: float
    sigma: float
    common: float = 0.0
    """Part of sigma that comes from gravity."""


def numbers_of(calibration: Calibration) -> tuple[Number, ...]:
    """Return the gauge-free numbers of a calibration, those that were estimated.

    Raises
    ------
    CalibrationError
        If the accelerometer's axes are left-handed or nearly in one plane.
    """
    return (*_accelerometer(calibration), *_gyroscope(calibration))


def _accelerometer(calibration: Calibration) -> Iterator[Number]:
    own, g = calibration.intrinsic, calibration.gravity
    K, unit = own.scale, calibration.accelerometer_raw_unit
    common = np.abs(K) * g.sigma_m_s2 / g.gravity_m_s2
    bias, spread = own.bias_raw / K, own.bias_raw_sigma / np.abs(K)
    size = STANDARD_GRAVITY_M_S2 / K * 1e6
    yield from _numbers("bias", AXES, "mg", bias / MILLI_G_M_S2, sigmas=spread / MILLI_G_M_S2)
    yield from _numbers("scale", AXES, f"{unit} per m/s^2", K, sigmas=own.scale_sigma, common=common)
    yield from _numbers("angle", _ANGLES, "mrad", own.angle_rad * 1e3, sigmas=own.angle_sigma_rad * 1e3)
    yield from _numbers("quadratic", AXES, "ug/g^2", own.quadratic * size, sigmas=own.quadratic_sigma * np.abs(size))


def _gyroscope(calibration: Calibration) -> Iterator[Number]:
    gyroscope = calibration.gyroscope
    if gyroscope is None or not np.isfinite(gyroscope.parameters.scale).all():
        return
    rate, sigma = (values / DEG_PER_HOUR_RAD_S for values in gyroscope_bias_rad_s(gyroscope))
    yield from _numbers("gyroscope bias", AXES, "deg/h", rate, sigmas=sigma)
    scale = gyroscope.parameters.scale
    yield from _numbers("gyroscope scale", AXES, f"{gyroscope.raw_unit} per rad/s", scale, sigmas=gyroscope.sigma.scale)
    values, sigmas = against_accelerometer(calibration)
    size = STANDARD_GRAVITY_M_S2 / DEG_PER_HOUR_RAD_S
    yield from _numbers("gyroscope misalignment", _MISALIGNMENTS, "mrad", values[:6] * 1e3, sigmas=sigmas[:6] * 1e3)
    yield from _numbers("g-sensitivity", _SENSITIVITIES, "deg/h/g", values[6:] * size, sigmas=sigmas[6:] * size)


def _numbers(
    what: str, places: tuple[str, ...], unit: str, values: FloatArray, *, sigmas: FloatArray, common: FloatArray | None = None
) -> Iterator[Number]:
    shared = np.zeros(len(values)) if common is None else common
    for place, value, sigma, part in zip(places, values, sigmas, shared, strict=True):
        # Sigma 0 is fixed by the gauge, NaN was not estimated: neither can have changed.
        if sigma > 0 and math.isfinite(value):
            yield Number(
                name=f"{what} {place}", unit=unit, value=float(value), sigma=float(sigma), common=min(float(part), float(sigma))
            )


def against_accelerometer(calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return the gyroscope's misalignment and g-sensitivity against the accelerometer's own axes, and their 1 sigma.

    Returns
    -------
    values : ndarray, shape (15,)
        E - I without its diagonal (xy, xz, yx, yz, zx, zy), rad; then K^-1 G row by row, (rad/s)/(m/s^2).
    sigma : ndarray, shape (15,)
        NaN for what was not estimated.

    Raises
    ------
    CalibrationError
        If the accelerometer's axes are left-handed or nearly in one plane.
    """
    names, C = calibration.covariance_names, calibration.covariance
    step = _STEP_SIGMA * np.sqrt(np.maximum(np.diag(C), 0.0))
    J = np.zeros((15, len(names)))
    for column, (name, size) in enumerate(zip(names, step, strict=True)):
        if size > 0:
            ends = [_own_axes(calibration, name, sign * size) for sign in (1.0, -1.0)]
            J[:, column] = (ends[0] - ends[1]) / (2 * size)
    own = [f"gyroscope.misalignment_rad.{pair}" for pair in _MISALIGNMENTS]
    own += [f"gyroscope.g_sensitivity.{pair}" for pair in _SENSITIVITIES]
    variance = np.maximum(np.einsum("ij,jk,ik->i", J, C, J), 0.0)
    sigma = np.where([name in names for name in own], np.sqrt(variance), np.nan)
    return _own_axes(calibration, "", 0.0), np.asarray(sigma, dtype=np.float64)


def _own_axes(calibration: Calibration, name: str, offset: float) -> FloatArray:
    """Return the 15 values with one parameter changed, shape (15,)."""
    vector = to_vector(calibration.accelerometer)
    if name in ACCELEROMETER_NAMES:
        vector[ACCELEROMETER_NAMES.index(name)] += offset
    assert calibration.gyroscope is not None  # noqa: S101  (asked for calibrations with a gyroscope only)
    # Copies: the calibration itself stays as it was measured.
    own = calibration.gyroscope.parameters
    fields = {key: getattr(own, key).copy() for key in ("scale", "misalignment_rad", "bias", "g_sensitivity")}
    triad, _, rest = name.partition(".")
    if triad == "gyroscope":
        key, _, place = rest.partition(".")
        fields[key][tuple(AXES.index(axis) for axis in place)] += offset
    turned = turn_gyroscope(GyroscopeParameters(**fields), change_gauge(vector, "lower").rotation)
    off_diagonal = ~np.eye(3, dtype=np.bool_)
    return np.concatenate([turned.misalignment_rad[off_diagonal], (turned.g_sensitivity / turned.scale[:, None]).ravel()])
