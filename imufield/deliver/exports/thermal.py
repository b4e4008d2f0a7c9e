"""Bias over temperature for flight stacks.

PX4 (src/modules/temperature_compensation, src/lib/sensor_calibration), for each sensor, T clamped into [TMIN, TMAX]::

    out = R_rot ((raw - X0 - X1 d - X2 d^2 - X3 d^3 - OFF) .* SCALE),   d = T - TREF

ArduPilot (AP_InertialSensor_tempcal.cpp, before offset and scale), T and CALTEMP clamped into [TMIN, TMAX]::

    raw' = raw - P(T - 35) + P(CALTEMP - 35),   P(x) = 1e-6 (C1 x + C2 x^2 + C3 x^3)

Both take an offset of third order in T and leave the scale as it is. The offset is that of the correction nearest to ours at
each temperature, less that at the reference; it and the static offset must come from one file, or the bias is subtracted twice.
"""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.models import predict, predict_gyroscope
from imufield.calibrate.model.temperature_polynomials import powers
from imufield.deliver.exports.conventions import diagonal_corrections
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.loss import directions
from imufield.deliver.parameters.printed_numbers import DEG_PER_HOUR_RAD_S
from imufield.earth import MILLI_G_M_S2
from imufield.samples import FloatArray

ORDER = 3
"""Of both programs."""
_STEPS = 81  # Over the range: a polynomial of order 5 bends four times.


class ThermalOffsets:
    """Offsets of third order in SI raw values, as the target takes them off.

    Parameters
    ----------
    job : Job
        Of parameters that hold over temperature.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self.reference_degc = job.parameters.temperature_models[0].reference_degc
        # Where both triads are known: the reference, that of one session, lies inside.
        self.range_degc = job.parameters.temperature_range_degc
        self.temperature_degc = np.linspace(*self.range_degc, _STEPS)
        offsets = [self._offsets(degc) for degc in (self.reference_degc, *self.temperature_degc)]
        self.coefficients = {
            triad: self._cubic(np.array([each[triad] for each in offsets[1:]]) - offsets[0][triad]) for triad in offsets[0]
        }
        """By triad, shape (3, 3): rows are factors of d, d^2 and d^3, m/s^2 or rad/s."""

    def _offsets(self, temperature_degc: float) -> dict[str, FloatArray]:
        there = self._job.parameters.at(temperature_degc)
        corrections = self._job.in_si(diagonal_corrections(there.calibration))
        return {triad: correction.offset for triad, correction in corrections.triads.items()}

    def _cubic(self, change: FloatArray) -> FloatArray:
        d_degc = self.temperature_degc - self.reference_degc
        span = np.abs(d_degc).max()
        scaled = np.linalg.lstsq(powers(d_degc / span, ORDER), change, rcond=None)[0]
        return in_single_precision(scaled / span ** np.arange(1, ORDER + 1)[:, None])

    def at(self, triad: str, temperature_degc: float) -> FloatArray:
        """Return what is taken off at a temperature, shape (3,)."""
        d_degc = np.clip([temperature_degc], *self.range_degc) - self.reference_degc
        return np.asarray((powers(d_degc, ORDER) @ self.coefficients[triad])[0])

    def loss(self, draft: Draft) -> tuple[str, ...]:
        """Say how far the target is from the whole model over the range: at 1 g, and for the gyroscope at rest."""
        model, parameters = draft.target_model, self._job.parameters
        if model is None:
            return ()
        force_off, rate_off = 0.0, 0.0
        nominal, _ = self._job.accelerometer_si()
        force = parameters.calibration.gravity.gravity_m_s2 * directions()
        for degc in self.temperature_degc:
            there = parameters.at(float(degc)).calibration
            raw = predict(there.accelerometer, force) - nominal * self.at("accelerometer", float(degc))
            off = model.apply_accelerometer(raw) - force @ model.rotation.T
            force_off = max(force_off, float(np.linalg.norm(off, axis=1).max()))
            if "gyroscope" in self.coefficients and there.gyroscope is not None and model.gyroscope is not None:
                still = predict_gyroscope(there.gyroscope.parameters, np.zeros((1, 3)))
                taken_off = self._job.si_scale("gyroscope") * self.at("gyroscope", float(degc))
                rate_off = max(rate_off, float(np.linalg.norm(model.gyroscope.apply(still - taken_off), axis=1).max()))
        low, high = self.range_degc
        sizes = {"force_mg": force_off / MILLI_G_M_S2, "rate_deg_h": rate_off / DEG_PER_HOUR_RAD_S}
        return (sentence("thermal.loss", low=low, high=high, **sizes),)


def in_single_precision(values: FloatArray) -> FloatArray:
    """Return values as single precision keeps them, with the fewest digits that name them."""
    rounded = np.asarray(values, dtype=np.float32)
    return np.array([float(str(value)) for value in rounded.ravel()], dtype=np.float64).reshape(rounded.shape)
