"""Observations: what was measured at each position, the only input of the solvers."""

from __future__ import annotations

from dataclasses import dataclass

from imufield.samples import FloatArray, SampleUnits


@dataclass(frozen=True, slots=True)
class Observations:
    """m observations.

    Attributes
    ----------
    name : tuple of str, length m
    mean_raw : ndarray, shape (m, 3)
        Mean accelerometer output as rate, raw unit.
    covariance_raw : ndarray, shape (m, 3, 3)
        Covariance of that mean, autocorrelation allowed for.
    gyroscope_mean_raw : ndarray, shape (m, 3)
        NaN where there is no gyroscope.
    gyroscope_covariance_raw : ndarray, shape (m, 3, 3)
    direction : ndarray, shape (m, 3)
        Planned direction of "up" in the body frame (unit vector); NaN where no position was planned.
    start_s, duration_s, temperature_degc : ndarray, shape (m,)
        Sample clock; NaN where not known.
    units : SampleUnits
    """

    name: tuple[str, ...]
    mean_raw: FloatArray
    covariance_raw: FloatArray
    gyroscope_mean_raw: FloatArray
    gyroscope_covariance_raw: FloatArray
    direction: FloatArray
    start_s: FloatArray
    duration_s: FloatArray
    temperature_degc: FloatArray
    units: SampleUnits

    def __len__(self) -> int:
        return len(self.name)
