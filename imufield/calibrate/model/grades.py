"""Typical figures of instruments of four grades: the one table for the simulator, the uncertainty and the history.

The figures are in ``grades.toml``, which says what each follows. Noise follows the Allan-deviation convention of
IEEE Std 952: a noise density of N gives an Allan deviation of N at 1 s, hence a standard deviation of N sqrt(rate_hz) per
sample; a bias instability of B gives a floor of 0.664 B. Terms of the accelerometer are those of ``aliasing``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import tomli

from imufield.dataclass import dataclass
from imufield.earth import MICRO_G_M_S2, STANDARD_GRAVITY_M_S2
from imufield.errors import UsageError
from imufield.samples import SampleUnits
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_DEG = math.radians(1.0)


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
    turn_on: float
    """Change of the bias from one power-on to another, 1 sigma, SI."""
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
    quadratic: float
    """1 sigma of the accelerometer's K2 / K, g per g^2."""
    cubic: float
    """The same of its cubic term, g per g^3."""
    cross: float
    """Of its cross terms, g per g^2."""
    asymmetry: float
    """Of its scale between the two sides of an axis, half of the difference."""
    scatter_m_s2: float
    """Of a position, beyond the noise within it."""
    g_sensitivity: float
    """1 sigma of each element, rad/s per m/s^2."""
    rate_nonlinearity: float
    """1 sigma of how far the gyroscope's output is off its best straight line, over the full range."""
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
    units: SampleUnits = SampleUnits()  # Frozen, so one default may be shared.


# Units of the file: factor to SI, and what it is divided by afterwards.
_UNITS = {
    "g": (STANDARD_GRAVITY_M_S2, 1.0),
    "ug": (MICRO_G_M_S2, 1.0),
    "m/s/sqrt(h)": (1.0, 60.0),
    "deg": (_DEG, 1.0),
    "deg/g": (_DEG, STANDARD_GRAVITY_M_S2),
    "deg/h": (_DEG / 3600, 1.0),
    "deg/h/g": (_DEG / 3600, STANDARD_GRAVITY_M_S2),
    "deg/sqrt(h)": (_DEG / 60, 1.0),
}


def _in_si(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table of the file with its figures in SI and its triads read."""
    read = dict(figures)
    for name, figure in figures.items():
        if isinstance(figure, dict):
            read[name] = TriadGrade(**_in_si({"turn_on": figure["bias"], **figure}))
        elif isinstance(figure, str):
            number, _, unit = figure.partition(" ")
            read[name] = float(number) * _UNITS[unit][0] / _UNITS[unit][1]
    return read


_TABLES = tomli.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
GRADES = {name: Grade(name=name, **_in_si(figures)) for name, figures in _TABLES.items()}
DEFAULT_GRADE = "mems"
"""Where nobody says which: the uncertainty is rather too large than too small."""


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


def grade_by_noise(triad: Literal["accelerometer", "gyroscope"], noise_density: float) -> Grade:
    """Return the grade whose triad has the nearest noise, SI per sqrt(Hz), as a ratio; infinite: not known, so the worst."""
    noise = max(noise_density, sys.float_info.min)

    def apart(grade: Grade) -> float:
        return abs(math.log(noise / (grade.gyroscope if triad == "gyroscope" else grade.accelerometer).noise_density))

    # Where all are as far, the first counts.
    return min(reversed(GRADES.values()), key=apart)
