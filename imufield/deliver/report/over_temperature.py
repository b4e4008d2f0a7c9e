"""Bias and scale over temperature as curves for the report, in units for people."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imufield.calibrate.model.coverage_factors import NORMAL_FACTOR_95, student_factor
from imufield.calibrate.model.temperature_polynomials import TriadTemperature
from imufield.calibrate.sessions.kinds import PPM
from imufield.dataclass import dataclass
from imufield.deliver.parameters.file import Parameters
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2
from imufield.samples import FloatArray

_STEPS = 81  # Over the range: a polynomial of order 5 bends four times.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuantityCurves:
    """How a quantity changes from the reference, at n temperatures and in m sessions."""

    quantity: str
    unit: str
    change: FloatArray
    """Shape (n, 3)."""
    sigma: FloatArray
    """Of the value, 1 sigma, shape (n, 3); NaN where it is not known."""
    factor: float
    """From it to half of the 95 % interval."""
    is_of_new_day: bool
    """Whether sigma is that of a day that was not measured."""
    sessions: FloatArray
    """Shape (m, 3)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TemperatureCurves:
    """Both quantities of a triad."""

    triad: str
    temperature_degc: FloatArray
    """Shape (n,)."""
    sessions_degc: FloatArray
    """Shape (m,)."""
    reference_degc: float
    bias: QuantityCurves
    scale: QuantityCurves


def temperature_curves(parameters: Parameters) -> Iterator[TemperatureCurves]:
    """Yield the curves of each triad of which something is known over temperature."""
    calibration = parameters.calibration
    own, gyroscope = calibration.accelerometer_sigma, calibration.gyroscope
    if (model := calibration.accelerometer_temperature) is not None:
        sigma = own.bias_m_s2, own.scale / np.abs(calibration.accelerometer.scale)
        yield _curves("accelerometer", model, *sigma, unit=("mg", MILLI_G_M_S2))
    if gyroscope is not None and (model := gyroscope.temperature) is not None:
        K = np.abs(gyroscope.parameters.scale)
        yield _curves("gyroscope", model, gyroscope.sigma.bias / K, gyroscope.sigma.scale / K, unit=("°/h", DEG_PER_HOUR_RAD_S))


def _curves(
    triad: str, model: TriadTemperature, bias_sigma: FloatArray, scale_sigma: FloatArray, *, unit: tuple[str, float]
) -> TemperatureCurves:
    at_degc, day, sessions = np.linspace(*model.range_degc, _STEPS), model.new_day, model.sessions
    d_degc = model.degrees_above(at_degc)
    sigmas = [model.sigma_there(float(degc), bias_sigma, scale_sigma) for degc in at_degc]
    bias, scale = (np.array(of_each) for of_each in zip(*sigmas, strict=True))

    def curves(quantity: str, sigma: FloatArray, unit: str, size: float) -> QuantityCurves:
        return QuantityCurves(
            quantity=quantity,
            unit=unit,
            change=getattr(model, quantity).at(d_degc) / size,
            sigma=sigma / size,
            factor=NORMAL_FACTOR_95 if day is None else student_factor(getattr(day, f"{quantity}_freedom")),
            is_of_new_day=day is not None and bool(np.isfinite(getattr(day, quantity)).any()),
            sessions=np.empty((0, 3)) if sessions is None else getattr(sessions, quantity) / size,
        )

    return TemperatureCurves(
        triad=triad,
        temperature_degc=at_degc,
        sessions_degc=np.empty(0) if sessions is None else sessions.temperature_degc,
        reference_degc=model.reference_degc,
        bias=curves("bias", bias, *unit),
        scale=curves("scale", scale, "ppm", PPM),
    )
