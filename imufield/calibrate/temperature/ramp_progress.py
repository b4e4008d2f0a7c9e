"""How far a ramp has come while it is recorded: its temperature, how fast that changes, and what one pose has covered."""

from __future__ import annotations

import math

import numpy as np

from imufield.calibrate.temperature.ramp import LEAST_SPAN_DEGC, RATE_OVER_S, TOO_FAST_DEGC_PER_MIN, moved_windows
from imufield.dataclass import dataclass
from imufield.samples import FloatArray

EVEN_DEGC_PER_MIN = 0.1
"""A twentieth of the fastest: over 60 s what a thermometer with steps of 0.1 degC can show."""
EVEN_FOR_S = 300.0
"""So long it must stay below: the inside of a unit follows its case by minutes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RampProgress:
    """What windows of a ramp show so far."""

    temperature_degc: float
    degc_per_min: float
    """Over the last minute; NaN before there is one."""
    low_degc: float
    high_degc: float
    """Covered since the instrument was moved last."""
    moved_s: float
    """When that was; NaN where it never was."""
    is_even: bool

    @property
    def span_degc(self) -> float:
        """Covered in this pose."""
        return self.high_degc - self.low_degc

    @property
    def is_too_fast(self) -> bool:
        """Whether sensor and thermometer differ by now."""
        return abs(self.degc_per_min) > TOO_FAST_DEGC_PER_MIN

    @property
    def is_enough(self) -> bool:
        """Whether a ramp can be made of it."""
        return self.span_degc >= LEAST_SPAN_DEGC


def ramp_progress(time_s: FloatArray, temperature_degc: FloatArray, force: FloatArray) -> RampProgress | None:
    """Return how far a ramp has come by its windows, shapes (n,), (n,) and (n, 3); None before the first temperature."""
    known = np.isfinite(temperature_degc)
    time_s, temperature_degc, force = time_s[known], temperature_degc[known], force[known]
    if not len(time_s):
        return None
    moved = moved_windows(force)
    here_degc = temperature_degc[moved[-1] + 1 :] if len(moved) else temperature_degc
    return RampProgress(
        temperature_degc=float(temperature_degc[-1]),
        degc_per_min=_degc_per_min(time_s, temperature_degc, RATE_OVER_S),
        low_degc=float(here_degc.min()),
        high_degc=float(here_degc.max()),
        moved_s=float(time_s[moved[-1] + 1]) if len(moved) else math.nan,
        is_even=abs(_degc_per_min(time_s, temperature_degc, EVEN_FOR_S)) < EVEN_DEGC_PER_MIN,
    )


def _degc_per_min(time_s: FloatArray, temperature_degc: FloatArray, over_s: float) -> float:
    """Return the slope of the last ``over_s``; NaN before that time has passed."""
    last = time_s > time_s[-1] - over_s
    if time_s[-1] - time_s[0] < over_s or last.sum() < 3:
        return math.nan
    t, x = time_s[last] - time_s[last].mean(), temperature_degc[last]
    return float(60 * (t @ x) / (t @ t))
