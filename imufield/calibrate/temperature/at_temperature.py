"""A calibration over temperature evaluated at one temperature: parameters and covariance."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import at_temperature
from imufield.calibrate.model.result import Calibration, GyroscopeCalibration
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.dataclass import replace
from imufield.samples import AXES, FloatArray


def calibration_at(calibration: Calibration, temperature_degc: float) -> Calibration:
    """Return what holds at a temperature, as a calibration that knows no other."""
    model, gyroscope = calibration.accelerometer_temperature, calibration.gyroscope
    there, sigma = calibration.accelerometer, calibration.accelerometer_sigma
    raised: dict[str, FloatArray] = {}
    covariance = calibration.covariance.copy()
    if model is not None:
        bias, scale = model.sigma_there(temperature_degc, sigma.bias_m_s2, sigma.scale / np.abs(there.scale))
        there = at_temperature(there, model, temperature_degc)
        sigma = replace(sigma, bias_m_s2=bias, scale=scale * np.abs(there.scale))
        raised |= {"accelerometer.bias_m_s2": sigma.bias_m_s2, "accelerometer.scale": sigma.scale}
        names = ("accelerometer.bias_m_s2", "accelerometer.scale")
        _correlate(calibration, covariance, names, model=model, between=model.covariance_there(temperature_degc) * there.scale)
    if gyroscope is not None and gyroscope.temperature is not None:
        of_gyroscope = gyroscope.temperature
        gyroscope = _gyroscope_there(gyroscope, of_gyroscope, temperature_degc)
        between = of_gyroscope.covariance_there(temperature_degc) * gyroscope.parameters.scale**2
        _correlate(calibration, covariance, ("gyroscope.bias", "gyroscope.scale"), model=of_gyroscope, between=between)
        raised |= {"gyroscope.bias": gyroscope.sigma.bias, "gyroscope.scale": gyroscope.sigma.scale}
    return replace(
        calibration,
        accelerometer=there,
        accelerometer_sigma=sigma,
        gyroscope=gyroscope,
        accelerometer_temperature=None,
        covariance=_with_sigma(calibration, covariance, raised),
    )


def _gyroscope_there(gyroscope: GyroscopeCalibration, model: TriadTemperature, temperature_degc: float) -> GyroscopeCalibration:
    K = np.abs(gyroscope.parameters.scale)
    bias, scale = model.sigma_there(temperature_degc, gyroscope.sigma.bias / K, gyroscope.sigma.scale / K)
    there = at_temperature(gyroscope.parameters, model, temperature_degc)
    size = np.abs(there.scale)
    # A scale that no turn has shown has no sigma at any temperature.
    scale = np.where(np.isfinite(gyroscope.sigma.scale), scale, gyroscope.sigma.scale)
    return replace(
        gyroscope, parameters=there, sigma=replace(gyroscope.sigma, bias=bias * size, scale=scale * size), temperature=None
    )


def _correlate(
    calibration: Calibration, covariance: FloatArray, names: tuple[str, str], *, model: TriadTemperature, between: FloatArray
) -> None:
    """Put the covariance of bias and scale into the joint one: that of a new day, or what their change adds."""
    is_new_day = model.new_day is not None and bool(np.isfinite(model.new_day.scale).all())
    for axis, value in zip(AXES, between, strict=True):
        if all(f"{name}.{axis}" in calibration.covariance_names for name in names):
            bias, scale = (calibration.covariance_names.index(f"{name}.{axis}") for name in names)
            covariance[bias, scale] = covariance[scale, bias] = value + (0.0 if is_new_day else covariance[bias, scale])


def _with_sigma(calibration: Calibration, covariance: FloatArray, sigma: dict[str, FloatArray]) -> FloatArray:
    """Return the joint covariance with other variances of some parameters, by name; what else is added is independent."""
    for name, values in sigma.items():
        for axis, value in zip(AXES, values, strict=True):
            if f"{name}.{axis}" in calibration.covariance_names and np.isfinite(value):
                row = calibration.covariance_names.index(f"{name}.{axis}")
                covariance[row, row] = value**2
    return covariance
