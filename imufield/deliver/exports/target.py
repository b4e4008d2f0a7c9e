"""The types that every export shares: the target, the options and the result.

Nothing here imports NumPy: a list of targets is to appear at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from imufield.dataclass import dataclass, field

# Not "preset": a preset is not in the file.
ExportGauge = Literal["lower", "upper", "symmetric"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """One program or form that parameters can be exported to."""

    name: str
    title: str
    holds: str
    """What of the model it can express, in words."""
    module: str
    """Module of this package whose ``export(job)`` writes it."""
    takes: Sequence[str] = ()
    """Options that have an effect, beside the temperature."""
    asks: Mapping[str, str] = field(default_factory=dict)
    """Options that nobody but its user knows and without which it does not use the file, each with what it is there."""
    over_temperature: bool = False
    """Whether it takes bias over temperature; all others get the values at one."""

    @property
    def option_names(self) -> tuple[str, ...]:
        """Fields of ``ExportOptions`` that have an effect."""
        return (*self.takes, *(() if self.over_temperature else ("temperature_degc",)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """What only the user of the target knows. ``--set name=value`` on the command line."""

    gauge: ExportGauge | None = None
    """Body frame for targets that take any (default: the parameter file's)."""
    accelerometer_nominal: float | None = None
    """Raw unit per m/s^2 by which the target's driver divides before it corrects; needed where counts go to an SI target."""
    gyroscope_nominal: float | None = None
    """Raw unit per rad/s, likewise."""
    instance: int = 0
    """Number of the sensor in a flight controller that has several, from 0."""
    accelerometer_id: int | None = None
    """Device ID of a flight controller's accelerometer (CAL_ACC0_ID, INS_ACC_ID)."""
    gyroscope_id: int | None = None
    model: Literal["kalibr", "rpng"] = "kalibr"
    """IMU model of OpenVINS."""
    accelerometer_random_walk: float | None = None
    """Bias random walk, m/s^3/sqrt(Hz), for Kalibr, OpenVINS and Basalt."""
    gyroscope_random_walk: float | None = None
    """rad/s^2/sqrt(Hz)."""
    temperature_degc: float | None = None
    """At which the numbers are to hold where the target knows one temperature only (default: the file's reference)."""
    name: str = "imufield_calibration"
    """Name of the constant in C."""


@dataclass(frozen=True, slots=True)
class Exported:
    """What an export returns; nothing is on disk yet."""

    files: Mapping[str, bytes]
    """Name to content."""
    losses: tuple[str, ...]
    """Sentences with numbers: what of the model the target cannot hold. Empty: it computes the same as ``apply``."""
    notes: tuple[str, ...]
    """Sentences: the frame, and what to mind in the target."""
