"""What PX4 and ArduPilot have in common: scale and bias of the accelerometer, bias of the gyroscope, nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imufield.deliver.exports.conventions import Correction, Corrections, diagonal_corrections
from imufield.deliver.exports.job import Job
from imufield.samples import FloatArray

LACKS_ACCELEROMETER = "misalignment cannot be held, scale and bias were refitted"
LACKS_GYROSCOPE = "scale and misalignment cannot be held"


class FlightStack(NamedTuple):
    """``a = (in - offset) .* scale``, ``w = in - gyroscope_offset``, all in SI."""

    held: Corrections
    """The same of raw output in its own unit, for the measurement of what is lost."""
    offset: FloatArray
    scale: FloatArray
    gyroscope_offset: FloatArray | None


def flight_stack(job: Job) -> FlightStack:
    """Return scale and bias.

    Raises
    ------
    ParameterFileError
        If an axis is reversed: these programs know positive scales only.
    """
    held = diagonal_corrections(job.parameters.calibration)
    si = job.in_si(held)
    scale = np.diag(si.accelerometer.matrix)
    job.require_positive("accelerometer", scale)
    if held.gyroscope is None or si.gyroscope is None:
        return FlightStack(held, si.accelerometer.offset, scale, None)
    return FlightStack(bias_only_gyroscope(job, held), si.accelerometer.offset, scale, si.gyroscope.offset)


def bias_only_gyroscope(job: Job, corrections: Corrections) -> Corrections:
    """Return corrections whose gyroscope has the nominal scale and no misalignment.

    Raises
    ------
    ParameterFileError
        If an axis of the gyroscope is reversed: a bias cannot turn it.
    """
    if corrections.gyroscope is None:
        return corrections
    job.require_positive("gyroscope", job.gyroscope_si() * np.diag(corrections.gyroscope.matrix))
    gyroscope = Correction(np.eye(3) / job.gyroscope_si(), corrections.gyroscope.offset)
    return replace(corrections.without_g_sensitivity(), gyroscope=gyroscope)
