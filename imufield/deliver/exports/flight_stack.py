"""What PX4 and ArduPilot have in common: scale and bias of the accelerometer, bias of the gyroscope, nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from imufield.dataclass import dataclass, replace
from imufield.deliver.exports.conventions import Corrections, diagonal_corrections
from imufield.deliver.exports.job import BIAS_ONLY, Draft, Job, sentence
from imufield.deliver.exports.text import number
from imufield.deliver.exports.thermal import ThermalOffsets
from imufield.errors import ParameterFileError, Reason, UsageError
from imufield.samples import AXES, FloatArray

Values: TypeAlias = dict[str, int | float | None]
"""By the name of the parameter: an int for a device ID, None where it is not known, else a float."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightStack:
    """One of the programs."""

    name: str
    instances: int
    """How many sensors of each kind it has."""
    offset_range: tuple[float, float] = (-np.inf, np.inf)
    scale_range: tuple[float, float]
    """Values of the accelerometer beyond are refused: they are the sign of a wrong unit."""

    def fit(self, job: Job) -> Fit:
        """Return the correction nearest to the calibration.

        Raises
        ------
        ParameterFileError
            If an axis is reversed, as these programs know positive scales only, or a value is outside its range.
        UsageError
            If there is no such sensor.
        """
        if not 0 <= job.options.instance < self.instances:
            most, last = self.instances, self.instances - 1
            refusal = sentence("flight_stack.instance", program=self.name, most=most, last=last, instance=job.options.instance)
            raise UsageError(refusal)
        corrections = diagonal_corrections(job.parameters.calibration)
        si = job.in_si(corrections)
        offset, scale = si.accelerometer.offset, np.diag(si.accelerometer.matrix)
        job.require_positive("accelerometer", scale)
        for what, vector, (low, high) in (("offset", offset, self.offset_range), ("scale", scale, self.scale_range)):
            for axis, value in zip(AXES, vector.tolist(), strict=True):
                if not low <= value <= high:
                    values = {"what": what, "low": low, "high": high, "axis": axis, "value": value}
                    refused = sentence("flight_stack.range", program=self.name, **values)
                    raise ParameterFileError(refused, Reason.BOUNDS)
        return Fit(
            model=job.gyroscope_bias_only(corrections),
            offset=offset,
            scale=scale,
            rate_offset=None if si.gyroscope is None else si.gyroscope.offset,
            thermal=ThermalOffsets(job) if job.parameters.temperature_models else None,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Numbers in SI, as the program takes them."""

    model: Corrections
    """The correction that the program computes from these numbers."""
    offset: FloatArray
    scale: FloatArray
    rate_offset: FloatArray | None
    """None without a gyroscope."""
    thermal: ThermalOffsets | None

    def ids_to_set(self, job: Job) -> str:
        """Return the options that give the device IDs which are not known."""
        ids = {"accelerometer": job.options.accelerometer_id, "gyroscope": job.options.gyroscope_id}
        triads = ["accelerometer"] if self.rate_offset is None else list(ids)
        return " ".join(f"--set {triad}_id=N" for triad in triads if ids[triad] is None)

    def draft(self, files: dict[str, bytes], lacks: str, notes: tuple[str, ...]) -> Draft:
        """Return the export."""
        draft = Draft(files=files, target_model=self.model, accelerometer_lacks=lacks, gyroscope_lacks=BIAS_ONLY, notes=notes)
        return draft if self.thermal is None else replace(draft, losses=self.thermal.loss(draft))


def triad_values(name: str, device_id: int | None, vectors: Mapping[str, FloatArray]) -> Values:
    """Return the parameters of a triad; names of ``vectors`` have a place for the axis."""
    values: Values = {f"{name}_ID": device_id}
    for place, vector in vectors.items():
        values |= {name + place % axis: float(value) for axis, value in zip("XYZ", vector, strict=True)}
    return values


def known_values(values: Values) -> dict[str, int | float]:
    """Return those that are known."""
    return {name: value for name, value in values.items() if value is not None}


def names_without_value(values: Values) -> list[str]:
    """Return the names of those that are not."""
    return [name for name, value in values.items() if value is None]


def format_value(value: float) -> str:
    """Return a value as both programs read it."""
    return str(value) if isinstance(value, int) else number(value)
