"""The parameters in units of the trade, for the tables of the summary and of the report: value, uncertainty, preset, change."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.model.result import MISALIGNMENTS, PAIRS, Calibration, GyroscopeCalibration
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.document import gyroscope_bias_rad_s
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S, decimals, rounded, with_sigma
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.samples import AXES, FloatArray

VERDICT_WORDS = {
    "good": "fit for use",
    "usable": "read the warnings below",
    "poor": "do not use it for navigation",
}
GAUGE_WORDS = {
    "lower": "body x is the sensor's x axis, body y lies in its x-y plane",
    "upper": "body z is the sensor's z axis, body y lies in its y-z plane",
    "symmetric": "body axes are the orthogonal axes nearest to the sensor's axes",
    "preset": "body axes are those of the preset",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One parameter."""

    triad: str
    name: str
    unit: str
    value: float
    sigma: float
    """1 sigma; 0 where the gauge fixes it, NaN where not estimated."""
    preset: float
    """NaN without a preset."""

    @property
    def shown(self) -> str:
        """Value with 1 sigma."""
        return with_sigma(self.value, self.sigma, sign=True)

    def expanded(self, factor: float) -> str:
        """Half the width of the 95 % interval; empty where there is none."""
        half = self.sigma * factor
        return rounded(half, half) if self.sigma > 0 and math.isfinite(half) else ""

    @property
    def preset_shown(self) -> str:
        """Preset with as many digits as the value; empty without one."""
        if math.isnan(self.preset):
            return ""
        # Four decimals where sigma gives no measure: as many as a preset is usually quoted with.
        places = decimals(self.sigma) if self.sigma > 0 else 4
        return f"{self.preset:+z.{max(places, 0)}f}"

    @property
    def change(self) -> str:
        """Change against the preset in units of sigma; empty where one of them is missing."""
        if math.isnan(self.preset) or not self.sigma > 0:
            return ""
        return f"{(self.value - self.preset) / self.sigma:+z.1f}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """Numbers of one kind, arrays of one length."""

    triad: str
    name: str
    unit: str
    places: tuple[str, ...]
    """Axes, or row and column."""
    value: FloatArray
    sigma: FloatArray
    preset: FloatArray
    """NaN without a preset."""


def parameter_rows(calibration: Calibration, preset: Calibration | None) -> list[Row]:
    """Return the rows of accelerometer and gyroscope."""
    rows = []
    for quantity in quantities(calibration, preset):
        # Terms that were taken over from a preset are no result of this calibration.
        if quantity.name == "quadratic" and not calibration.quadratic_fitted:
            continue
        if quantity.name == "g-sensitivity" and not np.isfinite(quantity.sigma).any():
            continue
        for place, value, sigma, before in zip(
            quantity.places, quantity.value.tolist(), quantity.sigma.tolist(), quantity.preset.tolist(), strict=True
        ):
            if math.isnan(value) or (value == 0 and (sigma == 0 or math.isnan(sigma))):
                continue  # fixed by the gauge, or not estimated: the page says so below the table
            name = f"{quantity.name} {place}"
            rows.append(Row(triad=quantity.triad, name=name, unit=quantity.unit, value=value, sigma=sigma, preset=before))
    return rows


def quantities(calibration: Calibration, preset: Calibration | None = None) -> Iterator[Quantity]:
    """Yield every kind of parameter that a calibration has, the accelerometer's first."""
    p, triad = calibration.accelerometer, "Accelerometer"
    sources = (p, calibration.accelerometer_sigma, None if preset is None else preset.accelerometer)
    yield _quantity(triad, "bias", "mg", _numbers(*sources, "bias_m_s2"), divisor=MILLI_G_M_S2)
    yield _scale(triad, calibration.accelerometer_raw_unit, "m/s²", _numbers(*sources, "scale"))
    yield _misalignment(triad, _numbers(*sources, "misalignment_rad"))
    if calibration.quadratic_fitted or np.any(p.quadratic):
        # K2 / K is (m/s²) per (m/s²)²; times g it is g per g², of which a millionth is µg/g².
        size = STANDARD_GRAVITY_M_S2 / p.scale * 1e6
        yield _quantity(triad, "quadratic", "µg/g²", _numbers(*sources, "quadratic"), factor=size)
    if p.higher is not None:
        before = None if preset is None else preset.accelerometer.higher
        terms = (p.higher, calibration.accelerometer_sigma.higher, before)
        # m/s² per (m/s²)³ times g² is g per g³.
        per_g, cross = STANDARD_GRAVITY_M_S2 * 1e6, _numbers(*terms, "cross")
        yield _quantity(triad, "cubic", "µg/g³", _numbers(*terms, "cubic"), factor=per_g * STANDARD_GRAVITY_M_S2)
        for product, numbers in zip(("xy", "xz", "yz"), np.split(cross, 3, axis=1), strict=True):
            yield _quantity(triad, f"cross {product}", "µg/g²", numbers, factor=per_g)
    if calibration.gyroscope is not None:
        yield from _gyroscope(calibration.gyroscope, None if preset is None else preset.gyroscope)


