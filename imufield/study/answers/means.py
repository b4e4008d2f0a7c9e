"""Sessions of position means, simulated: fast enough for thousands of them, which tell a share of 5 % from one of 6 %.

A mean has the noise of its hold, which its covariance tells, and scatter from hold to hold, which only the residuals tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import predict, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.earth import MICRO_G_M_S2
from imufield.guide.positions import scheme
from imufield.samples import FloatArray, SampleUnits
from imufield.simulate.truth.grades import TrueInstrument

HOLD_S = 10.0
MOVE_S = 4.0
FLICKER_M_S2 = 20 * MICRO_G_M_S2
"""1 sigma of the bias from hold to hold: between the bias instabilities of the grades."""
PLACED_M_S2 = 100 * MICRO_G_M_S2
"""The same of a placed industrial unit."""
_PLACEMENT_RAD = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """One session."""

    observations: Observations
    truth: AccelerometerParameters
    """With the mean bias over the holds."""
    touched: frozenset[str]
    """Names of the holds that were."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanSession:
    """How sessions of one instrument are taken."""

    instrument: TrueInstrument
    gravity_m_s2: float
    """True gravity."""
    order: str = "paper24"
    scatter_m_s2: float = FLICKER_M_S2

    def observe(self, rng: np.random.Generator) -> Observed:
        """Return the means of all holds, after one power-on."""
        unit, effects = self.instrument, self.instrument.effects
        names, up = directions(self.order, rng)
        m, scale = len(up), unit.accelerometer.scale
        start_s = 20.0 + (HOLD_S + MOVE_S) * np.arange(m, dtype=np.float64)
        # A mean of T seconds of white noise with the density N has 1 sigma of N / sqrt(T).
        noise = unit.grade.accelerometer.noise_density / np.sqrt(HOLD_S)
        drift = effects.draw_turn_on(rng)[:3] + effects.warming(start_s + HOLD_S / 2)
        error = drift + np.hypot(noise, self.scatter_m_s2) * rng.standard_normal((m, 3))
        # Placed within a few degrees.
        tilted = up + _PLACEMENT_RAD * rng.standard_normal((m, 3))
        force, touched = effects.touch(self.gravity_m_s2 * tilted / np.linalg.norm(tilted, axis=1)[:, None], rng)
        unknown = np.full((m, 3), np.nan)
        observations = Observations(
            name=names,
            mean_raw=predict(unit.accelerometer, effects.distorted(force, unit.accelerometer.misalignment_rad)) + scale * error,
            covariance_raw=np.broadcast_to(np.diag((scale * noise) ** 2), (m, 3, 3)),
            gyroscope_mean_raw=unknown,
            gyroscope_covariance_raw=np.full((m, 3, 3), np.nan),
            direction=up,
            start_s=start_s,
            duration_s=np.full(m, HOLD_S),
            temperature_degc=np.full(m, 25.0),
            units=SampleUnits(),
        )
        truth = replace(unit.accelerometer, bias_m_s2=unit.accelerometer.bias_m_s2 + drift.mean(axis=0))
        return Observed(observations=observations, truth=truth, touched=frozenset(names[k] for k in touched))


def directions(order: str, rng: np.random.Generator) -> tuple[tuple[str, ...], FloatArray]:
    """Return names and directions of a scheme in its own order, or of "SCHEME, faces first", "in turn" or "shuffled"."""
    name, _, how = order.partition(", ")
    place = scheme(name)
    up, names = place.directions(), [position.name for position in place.positions]
    keys = {
        "": np.arange(len(up)),
        "faces first": np.argsort(np.abs(up).max(axis=1) < 0.99, kind="stable"),
        "in turn": np.argsort([f"{name[:2]}{name[2:]:>3}" for name in names], kind="stable"),
        "shuffled": rng.permutation(len(up)),
    }
    return tuple(names[k] for k in keys[how]), up[keys[how]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a calibration said of itself, and how right that was."""

    verdict: str
    scale: FloatArray
    """Error of each scale over its stated 95 % limit, shape (3,): 1 is the limit."""
    bias: FloatArray
    angle: FloatArray
    bias_error_m_s2: float
    """Largest."""

    @property
    def all(self) -> FloatArray:
        """All nine over their limits."""
        return np.concatenate([self.scale, self.bias, self.angle])


def answer_of(calibration: Calibration, truth: AccelerometerParameters) -> Answer:
    """Compare a calibration with the truth, by numbers that no turn of the frame changes."""
    numbers = intrinsic(to_vector(truth), truth.quadratic_axes)[0]
    found, factor = calibration.intrinsic, calibration.quality.student_factor_95
    bias_error = found.bias_raw - numbers[3:6]
    return Answer(
        verdict=calibration.quality.verdict,
        scale=(found.scale - numbers[:3]) / (factor * found.scale_sigma),
        bias=bias_error / (factor * found.bias_raw_sigma),
        angle=(found.angle_rad - numbers[6:9]) / (factor * found.angle_sigma_rad),
        bias_error_m_s2=float(np.abs(bias_error / truth.scale).max()),
    )
