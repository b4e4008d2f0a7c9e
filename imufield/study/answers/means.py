"""Sessions of position means, simulated: fast enough for thousands of them, which tell a share of 5 % from one of 6 %.

A mean has the noise of its hold, which its covariance tells, and scatter from hold to hold, which only the residuals tell.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from imufield.calibrate.accelerometer.accelerometer import calibrate_accelerometer
from imufield.calibrate.model.coverage_factors import degrees_of_freedom, student_factor
from imufield.calibrate.model.gauge import intrinsic
from imufield.calibrate.model.models import predict, to_vector
from imufield.calibrate.model.observations import Observations, leave_out
from imufield.calibrate.model.result import AccelerometerParameters, Calibration
from imufield.calibrate.model.rotation import unit_vectors
from imufield.dataclass import dataclass, replace
from imufield.deliver.parameters.gauge_free import GaugeFree, gauge_free
from imufield.earth import MICRO_G_M_S2, MILLI_G_M_S2, STANDARD_GRAVITY_M_S2, Gravity
from imufield.guide.positions import scheme
from imufield.samples import FloatArray, SampleUnits
from imufield.simulate.truth.grades import TrueInstrument

KNOWN = Gravity(gravity_m_s2=STANDARD_GRAVITY_M_S2, sigma_m_s2=1e-6, source="measured")
HOLD_S = 10.0
MOVE_S = 4.0
FLICKER_M_S2 = 20 * MICRO_G_M_S2
"""1 sigma of the bias from hold to hold: between the bias instabilities of the grades."""
PLACED_M_S2 = 100 * MICRO_G_M_S2
"""The same of a placed industrial unit."""
_PLACEMENT_RAD = 0.03
_FOUR_SIGMA = 6.3e-5  # Chance that a normal number is beyond 4 sigma.


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a calibration said of itself, and how right that was."""

    over_limit: FloatArray
    """Errors of scale, bias, angles and quadratic terms over their stated 95 % limits, NaN where there is none, shape (12,)."""
    four_sigma: float
    """What 4 normal sigma are, over the 95 % limit."""
    bias_error_mg: float
    """Largest."""
    calibration: Calibration

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which of scale, bias and angles are inside their limits, shape (9,)."""
        return np.abs(self.over_limit[:9]) <= 1

    @property
    def is_good(self) -> bool:
        """Whether the verdict is good."""
        return self.calibration.quality.verdict == "good"

    @property
    def is_good_and_beyond(self) -> bool:
        """Whether the verdict is good and one of them further off than 4 normal sigma."""
        return self.is_good and bool(np.any(np.abs(self.over_limit[:9]) > self.four_sigma))


def answer_of(calibration: Calibration, truth: AccelerometerParameters) -> Answer:
    """Compare a calibration with the truth, by numbers that no turn of the frame changes."""
    true = intrinsic(to_vector(truth), truth.quadratic_axes)[0]
    own, factor = calibration.intrinsic, calibration.quality.student_factor_95
    error = own.values - true
    return Answer(
        over_limit=error / (factor * own.sigmas),
        four_sigma=student_factor(degrees_of_freedom(factor), chance=_FOUR_SIGMA) / factor,
        bias_error_mg=float(np.abs(error[3:6] / truth.scale).max()) / MILLI_G_M_S2,
        calibration=calibration,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """One session."""

    observations: Observations
    truth: AccelerometerParameters
    """With the mean bias over the holds."""
    touched: frozenset[str]
    """Names of the holds that were."""

    def answer(self, gravity: Gravity, *, grade: str | None = None, without: Collection[str] = ()) -> Answer:
        """Calibrate, some holds left out."""
        kept = leave_out(self.observations, without)[0]
        return answer_of(calibrate_accelerometer(kept, gravity, grade=grade), self.truth)


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
        force, touched = effects.touch(self.gravity_m_s2 * unit_vectors(tilted), rng)
        unknown = np.full((m, 3), np.nan)
        observations = Observations(
            name=names,
            mean_raw=predict(unit.accelerometer, effects.distorted(force, unit.accelerometer.misalignment_rad)) + scale * error,
            covariance_raw=np.broadcast_to(np.diag((scale * noise) ** 2), (m, 3, 3)),
            gyroscope_mean_raw=unknown,
            gyroscope_covariance_raw=np.full((m, 3, 3), np.nan),
            gyroscope_rounding_raw=np.zeros((m, 3)),
            gyroscope_noise_raw=unknown,
            direction=up,
            start_s=start_s,
            duration_s=np.full(m, HOLD_S),
            middle_s=np.full(m, np.nan),
            middle_rad=np.zeros((m, 3)),
            temperature_degc=np.full(m, 25.0),
            units=SampleUnits(),
        )
        truth = replace(unit.accelerometer, bias_m_s2=unit.accelerometer.bias_m_s2 + drift.mean(axis=0))
        return Observed(observations=observations, truth=truth, touched=frozenset(names[k] for k in touched))


def without_quadratic(instrument: TrueInstrument) -> TrueInstrument:
    """Return the instrument as the linear model has it."""
    return replace(instrument, accelerometer=replace(instrument.accelerometer, quadratic=np.zeros(3)))


def gauge_free_of(calibration: Calibration, observations: Observations) -> GaugeFree:
    """Return the gauge-free numbers of a calibration from these observations."""
    sigma_raw = np.sqrt(np.diagonal(observations.covariance_raw, axis1=1, axis2=2))
    return gauge_free(calibration, observations.mean_raw, sigma_raw)


def true_gravity(normal: Gravity, rng: np.random.Generator) -> float:
    """Return true gravity at a place, which is off the normal one by an anomaly."""
    return normal.gravity_m_s2 + normal.sigma_m_s2 * float(rng.standard_normal())


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