def _gyroscope(gyroscope: GyroscopeCalibration, preset: GyroscopeCalibration | None) -> Iterator[Quantity]:
    p, sigma, triad = gyroscope.parameters, gyroscope.sigma, "Gyroscope"
    # Before and after are compared about the same raw output.
    preset = None if preset is None else replace(preset, parameters=preset.parameters.about(p.raw_zero))
    sources = (p, sigma, None if preset is None else preset.parameters)
    if np.isfinite(p.scale).all():
        bias, bias_sigma = gyroscope_bias_rad_s(gyroscope)
        # Beyond, the figures of a consumer instrument would have six digits.
        slow = float(np.abs(bias).max()) < 1000 * DEG_PER_HOUR_RAD_S
        unit, size = ("°/h", DEG_PER_HOUR_RAD_S) if slow else ("°/s", 3600 * DEG_PER_HOUR_RAD_S)
        before = np.full(3, np.nan) if preset is None else gyroscope_bias_rad_s(preset)[0]
        yield _quantity(triad, "bias", unit, np.array([bias, bias_sigma, before]), divisor=size)
    else:
        yield _quantity(triad, "bias", gyroscope.raw_unit, _numbers(*sources, "bias"))
    if not np.isfinite(sigma.scale).all():
        return
    yield _scale(triad, gyroscope.raw_unit, "rad/s", _numbers(*sources, "scale"))
    yield _misalignment(triad, _numbers(*sources, "misalignment_rad"))
    if np.any(p.g_sensitivity):
        size_of_row = np.repeat(STANDARD_GRAVITY_M_S2 / DEG_PER_HOUR_RAD_S / p.scale, 3)
        numbers = _numbers(*sources, "g_sensitivity")
        yield _quantity(triad, "g-sensitivity", "°/h/g", numbers, factor=size_of_row, places=PAIRS)


def _numbers(parameters: object, sigma: object, preset: object | None, key: str) -> FloatArray:
    """Return value, 1 sigma and the preset's value, NaN without one, row by row where they are matrices, shape (3, n)."""
    value = np.ravel(getattr(parameters, key))
    before = np.full(len(value), np.nan) if preset is None else np.ravel(getattr(preset, key))
    return np.array([value, np.ravel(getattr(sigma, key)), before], dtype=np.float64)


def _quantity(
    triad: str,
    name: str,
    unit: str,
    numbers: FloatArray,
    *,
    factor: FloatArray | float = 1.0,
    divisor: float = 1.0,
    places: tuple[str, ...] = AXES,
) -> Quantity:
    value, sigma, preset = (row * size / divisor for row, size in zip(numbers, (factor, np.abs(factor), factor), strict=True))
    return Quantity(triad=triad, name=name, unit=unit, places=places, value=value, sigma=sigma, preset=preset)


def _scale(triad: str, raw_unit: str, per: str, numbers: FloatArray) -> Quantity:
    nominal = nominal_scale(raw_unit)
    if nominal is None:
        return _quantity(triad, "scale", f"{raw_unit} per {per}", numbers)
    # Errors of value and preset; a sigma stays what it is.
    return _quantity(triad, "scale error", "ppm", numbers / nominal - [[1], [0], [1]], factor=1e6)


def _misalignment(triad: str, numbers: FloatArray) -> Quantity:
    off_diagonal = ~np.eye(3, dtype=np.bool_).ravel()  # the diagonal belongs to the scale
    return _quantity(triad, "misalignment", "mrad", numbers[:, off_diagonal], factor=1e3, places=MISALIGNMENTS)
