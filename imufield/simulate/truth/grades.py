"""Typical errors of instruments of four grades, and the drawing of one instrument of a grade.

The figures are in ``grades.toml``, which says what each follows. Noise follows the Allan-deviation convention of
IEEE Std 952: a noise density of N gives an Allan deviation of N at 1 s, hence a standard deviation of N sqrt(rate_hz) per
sample; a bias instability of B gives a floor of 0.664 B.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imufield.calibrate.model.result import AccelerometerParameters, GyroscopeParameters
from imufield.earth import MICRO_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.samples import FloatArray, SampleUnits
from imufield.sentences import Sentences
from imufield.simulate.truth.effects import NO_EFFECTS, Effects

sentence = Sentences(__package__)

DEG = math.radians(1.0)
DEG_PER_HOUR = DEG / 3600

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


# Units of grades.toml: factor to SI, and what it is divided by afterwards.
_UNITS = {
    "g": (STANDARD_GRAVITY_M_S2, 1.0),
    "ug": (MICRO_G_M_S2, 1.0),
    "m/s/sqrt(h)": (1.0, 60.0),
    "deg": (DEG, 1.0),
    "deg/g": (DEG, STANDARD_GRAVITY_M_S2),
    "deg/h": (DEG_PER_HOUR, 1.0),
    "deg/h/g": (DEG_PER_HOUR, STANDARD_GRAVITY_M_S2),
    "deg/sqrt(h)": (DEG / 60, 1.0),
}


def _in_si(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table of ``grades.toml`` with its figures in SI and its triads read."""
    read = dict(figures)
    for name, figure in figures.items():
        if isinstance(figure, dict):
            read[name] = TriadGrade(**_in_si(figure))
        elif isinstance(figure, str):
            number, _, unit = figure.partition(" ")
            read[name] = float(number) * _UNITS[unit][0] / _UNITS[unit][1]
    return read


_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
GRADES = {name: Grade(name=name, **_in_si(figures)) for name, figures in _TABLES.items()}
TACTICAL = GRADES["tactical"]


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


def find_grade(name: str) -> Grade:
    """Return a grade by name.

    Raises
    ------
    UsageError
        If there is no such grade.
    """
    if name not in GRADES:
        raise UsageError(sentence("grades.no_grade", grade=name, grades=[*GRADES]))
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
