"""Rough scale of raw units before the calibration, enough to recognise sides and to state limits in SI."""

from __future__ import annotations

import numpy as np

from imufield.acquire.protocol.units import nominal_scale
from imufield.dataclass import dataclass, field, replace
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray, SampleUnits


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughScale:
    """Rough raw rates per SI unit; None where not known.

    Attributes
    ----------
    accelerometer, gyroscope : float or None
        Raw unit (per second for increments) per m/s^2 and per rad/s, one for all axes.
    raw_zero : ndarray, shape (3,)
        Raw output of the accelerometer at zero input, as a rate; subtracted first.
    learned : bool
        Whether the accelerometer's scale comes from the first still (its norm is g) and not from the instrument's data.
    centred : bool
        Whether the stills so far have shown the offset: no large one is left beside ``raw_zero``.
    """

    accelerometer: float | None = None
    gyroscope: float | None = None
    raw_zero: FloatArray = field(default_factory=lambda: np.zeros(3))
    learned: bool = False
    centred: bool = False

    @classmethod
    def of_units(cls, units: SampleUnits) -> RoughScale:
        """Return the scale of the units' names alone."""
        return cls(accelerometer=nominal_scale(units.accelerometer), gyroscope=nominal_scale(units.gyroscope))

    @property
    def triads(self) -> tuple[tuple[str, str, float], tuple[str, str, float]]:
        """Name, unit and raw rate per unit of both triads, for people: in the raw unit where the scale is not known."""
        force: tuple[str, float] = ("m/s^2", self.accelerometer) if self.accelerometer else ("raw unit", 1.0)
        rate: tuple[str, float] = ("rad/s", self.gyroscope) if self.gyroscope else ("raw unit", 1.0)
        return ("accelerometer", force[0], force[1]), ("gyroscope", rate[0], rate[1])

    def per_axis(self, accelerometer_m_s2: float, gyroscope_rad_s: float, *, missing: float) -> FloatArray:
        """Return SI amounts in raw units, shape (6,), ``missing`` where the scale is not known."""
        accelerometer = missing if self.accelerometer is None else accelerometer_m_s2 * self.accelerometer
        gyroscope = missing if self.gyroscope is None else gyroscope_rad_s * self.gyroscope
        return np.repeat([accelerometer, gyroscope], 3)

    def learn(self, mean_raw: FloatArray) -> RoughScale:
        """Return a scale whose accelerometer is known: unchanged, or from a still mean (3,) whose norm counts as g."""
        if self.accelerometer is not None:
            return self
        norm = float(np.linalg.norm(mean_raw - self.raw_zero))
        return replace(self, accelerometer=norm / STANDARD_GRAVITY_M_S2, learned=True) if norm > 0 else self

    def is_zero(self, mean_raw: FloatArray) -> bool:
        """Whether a mean, shape (3,), is no force at all, which has no direction: a dead accelerometer, or free fall."""
        return not np.any(mean_raw - self.raw_zero)

    def specific_force(self, mean_raw: FloatArray) -> FloatArray:
        """Return raw accelerometer rates, shape (..., 3), as rough m/s^2; the scale must be known."""
        if self.accelerometer is None:
            raise ValueError("the accelerometer's rough scale is not known yet: call `learn` with a still mean")
        return (mean_raw - self.raw_zero) / self.accelerometer

    def up(self, mean_raw: FloatArray) -> FloatArray:
        """Return the direction of up in the body frame from raw accelerometer rates (3,): a unit vector; NaN in free fall."""
        force = self.specific_force(mean_raw)
        norm = np.linalg.norm(force)
        return force / norm if norm > 0 else np.full(3, np.nan)
