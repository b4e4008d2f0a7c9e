"""What PX4 and ArduPilot have in common: scale and bias of the accelerometer, bias of the gyroscope, nothing else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imufield.deliver.exports.conventions import Corrections, diagonal_corrections
from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job
from imufield.samples import FloatArray


class FlightStack(NamedTuple):
    """``a = (in - offset) .* scale``, ``w = in - gyroscope_offset``, all in SI."""

    corrections: Corrections
    """The same of raw output in its own unit, for the measurement of what is lost."""
    offset: FloatArray
    scale: FloatArray
    gyroscope_offset: FloatArray | None


class ParameterNames(NamedTuple):
    """How a program calls the values of a triad; ``%s`` stands for X, Y, Z."""

    device_id: str
    temperature: str
    offset: str
    scale: str = ""


def flight_stack(job: Job) -> FlightStack:
    """Return scale and bias.

    Raises
    ------
    ParameterFileError
        If an axis is reversed: these programs know positive scales only.
    """
    corrections = diagonal_corrections(job.parameters.calibration)
    si = job.in_si(corrections)
    scale = np.diag(si.accelerometer.matrix)
    job.require_positive("accelerometer", scale)
    gyroscope_offset = None if si.gyroscope is None else si.gyroscope.offset
    return FlightStack(job.gyroscope_bias_only(corrections), si.accelerometer.offset, scale, gyroscope_offset)


def parameter_values(
    job: Job, stack: FlightStack, accelerometer: ParameterNames, gyroscope: ParameterNames
) -> dict[str, int | float]:
    """Return the value of each parameter by its name: an int for a device ID, a float for all others."""
    values: dict[str, int | float] = {}
    triads = [(accelerometer, job.options.accelerometer_id, [stack.offset, stack.scale])]
    if stack.gyroscope_offset is not None:
        triads.append((gyroscope, job.options.gyroscope_id, [stack.gyroscope_offset]))
    for names, device_id, vectors in triads:
        if device_id is not None:
            values[names.device_id] = device_id
        temperature_degc = job.temperature_degc()
        if temperature_degc is not None:
            values[names.temperature] = temperature_degc
        for name, vector in zip((names.offset, names.scale), vectors, strict=False):
            values |= {name % axis: float(value) for axis, value in zip("XYZ", vector, strict=True)}
    return values


def flight_stack_draft(stack: FlightStack, file_name: str, content: bytes, notes: list[str]) -> Draft:
    """Return the draft of a file with these parameters, with what it lacks."""
    return Draft(
        files={file_name: content},
        target_model=stack.corrections,
        accelerometer_lacks="misalignment cannot be held, scale and bias were refitted",
        gyroscope_lacks=BIAS_ONLY,
        notes=tuple(notes),
    )
