"""A unit in a trembling hand, noise-free: what its triads say where one of them is late."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.model.rotation import exponential, multiply
from imufield.samples import FloatArray, Samples, SampleUnits, make_samples
from imufield.simulate.truth.motion import Site, sample_motion
from imufield.simulate.truth.motion_pieces import Hand, draw_hand

_Z_UP = np.array([0.0, 1.0, 0.0, 0.0])
"""The local level frame is north, east, down: half a turn about north."""


@dataclass
class HeldUnit:
    """A path for ``sample_motion``: the unit z up, its sensor at the end of an arm."""

    hand: Hand
    lever_arm_m: FloatArray
    late_s: float = 0.0

    def attitude(self, time_s: FloatArray) -> FloatArray:
        return multiply(_Z_UP, exponential(self.hand.rotation(time_s - self.late_s)))

    def acceleration(self, time_s: FloatArray) -> FloatArray:
        return self.hand.acceleration(time_s - self.late_s)

    def resting_attitude(self, start_s: float, end_s: float) -> None:
        return None

    def samples(self, rate_hz: float, duration_s: float, delay_s: float) -> Samples:
        """Return what the unit says if its gyroscope is late by ``delay_s``, to any fraction of a sample."""
        span = (1000, round(rate_hz * duration_s), 1 / rate_hz)
        prompt = sample_motion(self, *span, site=Site())
        late = sample_motion(replace(self, late_s=delay_s), *span, site=Site())
        return make_samples(prompt.time_s, prompt.specific_force, late.angular_rate, units=SampleUnits())


def trembling(seed: int, tremor_hz: float, tremor_deg: float, sway_deg: float) -> Hand:
    """Return a hand with one sine of tremor about each axis, rms as given, and the simulator's sway."""
    rng = np.random.default_rng(seed)
    hand = draw_hand(rng, 0.0, math.radians(sway_deg), 0.0, tremor_band_hz=(8.0, 12.0))
    amplitude, hz = hand.rotation_rad.copy(), hand.rotation_hz.copy()
    amplitude[0], hz[0] = math.radians(tremor_deg) * math.sqrt(2), tremor_hz + rng.uniform(-0.15, 0.15, 3)
    return replace(hand, rotation_rad=amplitude, rotation_hz=hz)
