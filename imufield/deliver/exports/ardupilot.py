"""ArduPilot parameters INS_*.

``accel = (raw - OFFS) .* SCAL`` and ``gyro = raw - OFFS``, then board rotation (AP_InertialSensor_Backend).
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from imufield.deliver.exports.flight_stack import (
    FlightStack,
    Values,
    format_value,
    known_values,
    names_without_value,
    triad_values,
)
from imufield.deliver.exports.job import Draft, Job, sentence
from imufield.deliver.exports.text import comment, text_file
from imufield.deliver.exports.thermal import ORDER, ThermalOffsets, in_single_precision
from imufield.samples import FloatArray

# INS_MAX_INSTANCES, 3, and INS_AUX_INSTANCES, up to 2 (AP_InertialSensor_config.h); @Range of ACCOFFS and ACCSCAL in
# AP_InertialSensor.cpp.
ARDUPILOT = FlightStack(name="ArduPilot", instances=5, offset_range=(-3.5, 3.5), scale_range=(0.8, 1.2))
REFERENCE_DEGC = 35.0
"""TEMP_REFERENCE in AP_InertialSensor_tempcal.cpp."""
_UNIT = 1e6  # INV_SCALE_FACTOR there: numbers a person can type.


def export(job: Job) -> Draft:
    """Return the parameters of one accelerometer and gyroscope; raises as ``FlightStack.fit``."""
    fit, options, instance = ARDUPILOT.fit(job), job.options, job.options.instance
    # The names grew with the program: INS_ACC, INS_ACC2, INS_ACC3, and from the fourth on INS4_ACC, INS5_ACC.
    group = "INS" if instance < 3 else f"INS{instance + 1}"
    digit = str(instance + 1) if instance in (1, 2) else ""
    vectors = {"OFFS_%s": fit.offset, "SCAL_%s": fit.scale}
    values = triad_values(f"{group}_ACC{digit}", options.accelerometer_id, vectors)
    if fit.rate_offset is not None:
        values |= triad_values(f"{group}_GYR{digit}", options.gyroscope_id, {"OFFS_%s": fit.rate_offset})
    calibrated_degc = float(np.mean(job.parameters.context.session.temperature_degc))
    if fit.thermal is not None:
        # Exactly there the offset over temperature is zero.
        calibrated_degc = fit.thermal.reference_degc
    if not np.isnan(calibrated_degc):
        # Of the first, these alone have its number (AP_InertialSensor.cpp, ``_ACC1_CALTEMP``).
        own = "1" if instance == 0 else digit
        triads = ["ACC"] if fit.rate_offset is None else ["ACC", "GYR"]
        values |= {f"{group}_{triad}{own}_CALTEMP": calibrated_degc for triad in triads}
    if fit.thermal is not None:
        values |= _over_temperature(fit.thermal, instance)
    notes = []
    if names := names_without_value(values):
        notes.append(sentence("ardupilot.no_id", names=names, options=fit.ids_to_set(job)))
    notes += [sentence("ardupilot.frame"), sentence("flight_stack.single_precision", program=ARDUPILOT.name)]
    notes.append(sentence("ardupilot.replaces"))
    if fit.rate_offset is not None:
        notes.append(sentence("ardupilot.learns"))
    if not np.any(fit.offset):
        notes.append(sentence("ardupilot.not_calibrated"))
    if fit.thermal is not None:
        notes.append(sentence("thermal.ardupilot_order"))
    lines = [f"{name},{format_value(value)}" for name, value in known_values(values).items()]
    files = {"ardupilot.param": text_file([*comment(job.heading()), *lines])}
    return fit.draft(files, sentence("flight_stack.lacks"), tuple(notes))


def _over_temperature(thermal: ThermalOffsets, instance: int) -> Values:
    """Return the polynomials about 35 degC, times 1e6."""
    start = f"INS_TCAL{instance + 1}" if instance < 3 else f"INS{instance + 1}_TCAL"
    values: Values = {f"{start}_ENABLE": 1}
    values |= {f"{start}_TMIN": thermal.range_degc[0], f"{start}_TMAX": thermal.range_degc[1]}
    for triad, coefficients in thermal.coefficients.items():
        about = np.array([_about(column, REFERENCE_DEGC - thermal.reference_degc) for column in coefficients.T])
        for power, row in enumerate(in_single_precision(_UNIT * about).T, start=1):
            name = "ACC" if triad == "accelerometer" else "GYR"
            values |= {f"{start}_{name}{power}_{axis}": float(value) for axis, value in zip("XYZ", row, strict=True)}
    return values


def _about(coefficients: FloatArray, shift_degc: float) -> FloatArray:
    """Return the coefficients of powers of ``d - shift`` but the constant, for those of d, d^2, d^3."""
    expanded = Polynomial([0.0, *coefficients])(Polynomial([shift_degc, 1.0]))
    about = np.zeros(ORDER)
    # NumPy may leave out last coefficients that are zero.
    about[: len(expanded.coef) - 1] = expanded.coef[1:]
    return about
