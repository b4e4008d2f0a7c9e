"""Typical errors of instruments of four grades, and the drawing of one instrument of a grade.

The figures are typical of a grade, rounded; each says what it follows. Noise follows the Allan-deviation convention of
IEEE Std 952: a noise density of N gives an Allan deviation of N at 1 s, hence a standard deviation of N sqrt(rate_hz) per
sample; a bias instability of B gives a floor of 0.664 B.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.earth import MICRO_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.samples import FloatArray, SampleUnits

DEG = math.radians(1.0)
DEG_PER_HOUR = DEG / 3600
DEG_PER_ROOT_HOUR = DEG / 60

REFERENCE_TEMPERATURE_DEGC = 25.0
"""The parameters of an instrument hold at this temperature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadGrade:
    """Typical figures of a triad; SI is m/s^2 for accelerometers and rad/s for gyroscopes."""

    noise_density: float
    """SI per sqrt(Hz)."""
    bias_instability: float
    """SI."""
    random_walk: float
    """SI per sqrt(s): the bias walks by this much in 1 s."""
    bias: float
    """1 sigma, SI."""
    scale_ppm: float
    """1 sigma."""
    misalignment_rad: float
    """1 sigma of each off-diagonal element."""
    bias_per_degc: float
    """1 sigma, SI per degree C."""
    scale_ppm_per_degc: float
    """1 sigma."""
    range_si: float
    """Full scale, plus and minus."""
    lsb_si: float
    """One step of the output; 0 for none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grade:
    """Typical figures of an IMU."""

    name: str
    accelerometer: TriadGrade
    gyroscope: TriadGrade
    quadratic_g_per_g2: float
    """1 sigma of the accelerometer's K2 / K, g per g^2."""
    g_sensitivity: float
    """1 sigma of each element, rad/s per m/s^2."""
    clock_error_ppm: float
    """1 sigma of the sample clock."""
    triad_delay_s: float
    """Largest delay of the gyroscope behind the accelerometer."""
    warm_up_degc: float
    """Rise of temperature after power-on."""
    warm_up_s: float
    """Time constant of that rise."""
    accelerometer_scale: float = 1.0
    """Nominal raw unit per m/s^2."""
    gyroscope_scale: float = 1.0
    """Nominal raw unit per rad/s."""
    units: SampleUnits = SampleUnits()  # noqa: RUF009 - frozen, so one default may be shared


def _triads(**figures: tuple[float, float, float, float]) -> tuple[TriadGrade, ...]:
    """Return the triad of each grade from a table with one row for a figure and one column for a grade."""
    return tuple(TriadGrade(**dict(zip(figures, column, strict=True))) for column in zip(*figures.values(), strict=True))


