"""The drawing of one instrument of a grade (``calibrate.model.grades``)."""

from __future__ import annotations

import numpy as np

from imufield.calibrate.model.grades import GRADES, Grade, find_grade
from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.dataclass import dataclass
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.samples import FloatArray
from imufield.simulate.truth.effects import NO_EFFECTS, Effects

# Of the instrument that is drawn, under one address.
__all__ = ["GRADES", "TACTICAL", "Grade", "TrueInstrument", "draw_truth", "find_grade", "perfect_instrument"]

TACTICAL = GRADES["tactical"]

REFERENCE_TEMPERATURE_DEGC = 25.0
"""The parameters of an instrument hold at this temperature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueInstrument:
    """One IMU: its true parameters at the reference temperature, and the figures of its grade for the noise."""

    grade: Grade
    accelerometer: AccelerometerParameters
    gyroscope: GyroscopeParameters
    accelerometer_bias_per_degc: FloatArray
    """Shape (3,), m/s^2 per degree C."""
    accelerometer_scale_per_degc: FloatArray
    """Shape (3,), relative."""
    gyroscope_bias_per_degc: FloatArray
    """Shape (3,), rad/s per degree C."""
    gyroscope_scale_per_degc: FloatArray
    """Shape (3,), relative."""
    clock_error_ppm: float = 0.0
    """Positive: the sample clock is fast, samples come closer than nominal."""
    triad_delay_s: float = 0.0
    """Delay of the gyroscope behind the accelerometer; negative where the accelerometer is late."""
    effects: Effects = NO_EFFECTS
    """What it does beside its error model."""


def draw_truth(grade: Grade, rng: np.random.Generator) -> TrueInstrument:
    """Draw one instrument of a grade, every parameter normally distributed about its nominal value."""
    # The order of the draws is fixed: a seed stands for one instrument.
    a, g = grade.accelerometer, grade.gyroscope
    accelerometer_scale = grade.accelerometer_scale * (1 + 1e-6 * a.scale_ppm * rng.standard_normal(3))
    accelerometer = AccelerometerParameters(
        scale=accelerometer_scale,
        bias_m_s2=a.bias * rng.standard_normal(3),
        misalignment_rad=_draw_off_diagonals(a.misalignment_rad, rng),
        # K2 / K is given in g per g^2: one division by g makes it 1 / (m/s^2).
        quadratic=accelerometer_scale * (grade.quadratic / STANDARD_GRAVITY_M_S2) * rng.standard_normal(3),
    )
    gyroscope_scale = grade.gyroscope_scale * (1 + 1e-6 * g.scale_ppm * rng.standard_normal(3))
    gyroscope = GyroscopeParameters(
        gyroscope_scale,
        _draw_off_diagonals(g.misalignment_rad, rng),
        gyroscope_scale * g.bias * rng.standard_normal(3),
        gyroscope_scale[:, np.newaxis] * grade.g_sensitivity * rng.standard_normal((3, 3)),
    )
    return TrueInstrument(
        grade=grade,
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        accelerometer_bias_per_degc=a.bias_per_degc * rng.standard_normal(3),
        accelerometer_scale_per_degc=1e-6 * a.scale_ppm_per_degc * rng.standard_normal(3),
        gyroscope_bias_per_degc=g.bias_per_degc * rng.standard_normal(3),
        gyroscope_scale_per_degc=1e-6 * g.scale_ppm_per_degc * rng.standard_normal(3),
        clock_error_ppm=grade.clock_error_ppm * float(rng.standard_normal()),
        triad_delay_s=grade.triad_delay_s * float(rng.random()),
    )


def perfect_instrument(grade: Grade) -> TrueInstrument:
    """Return an instrument without parameter errors; the noise is the grade's."""
    zero, none = np.zeros(3), np.zeros((3, 3))
    return TrueInstrument(
        grade=grade,
        accelerometer=AccelerometerParameters(
            scale=np.full(3, grade.accelerometer_scale), bias_m_s2=zero, misalignment_rad=none
        ),
        gyroscope=GyroscopeParameters(np.full(3, grade.gyroscope_scale), none, zero, none),
        accelerometer_bias_per_degc=zero,
        accelerometer_scale_per_degc=zero,
        gyroscope_bias_per_degc=zero,
        gyroscope_scale_per_degc=zero,
    )


def _draw_off_diagonals(sigma: float, rng: np.random.Generator) -> FloatArray:
    # The diagonal of T is 1; the scale factors carry what it would say.
    return sigma * rng.standard_normal((3, 3)) * (1 - np.eye(3))
