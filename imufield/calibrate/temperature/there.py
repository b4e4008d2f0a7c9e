"""A calibration over temperature, at one temperature: parameters and how well they are known there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imufield.calibrate.model.models import at_temperature
from imufield.calibrate.model.result import Calibration, GyroscopeCalibration
from imufield.samples import AXES, FloatArray


def calibration_at(calibration: Calibration, temperature_degc: float) -> Calibration:
    """Return what holds at a temperature, as a calibration that knows no other."""
    model, gyroscope = calibration.accelerometer_temperature, calibration.gyroscope
    there, sigma = calibration.accelerometer, calibration.accelerometer_sigma
    raised: dict[str, FloatArray] = {}
    if model is not None:
        bias, scale = model.sigma_there(temperature_degc, sigma.bias_m_s2, sigma.scale / np.abs(there.scale))
        there = at_temperature(there, model, temperature_degc)
        sigma = replace(sigma, bias_m_s2=bias, scale=scale * np.abs(there.scale))
        raised |= {"accelerometer.bias_m_s2": sigma.bias_m_s2, "accelerometer.scale": sigma.scale}
    if gyroscope is not None and gyroscope.temperature is not None:
        gyroscope = _gyroscope_there(gyroscope, temperature_degc)
        raised |= {"gyroscope.bias": gyroscope.sigma.bias, "gyroscope.scale": gyroscope.sigma.scale}
    return replace(
        calibration,
        accelerometer=there,
        accelerometer_sigma=sigma,
        gyroscope=gyroscope,
        accelerometer_temperature=None,
        covariance=_with_sigma(calibration, raised),
    )


def _gyroscope_there(gyroscope: GyroscopeCalibration, temperature_degc: float) -> GyroscopeCalibration:
    model, K = gyroscope.temperature, np.abs(gyroscope.parameters.scale)
    if model is None:
        return gyroscope
    bias, scale = model.sigma_there(temperature_degc, gyroscope.sigma.bias / K, gyroscope.sigma.scale / K)
    there = at_temperature(gyroscope.parameters, model, temperature_degc)
    size = np.abs(there.scale)
    # A scale that no turn has shown has no sigma at any temperature.
    scale = np.where(np.isfinite(gyroscope.sigma.scale), scale, gyroscope.sigma.scale)
    return replace(
        gyroscope, parameters=there, sigma=replace(gyroscope.sigma, bias=bias * size, scale=scale * size), temperature=None
    )


def _with_sigma(calibration: Calibration, sigma: dict[str, FloatArray]) -> FloatArray:
    """Return the joint covariance with other variances of some parameters, by name; what is added is independent."""
    covariance = calibration.covariance.copy()
    for name, values in sigma.items():
        for axis, value in zip(AXES, values, strict=True):
            if f"{name}.{axis}" in calibration.covariance_names and np.isfinite(value):
                row = calibration.covariance_names.index(f"{name}.{axis}")
                covariance[row, row] = value**2
    return covariance
