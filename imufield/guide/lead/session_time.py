"""How long a session takes until it is as good as wanted, told before it begins.

The guide's own fit is asked for its forecast, position by position in the order in which the guide asks for them, of an
instrument without errors. What is not known yet is said by who asks: the noise, and by how much positions differ beyond it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imufield.calibrate.accelerometer.drift import MOST_CONFUSION, order_confusion
from imufield.guide.cross_checks.running_fit import LINEAR, RunningFit, running_fit
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import Position, Scheme
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences

sentence = Sentences(__package__)

BETWEEN_S = 7.0
"""From one hold to the next: what a person needs to turn the unit, lay it down, let go of it, and have it settle."""
BEGIN_S = 10.0
"""Until the first hold: three seconds of it are the noise floor."""
# A position is proposed before its turn where its gain is larger by this factor: the order that drift cannot imitate is worth
# more than a little gain.
_CLEARLY_MORE = 1.5
_UNITS = {"bias_ug": "ug", "scale_ppm": "ppm"}


@dataclass(frozen=True, slots=True)
class _Mean:
    """What a hold of a perfect instrument would show."""

    name: str
    mean_raw: FloatArray
    covariance_raw: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionTime:
    """The time that a session takes, and what it is for.

    Attributes
    ----------
    hold_s : float
        Of each position.
    positions, planned : int
        Measured when the target is reached, all where it is not; of the scheme.
    minutes : float
        In all, the turns between included.
    forecast : dict of float
        1 sigma of the groups of parameters then, as ``RunningFit.forecast``.
    wanted : dict of float
        Of these groups; empty without a target.
    """

    hold_s: float
    positions: int
    planned: int
    minutes: float
    forecast: dict[str, float]
    wanted: dict[str, float]

    @property
    def is_met(self) -> bool:
        """Whether the target is reached."""
        return is_met(self.wanted, self.forecast)

    @property
    def words(self) -> Sentence:
        """The whole in a sentence."""
        known = [
            f"{name.partition('_')[0]} {self.forecast.get(name, math.inf):.3g} {unit}"
            + (f" (wanted {self.wanted[name]:g})" if name in self.wanted else "")
            for name, unit in _UNITS.items()
        ]
        reached = "session_time.met" if self.is_met else "session_time.unmet"
        sizes = {"positions": self.positions, "hold_s": self.hold_s, "minutes": self.minutes}
        return sentence(reached if self.wanted else "session_time.free", known=known, **sizes)


def is_met(wanted: dict[str, float], forecast: dict[str, float]) -> bool:
    """Whether a forecast is as good as wanted; where nothing is wanted it is not."""
    return bool(wanted) and all(forecast.get(name, math.inf) <= value for name, value in wanted.items())


def session_time(scheme: Scheme, settings: GuideSettings, *, noise: float, scatter_m_s2: float) -> SessionTime:
    """Return the time that a session takes.

    Parameters
    ----------
    scheme : Scheme
    settings : GuideSettings
    noise : float
        White noise of the accelerometer, m/s^2 per sqrt(Hz).
    scatter_m_s2 : float
        Between positions, beyond that noise.
    """
    hold_s = settings.hold_target.expected_s(noise)
    covariance = noise**2 / hold_s * np.eye(3)
    left, done = [*scheme.positions], list[Position]()
    forecast: dict[str, float] = {}
    while left and not (len(done) >= LINEAR and is_met(settings.targets, forecast)):
        done.append(left.pop(0))
        means = [_Mean(each.name, settings.gravity_m_s2 * each.direction, covariance) for each in done]
        fit = running_fit(means, RoughScale(1.0), settings.gravity_m_s2)
        if fit is None:
            continue
        forecast = fit.with_scatter(scatter_m_s2).forecast()
        if len(left) > 1:
            directions = [np.array([each.direction for each in some]) for some in (done, left)]
            left.insert(0, left.pop(next_best(fit, *directions, hurried=bool(settings.targets))))
    # Whoever finishes early leaves out the first position, which is otherwise asked for again at the end.
    holds = len(done) + int(settings.revisit_first and not left)
    return SessionTime(
        hold_s=hold_s,
        positions=len(done),
        planned=len(scheme),
        minutes=(BEGIN_S + holds * (hold_s + BETWEEN_S)) / 60,
        forecast=forecast,
        wanted=settings.targets,
    )


def next_best(fit: RunningFit, done: FloatArray, left: FloatArray, *, hurried: bool) -> int:
    """Return which of the positions that are left is asked for next: the first, or one that helps clearly more.

    Parameters
    ----------
    fit : RunningFit
        Of those that are done.
    done, left : ndarray, shape (m, 3), (n, 3)
        Directions of up, unit vectors.
    hurried : bool
        Somebody with a target wants to be there soon.
    """
    gain = fit.gain(left)
    best = int(np.argmax(gain))
    if gain[best] <= (1.0 if hurried else _CLEARLY_MORE) * gain[0]:
        return 0
    order = np.concatenate([done, left[best : best + 1], np.delete(left, best, axis=0)])
    return best if order_confusion(order) <= MOST_CONFUSION else 0
