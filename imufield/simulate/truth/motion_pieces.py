"""Pieces of hand motion: turns, rests, holds and shocks, each a closed function of time.

The attitude in a piece is ``q0 exp(turn * s) exp(w)``: ``s`` is the minimum-jerk profile 10 u^3 - 15 u^4 + 6 u^5 of the
piece's relative time u, and ``w`` is a small rotation vector: hand tremor and sway, a wobble that vanishes at both ends
with its first two derivatives, and the ring-down of shocks. Linear accelerations of the pivot are analytic too.

References
----------
.. [1] T. Flash, N. Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985): minimum jerk.
.. [2] R. J. Elble, W. C. Koller, "Tremor", 1990: physiological tremor of the hand, 8 to 12 Hz.
.. [3] J. D. Ferry, "Viscoelastic Properties of Polymers", 1980: section 1-C.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imufield.calibrate.model.rotation import exponential, multiply
from imufield.dataclass import dataclass, field
from imufield.guide.stillness.turn_fit import minimum_jerk
from imufield.samples import FloatArray

RING_DECAYS = 12.0
"""Decay times after which a ring-down is cut: 2e-4 of its peak is left there."""
_HAND_FADE = 0.25  # Share of a turn in which the hand takes hold of the unit, or lets go.


@dataclass(frozen=True, slots=True, kw_only=True)
class Shock:
    """Ring-down after a knock: ``amplitude (t/d) exp(1 - t/d) sin(2 pi f t)``."""

    start_s: float
    acceleration: FloatArray
    """Local level frame, shape (3,), m/s^2."""
    rotation_rad: FloatArray
    """Body frame, shape (3,)."""
    frequency_hz: float
    decay_s: float

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + RING_DECAYS * self.decay_s

    def shape(self, time_s: FloatArray) -> FloatArray:
        """Return the unit ring-down, shape (n,)."""
        since = time_s - self.start_s
        ratio = np.clip(since / self.decay_s, 0.0, RING_DECAYS)
        ringing = ratio * np.exp(1 - ratio) * np.sin(2 * math.pi * self.frequency_hz * since)
        return np.where(ratio < RING_DECAYS, ringing, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand:
    """Tremor and sway of a hand: sums of sines of fixed phase.

    Rows of the arrays are sines, columns the axes x, y, z.
    """

    rotation_rad: FloatArray
    """Amplitudes about the body axes, shape (k, 3)."""
    rotation_hz: FloatArray
    rotation_phase: FloatArray
    shift_m: FloatArray
    """Amplitudes along the local level axes, shape (j, 3)."""
    shift_hz: FloatArray
    shift_phase: FloatArray

    def rotation(self, time_s: FloatArray) -> FloatArray:
        """Return the rotation vector, shape (n, 3), rad."""
        return _sines(time_s, self.rotation_rad, self.rotation_hz, self.rotation_phase)

    def acceleration(self, time_s: FloatArray) -> FloatArray:
        """Return the linear acceleration, local level frame, shape (n, 3), m/s^2."""
        # Second derivative of A sin(w t + phase): -A w^2 sin(w t + phase).
        return _sines(time_s, -self.shift_m * (2 * math.pi * self.shift_hz) ** 2, self.shift_hz, self.shift_phase)


def draw_hand(
    rng: np.random.Generator, tremor_rad: float, sway_rad: float, sway_m: float, *, tremor_band_hz: tuple[float, float]
) -> Hand:
    """Draw a hand whose tremor and sway have the given RMS on each axis.

    Sway has 0.1 to 2 Hz (rotation) and 0.1 to 1 Hz (shift), amplitudes falling as 1/f.
    """
    # Six sines of tremor (8 to 12 Hz [2]_) and five each of sway and shift: enough that the sum does not look periodic.
    tremor_hz = _spread(rng, *tremor_band_hz, 6)
    sway_hz = _spread(rng, 0.1, 2.0, 5)
    shift_hz = _spread(rng, 0.1, 1.0, 5)
    # A sine of amplitude A has the RMS A / sqrt(2), so six of them with A = RMS sqrt(2 / 6) have the RMS asked for.
    rotation = np.concatenate([np.full((6, 3), tremor_rad * math.sqrt(2 / 6)), _falling(sway_hz, sway_rad)])
    hz = np.concatenate([tremor_hz, sway_hz])
    phase = rng.uniform(0, 2 * math.pi, (16, 3))
    return Hand(
        rotation_rad=rotation,
        rotation_hz=hz,
        rotation_phase=phase[:11],
        shift_m=_falling(shift_hz, sway_m),
        shift_hz=shift_hz,
        shift_phase=phase[11:],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """Motion from ``start_s`` to ``end_s``; ``end_s`` may be infinite while the operator waits."""

    start_s: float
    end_s: float
    quaternion_nb: FloatArray
    """Attitude at the start, without hand motion."""
    turn_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Rotation made in the piece, body frame."""
    wobble_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Amplitude of the wobble in the middle of a turn."""
    wobble_hz: float = 1.5
    lift_m: float = 0.0
    """Height in the middle of the piece above its ends."""
    travel_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How far the pivot is carried, local level frame."""
    hand: Hand | None = None
    hand_at_start: bool = False
    hand_at_end: bool = False
    shocks: tuple[Shock, ...] = ()
    settling_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Rotation by which a soft support gives way in the end, body frame: ``settling (1 - exp(-t / settling_s))``, the creep of
    a Voigt element under a constant load [3]_."""
    settling_s: float = 1.0

    @property
    def final_quaternion(self) -> FloatArray:
        """Attitude at the end, without hand motion."""
        planned = multiply(self.quaternion_nb, exponential(self.turn_rad))
        return multiply(planned, exponential(self.settling_rad * self._given_way(self.end_s)))

    @property
    def is_rest(self) -> bool:
        """Whether nothing moves at all."""
        moves = np.any(self.turn_rad) or np.any(self.settling_rad)
        return self.hand is None and not self.shocks and self.lift_m == 0 and not moves

    def attitude(self, time_s: FloatArray) -> FloatArray:
        """Return ``quaternion_nb``, shape (n, 4)."""
        u = self._relative(time_s)
        # Body vectors turn by the planned rotation first, then by the small ones: q0 exp(turn s(u)) exp(w).
        planned = multiply(self.quaternion_nb, exponential(minimum_jerk(u)[:, np.newaxis] * self.turn_rad))
        # The bell 64 u^3 (1-u)^3 is 0 at both ends with two derivatives, 1 in the middle.
        small = 64 * (u * (1 - u)) ** 3 * np.sin(2 * math.pi * self.wobble_hz * (time_s - self.start_s))
        rotation = small[:, np.newaxis] * self.wobble_rad
        if self.hand is not None:
            rotation = rotation + self._grip(u)[:, np.newaxis] * self.hand.rotation(time_s)
        if np.any(self.settling_rad):
            rotation = rotation + self._given_way(time_s)[:, np.newaxis] * self.settling_rad
        for shock in self.shocks:
            rotation = rotation + shock.shape(time_s)[:, np.newaxis] * shock.rotation_rad
        return multiply(planned, exponential(rotation))

    def acceleration(self, time_s: FloatArray) -> FloatArray:
        """Return the acceleration of the pivot, local level frame, shape (n, 3), m/s^2."""
        u = self._relative(time_s)
        duration = self.end_s - self.start_s
        acceleration = np.zeros((len(time_s), 3))
        if math.isfinite(duration):
            # Height follows the bell 64 u^3 (1-u)^3, travel the minimum-jerk profile [1]_; both end at rest. These are their
            # second derivatives by u; down is positive in the local level frame, so lifting is negative.
            inner = u * (1 - u)
            bell_curvature = 64 * inner * (6 * (1 - 2 * u) ** 2 - 6 * inner)
            jerk_curvature = 60 * u * (1 + u * (2 * u - 3))
            acceleration[:, 2] -= self.lift_m * bell_curvature / duration**2
            acceleration += np.outer(jerk_curvature, self.travel_m) / duration**2
        if self.hand is not None:
            acceleration += self._grip(u)[:, np.newaxis] * self.hand.acceleration(time_s)
        for shock in self.shocks:
            acceleration += shock.shape(time_s)[:, np.newaxis] * shock.acceleration
        return acceleration

    def _given_way(self, time_s: ArrayLike) -> FloatArray:
        since = np.maximum(np.asarray(time_s, dtype=np.float64) - self.start_s, 0.0)
        return np.asarray(-np.expm1(-since / self.settling_s))

    def _relative(self, time_s: FloatArray) -> FloatArray:
        # Without an end nothing but the hand moves, and the hand does not depend on u.
        if not math.isfinite(self.end_s):
            return np.zeros(len(time_s))
        return (time_s - self.start_s) / (self.end_s - self.start_s)

    def _grip(self, u: FloatArray) -> FloatArray:
        grip = np.ones(len(u))
        if not self.hand_at_start:
            grip *= minimum_jerk(np.clip(u / _HAND_FADE, 0.0, 1.0))
        if not self.hand_at_end:
            grip *= minimum_jerk(np.clip((1 - u) / _HAND_FADE, 0.0, 1.0))
        return grip


def _spread(rng: np.random.Generator, low_hz: float, high_hz: float, count: int) -> FloatArray:
    """Draw one frequency from each of ``count`` equal parts of a band: two nearly equal ones would beat for minutes."""
    part = (np.arange(count)[:, np.newaxis] + rng.random((count, 3))) / count
    return low_hz + (high_hz - low_hz) * part


def _falling(hz: FloatArray, rms: float) -> FloatArray:
    shape = 1 / hz
    amplitudes: FloatArray = rms * shape * np.sqrt(2 / np.sum(shape**2, axis=0))
    return amplitudes


def _sines(time_s: FloatArray, amplitude: FloatArray, hz: FloatArray, phase: FloatArray) -> FloatArray:
    angle = 2 * math.pi * hz * time_s[:, np.newaxis, np.newaxis] + phase
    total: FloatArray = np.einsum("nkc,kc->nc", np.sin(angle), amplitude)
    return total
