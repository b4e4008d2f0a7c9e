"""Effects beyond the error model of an instrument: what a calibration does not fit, one field each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.samples import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Effects:
    """What an instrument does beside its error model; by default nothing.

    A turn-on adds a constant to the bias, drawn at every power-on from a normal distribution with this 1 sigma, independently
    in each axis: ``b = b_0 + u``, ``u ~ N(0, s^2)`` [1]_.

    References
    ----------
    .. [1] IEEE Std 528-2019, "Standard for Inertial Sensor Terminology": turn-on to turn-on repeatability of bias.
    """

    turn_on_m_s2: float = 0.0
    """Turn-on of the accelerometer's bias, 1 sigma of each axis."""
    turn_on_rad_s: float = 0.0
    """Turn-on of the gyroscope's bias, 1 sigma of each axis."""

    def draw_turn_on(self, rng: np.random.Generator) -> FloatArray:
        """Return what one power-on adds to the biases, shape (6,): m/s^2 of three axes, then rad/s."""
        sizes = np.repeat([self.turn_on_m_s2, self.turn_on_rad_s], 3)
        drawn: FloatArray = sizes * rng.standard_normal(6)
        return drawn


NO_EFFECTS = Effects()
