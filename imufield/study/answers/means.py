"""Sessions of position means, simulated: fast enough for hundreds of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import predict, to_vector
from imufield.calibrate.model.observations import Observations
from imufield.calibrate.model.result import Calibration
from imufield.earth import MICRO_G_M_S2
from imufield.guide.positions import scheme
from imufield.samples import FloatArray, SampleUnits
from imufield.simulate.truth.effects import NO_EFFECTS, Effects
from imufield.simulate.truth.grades import TrueInstrument

HOLD_S = 10.0
SCATTER_M_S2 = 100 * MICRO_G_M_S2
"""1 sigma between holds, each axis: what a placed industrial unit shows."""
_PLACEMENT_RAD = 0.03


def observe(
    truth: TrueInstrument, gravity_m_s2: float, rng: np.random.Generator, effects: Effects = NO_EFFECTS
) -> tuple[Observations, frozenset[str]]:
    """Return a session of paper24, and the names of the holds that were touched.

    The noise of each mean is known to the calibration, the scatter between holds is not.
    """
    place, accelerometer = scheme("paper24"), truth.accelerometer
    up = place.directions() + _PLACEMENT_RAD * rng.standard_normal((len(place), 3))
    force = gravity_m_s2 * up / np.linalg.norm(up, axis=1)[:, None]
    # White noise of density D over T seconds: a mean has D / sqrt(T).
    within = truth.grade.accelerometer.noise_density / np.sqrt(HOLD_S)
    force += np.hypot(within, SCATTER_M_S2) * rng.standard_normal(force.shape)
    force, touched = effects.touch(force, rng)
    m = len(place)
    names = tuple(position.name for position in place.positions)
    observations = Observations(
        name=names,
        mean_raw=predict(accelerometer, force),
        covariance_raw=np.broadcast_to(np.diag((within * accelerometer.scale) ** 2), (m, 3, 3)),
        gyroscope_mean_raw=np.full((m, 3), np.nan),
        gyroscope_covariance_raw=np.full((m, 3, 3), np.nan),
        direction=place.directions(),
        start_s=(HOLD_S + 4.0) * np.arange(m, dtype=np.float64),
        duration_s=np.full(m, HOLD_S),
        temperature_degc=np.full(m, np.nan),
        units=SampleUnits(),
    )
    return observations, frozenset(names[k] for k in touched)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a calibration said of itself, and how right that was."""

    verdict: str
    scale: FloatArray
    """Error of each scale over its stated 95 % limit, shape (3,): 1 is the limit."""
    bias: FloatArray
    bias_error_m_s2: float
    """Largest."""


def answer_of(calibration: Calibration, truth: TrueInstrument) -> Answer:
    """Compare a calibration with the truth, by numbers that no turn of the frame changes."""
    numbers = intrinsic(to_vector(truth.accelerometer), truth.accelerometer.quadratic_axes)[0]
    found, factor = calibration.intrinsic, calibration.quality.student_factor_95
    bias_error = found.bias_raw - numbers[3:6]
    return Answer(
        verdict=calibration.quality.verdict,
        scale=(found.scale - numbers[:3]) / (factor * found.scale_sigma),
        bias=bias_error / (factor * found.bias_raw_sigma),
        bias_error_m_s2=float(np.abs(bias_error / truth.accelerometer.scale).max()),
    )
