"""Rows of the parameter table: value, uncertainty, preset and change, each in units of the trade."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.calibrate.model.result import Calibration, GyroscopeCalibration
from imufield.deliver.parameters.document import gyroscope_bias_rad_s
from imufield.deliver.parameters.numbers import DEG_PER_HOUR_RAD_S, decimals, with_sigma
from imufield.earth import MILLI_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.samples import AXES, FloatArray

_PAIRS = tuple((i, j) for i in range(3) for j in range(3) if i != j)


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
        if not (self.sigma > 0 and math.isfinite(self.sigma * factor)):
            return ""
        places = max(decimals(self.sigma * factor), 0)
        return f"{self.sigma * factor:.{places}f}"

    @property
    def preset_shown(self) -> str:
        """Preset with as many digits as the value; empty without one."""
        if math.isnan(self.preset):
            return ""
        places = decimals(self.sigma) if self.sigma > 0 else 4
        return f"{self.preset:+.{max(places, 0)}f}"

    @property
    def change(self) -> str:
        """Change against the preset in units of sigma; empty where one of them is missing."""
        if math.isnan(self.preset) or not self.sigma > 0:
            return ""
        return f"{(self.value - self.preset) / self.sigma:+.1f}"


def parameter_rows(calibration: Calibration, preset: Calibration | None) -> list[Row]:
    """Return the rows of accelerometer and gyroscope."""
    return [*_accelerometer(calibration, preset), *_gyroscope(calibration, preset)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Group:
    """Numbers of one kind, arrays of one length."""

    triad: str
    name: str
    unit: str
    places: tuple[str, ...]
    value: FloatArray
    sigma: FloatArray
    preset: FloatArray | None

    def rows(self) -> Iterator[Row]:
        preset = np.full(len(self.value), np.nan) if self.preset is None else self.preset
        for place, value, sigma, before in zip(self.places, self.value, self.sigma, preset, strict=True):
            if math.isnan(value) or (value == 0 and (sigma == 0 or math.isnan(sigma))):
                continue  # fixed by the gauge, or not estimated: the page says so below the table
            yield Row(
                triad=self.triad,
                name=f"{self.name} {place}",
                unit=self.unit,
                value=float(value),
                sigma=float(sigma),
                preset=float(before),
            )


def _accelerometer(calibration: Calibration, preset: Calibration | None) -> Iterator[Row]:
    p, sigma = calibration.accelerometer, calibration.accelerometer_sigma
    old = None if preset is None else preset.accelerometer
    triad = "Accelerometer"
    before = None if old is None else old.bias_m_s2 / MILLI_G_M_S2
    yield from _Group(
        triad=triad,
        name="bias",
        unit="mg",
        places=AXES,
        value=p.bias_m_s2 / MILLI_G_M_S2,
        sigma=sigma.bias_m_s2 / MILLI_G_M_S2,
        preset=before,
    ).rows()
    before = None if old is None else old.scale
    yield from _scale(triad, calibration.accelerometer_raw_unit, "m/s²", p.scale, sigma=sigma.scale, before=before).rows()
    before = None if old is None else old.misalignment_rad
    yield from _misalignment(triad, p.misalignment_rad, sigma.misalignment_rad, before).rows()
    if calibration.quadratic_fitted:
        # K2 / K is (m/s²) per (m/s²)²; times g it is g per g², of which a millionth is µg/g².
        size = STANDARD_GRAVITY_M_S2 / p.scale * 1e6
        before = None if old is None else old.quadratic * size
        quadratic = _Group(
            triad=triad,
            name="quadratic",
            unit="µg/g²",
            places=AXES,
            value=p.quadratic * size,
            sigma=sigma.quadratic * np.abs(size),
            preset=before,
        )
        yield from quadratic.rows()


def _gyroscope(calibration: Calibration, preset: Calibration | None) -> Iterator[Row]:
    if calibration.gyroscope is None:
        return
    own, old = calibration.gyroscope, None if preset is None else preset.gyroscope
    triad, p, sigma = "Gyroscope", own.parameters, own.sigma
    yield from _gyroscope_bias(triad, own, old).rows()
    if np.isfinite(sigma.scale).all():
        yield from _scale(
            triad, own.raw_unit, "rad/s", p.scale, sigma=sigma.scale, before=None if old is None else old.parameters.scale
        ).rows()
        before = None if old is None else old.parameters.misalignment_rad
        yield from _misalignment(triad, p.misalignment_rad, sigma.misalignment_rad, before).rows()
    if np.any(p.g_sensitivity) and np.isfinite(sigma.g_sensitivity).any():
        size = STANDARD_GRAVITY_M_S2 / DEG_PER_HOUR_RAD_S / p.scale[:, None]
        places = tuple(f"{row}{column}" for row in AXES for column in AXES)
        before = None if old is None else (old.parameters.g_sensitivity * size).ravel()
        values, spread = (p.g_sensitivity * size).ravel(), (sigma.g_sensitivity * np.abs(size)).ravel()
        yield from _Group(
            triad=triad, name="g-sensitivity", unit="°/h/g", places=places, value=values, sigma=spread, preset=before
        ).rows()


def _gyroscope_bias(triad: str, own: GyroscopeCalibration, old: GyroscopeCalibration | None) -> _Group:
    if not np.isfinite(own.parameters.scale).all():
        before = None if old is None else old.parameters.bias
        return _Group(
            triad=triad,
            name="bias",
            unit=own.raw_unit,
            places=AXES,
            value=own.parameters.bias,
            sigma=own.sigma.bias,
            preset=before,
        )
    bias, sigma = gyroscope_bias_rad_s(own)
    slow = float(np.abs(bias).max()) < 1000 * DEG_PER_HOUR_RAD_S
    unit, size = ("°/h", DEG_PER_HOUR_RAD_S) if slow else ("°/s", 3600 * DEG_PER_HOUR_RAD_S)
    before = None if old is None else gyroscope_bias_rad_s(old)[0] / size
    return _Group(triad=triad, name="bias", unit=unit, places=AXES, value=bias / size, sigma=sigma / size, preset=before)


def _scale(triad: str, raw_unit: str, per: str, scale: FloatArray, *, sigma: FloatArray, before: FloatArray | None) -> _Group:
    nominal = nominal_scale(raw_unit)
    if nominal is None:
        return _Group(
            triad=triad, name="scale", unit=f"{raw_unit} per {per}", places=AXES, value=scale, sigma=sigma, preset=before
        )
    old = None if before is None else (before / nominal - 1) * 1e6
    return _Group(
        triad=triad,
        name="scale error",
        unit="ppm",
        places=AXES,
        value=(scale / nominal - 1) * 1e6,
        sigma=sigma / nominal * 1e6,
        preset=old,
    )


def _misalignment(triad: str, matrix: FloatArray, sigma: FloatArray, before: FloatArray | None) -> _Group:
    places = tuple(f"{AXES[i]}{AXES[j]}" for i, j in _PAIRS)
    values, spread = (np.array([one[pair] for pair in _PAIRS]) * 1e3 for one in (matrix, sigma))
    old = None if before is None else np.array([before[pair] for pair in _PAIRS]) * 1e3
    return _Group(triad=triad, name="misalignment", unit="mrad", places=places, value=values, sigma=spread, preset=old)
