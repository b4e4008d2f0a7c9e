"""Position means of a session whose bias drifts: the orders and effects that gate and typical errors are tested with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from calibration_truth import edges, faces, observe, outputs, random_parameters, tilted

from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters
from imufield.earth import MICRO_G_M_S2
from imufield.guide.positions import scheme
from imufield.samples import FloatArray

GRAVITY_M_S2 = 9.80665
NOISE_M_S2 = 60 * MICRO_G_M_S2
HOLD_S = 12.0
WARM_UP_S = 120.0


def faces_first() -> FloatArray:
    """Twelve faces, then twelve edges."""
    return np.vstack([faces(2), edges()])


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What happens in one."""

    directions: FloatArray
    quadratic_ug: float = 0.0
    warm_up_ug: float = 0.0
    """How far the bias of each axis goes, with either sign, as the instrument warms up."""
    has_temperature: bool = False
    has_noise_known: bool = True
    placement_deg: float = 5.0
    misalignment_rad: float = 0.008
    """1 sigma of each entry of T."""

    def take(self, rng: np.random.Generator, error_g: FloatArray | None = None) -> tuple[Observations, AccelerometerParameters]:
        """Return the observations, and the parameters with the mean bias over the holds.

        ``error_g`` is the size of what the outputs have beside the error model: |s|, s^3 and six products, of each axis.
        """
        m = len(self.directions)
        start_s = 15.0 * np.arange(m) + np.cumsum(rng.uniform(0, 8, m))
        warm = 1 - np.exp(-(start_s + HOLD_S / 2) / WARM_UP_S)
        drift = self.warm_up_ug * MICRO_G_M_S2 * warm[:, None] * rng.choice([-1.0, 1.0], 3)
        truth = random_parameters(rng, self.quadratic_ug * MICRO_G_M_S2)
        truth = replace(truth, misalignment_rad=self.misalignment_rad * rng.standard_normal((3, 3)) * (1 - np.eye(3)))
        up = tilted(self.directions, rng, np.radians(self.placement_deg))
        force = GRAVITY_M_S2 * up
        more = np.zeros((m, 3))
        if error_g is not None:
            pairs = np.stack([up[:, 0] * up[:, 1], up[:, 0] * up[:, 2], up[:, 1] * up[:, 2]], axis=1)
            more = GRAVITY_M_S2 * (error_g[0] * np.abs(up) + error_g[1] * up**3 + pairs @ error_g[2:].T)
        # Drift and terms beside the model act as the bias does.
        raw = outputs(truth, force) + truth.scale * (drift + more + NOISE_M_S2 * rng.standard_normal((m, 3)))
        covariance = np.broadcast_to(np.diag((truth.scale * NOISE_M_S2) ** 2), (m, 3, 3)) if self.has_noise_known else None
        observations = replace(
            observe(raw, covariance, direction=self.directions),
            start_s=start_s,
            duration_s=np.full(m, HOLD_S),
            temperature_degc=20 + 4 * warm if self.has_temperature else np.full(m, np.nan),
        )
        return observations, replace(truth, bias_m_s2=truth.bias_m_s2 + drift.mean(axis=0))


def proposed(name: str) -> FloatArray:
    """Return the directions of a shipped scheme in its order."""
    return scheme(name).directions()