# Columns of both tables: navigation, tactical, industrial, MEMS.
#
# Navigation: quartz flexure accelerometer (class of Honeywell QA-2000): 70 to 100 ug noise in 10 Hz to 500 Hz, a few ug of
# instability; before calibration 1 mg, 200 ppm and 0.2 mrad remain of the assembly.
# Tactical: STIM300 datasheet, 10 g range: 0.07 m/s/sqrt(h), 50 ug, 2^-19 g per step; bias 0.75 mg from year to year.
# Industrial: better MEMS modules (class of Xsens MTi-100, ADIS16495): 60 ug/sqrt(Hz), 15 ug, left uncalibrated.
# MEMS: consumer chips (class of ICM-20948, MPU-9250): 230 to 300 ug/sqrt(Hz), tens of mg of offset, 16 bit over 4 g.
_ACCELEROMETERS = _triads(
    noise_density=(5 * MICRO_G_M_S2, 0.07 / 60, 60 * MICRO_G_M_S2, 250 * MICRO_G_M_S2),
    bias_instability=(3 * MICRO_G_M_S2, 50 * MICRO_G_M_S2, 15 * MICRO_G_M_S2, 40 * MICRO_G_M_S2),
    random_walk=(0.02 * MICRO_G_M_S2, 1 * MICRO_G_M_S2, 2 * MICRO_G_M_S2, 5 * MICRO_G_M_S2),
    bias=(1000 * MICRO_G_M_S2, 750 * MICRO_G_M_S2, 3000 * MICRO_G_M_S2, 30000 * MICRO_G_M_S2),
    scale_ppm=(200.0, 200.0, 1000.0, 8000.0),
    misalignment_rad=(0.0002, 0.001, 0.003, 0.006),
    bias_per_degc=(5 * MICRO_G_M_S2, 20 * MICRO_G_M_S2, 100 * MICRO_G_M_S2, 500 * MICRO_G_M_S2),
    scale_ppm_per_degc=(5.0, 10.0, 50.0, 200.0),
    range_si=(25 * STANDARD_GRAVITY_M_S2, 10 * STANDARD_GRAVITY_M_S2, 8 * STANDARD_GRAVITY_M_S2, 4 * STANDARD_GRAVITY_M_S2),
    lsb_si=(1e-07, STANDARD_GRAVITY_M_S2 / 2**19, STANDARD_GRAVITY_M_S2 / 2**18, STANDARD_GRAVITY_M_S2 / 8192),
)
# Navigation: ring laser gyroscope: random walk 0.002 deg/sqrt(h), 0.003 deg/h.
# Tactical: STIM300 datasheet: 0.15 deg/sqrt(h), 0.3 deg/h, 400 deg/s, 2^-14 deg/s per step; bias some 10 deg/h after
# temperature.
# Industrial: the modules above: 0.01 deg/s/sqrt(Hz), 10 deg/h, 0.2 deg/s of bias.
# MEMS: the chips above: 0.015 deg/s/sqrt(Hz), about 10 to 20 deg/h, a few deg/s of offset, 16 bit over 500 deg/s.
_GYROSCOPES = _triads(
    noise_density=(0.002 * DEG_PER_ROOT_HOUR, 0.15 * DEG_PER_ROOT_HOUR, 0.01 * DEG, 0.015 * DEG),
    bias_instability=(0.003 * DEG_PER_HOUR, 0.3 * DEG_PER_HOUR, 10 * DEG_PER_HOUR, 15 * DEG_PER_HOUR),
    random_walk=(1e-06 * DEG_PER_HOUR, 0.005 * DEG_PER_HOUR, 0.05 * DEG_PER_HOUR, 0.2 * DEG_PER_HOUR),
    bias=(0.02 * DEG_PER_HOUR, 10 * DEG_PER_HOUR, 0.2 * DEG, 2 * DEG),
    scale_ppm=(10.0, 500.0, 1000.0, 8000.0),
    misalignment_rad=(5e-05, 0.001, 0.003, 0.006),
    bias_per_degc=(0.0005 * DEG_PER_HOUR, 0.5 * DEG_PER_HOUR, 0.002 * DEG, 0.03 * DEG),
    scale_ppm_per_degc=(0.1, 10.0, 50.0, 200.0),
    range_si=(450 * DEG, 400 * DEG, 450 * DEG, 500 * DEG),
    lsb_si=(1e-09, DEG / 2**14, DEG / 2**14, DEG / 65.536),
)
NAVIGATION = Grade(
    name="navigation",
    accelerometer=_ACCELEROMETERS[0],
    gyroscope=_GYROSCOPES[0],
    quadratic_g_per_g2=1.5e-05,  # same class: 10 to 20 ug/g^2
    g_sensitivity=0.0005 * DEG_PER_HOUR / STANDARD_GRAVITY_M_S2,
    clock_error_ppm=1.0,
    triad_delay_s=0.0001,
    warm_up_degc=8.0,
    warm_up_s=1200.0,
)
TACTICAL = Grade(
    name="tactical",
    accelerometer=_ACCELEROMETERS[1],
    gyroscope=_GYROSCOPES[1],
    quadratic_g_per_g2=5e-05,  # 100 ppm of non-linearity over the range, mostly quadratic at small input
    g_sensitivity=1.0 * DEG_PER_HOUR / STANDARD_GRAVITY_M_S2,
    clock_error_ppm=20.0,
    triad_delay_s=0.0005,
    warm_up_degc=10.0,
    warm_up_s=600.0,
)
INDUSTRIAL = Grade(
    name="industrial",
    accelerometer=_ACCELEROMETERS[2],
    gyroscope=_GYROSCOPES[2],
    quadratic_g_per_g2=0.0001,
    g_sensitivity=0.003 * DEG / STANDARD_GRAVITY_M_S2,
    clock_error_ppm=30.0,
    triad_delay_s=0.001,
    warm_up_degc=8.0,
    warm_up_s=400.0,
)
MEMS = Grade(
    name="mems",
    accelerometer=_ACCELEROMETERS[3],
    gyroscope=_GYROSCOPES[3],
    quadratic_g_per_g2=0.0005,
    g_sensitivity=0.01 * DEG / STANDARD_GRAVITY_M_S2,
    clock_error_ppm=100.0,
    triad_delay_s=0.002,
    warm_up_degc=5.0,
    warm_up_s=200.0,
)
GRADES = {grade.name: grade for grade in (NAVIGATION, TACTICAL, INDUSTRIAL, MEMS)}


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


def find_grade(name: str) -> Grade:
    """Return a grade by name.

    Raises
    ------
    UsageError
        If there is no such grade.
    """
    if name not in GRADES:
        raise UsageError(f"there is no grade {name!r}; choose one of {', '.join(GRADES)}", grade=name)
    return GRADES[name]


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
        quadratic=accelerometer_scale * (grade.quadratic_g_per_g2 / STANDARD_GRAVITY_M_S2) * rng.standard_normal(3),
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
    matrix: FloatArray = sigma * rng.standard_normal((3, 3)) * (1 - np.eye(3))
    return matrix
