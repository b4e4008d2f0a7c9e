"""How long a session takes until it is as good as wanted, told before it begins; and how long its holds must be for that.

The guide's own fit is asked for its forecast, position by position in the order in which the guide asks for them, of an
instrument without errors. What is not known yet is said by who asks: the noise, and by how much positions differ beyond it.

Longer holds need fewer positions. Of all lengths of a hold the one is taken with which the session is shortest
(docs/maths.md, positions).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import cache

import numpy as np

from imufield.calibrate.model.grades import Grade
from imufield.dataclass import dataclass, replace
from imufield.earth import Gravity
from imufield.guide.cross_checks.running_fit import FEWEST, LINEAR, SHOWS_SCATTER, RunningFit, running_fit
from imufield.guide.hold.hold_time import LONGEST_HOLD_S, SHORTEST_S, HoldTarget
from imufield.guide.lead.plan import next_best
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.positions import SCHEMES, Scheme
from imufield.guide.positions import scheme as shipped
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray
from imufield.sentences import Sentence, Sentences, three_digits

sentence = Sentences(__package__)

BETWEEN_S = 7.0
"""From one hold to the next: what a person needs to turn the unit, lay it down, let go of it, and have it settle."""
BEGIN_S = 10.0
"""Until the first hold: three seconds of it are the noise floor."""
# Lengths of a hold that are tried, a tenth apart: the shortest session is hardly shorter between two of them.
_LENGTHS_S = np.geomspace(SHORTEST_S, LONGEST_HOLD_S, 32)
# Of what is wanted: noise and scatter of the session to come are known to a tenth.
_WITH_MARGIN = 0.9
# Of the sigma with the longest holds: what is left is scatter between positions, gravity, or typical of the grade.
_HARDLY_WORSE = 1.05
# Of the figure that is furthest from what is wanted: other positions that hardly help are not worth another session.
_CLEARLY_BETTER = 0.9
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
    hold_s, usual_hold_s : float
        Of each position, and without a target.
    is_fixed : bool
        Somebody fixed the length of the holds.
    helps_s : float
        Longer holds help no more.
    noise : float
        White noise of the accelerometer, m/s^2 per sqrt(Hz).
    positions, planned : int
        Measured when the target is reached, all where it is not; of the scheme.
    minutes : float
        In all, the turns between included.
    forecast : dict of float
        1 sigma of the groups of parameters then, as ``RunningFit.forecast``.
    wanted : dict of float
        Of these groups; empty without a target.
    gravity : Gravity
        Whose uncertainty is in the forecast.
    scheme : str
        Name of the positions.
    better : SessionTime, optional
        With other shipped positions, where these miss the target and others meet it or come clearly nearer.
    """

    hold_s: float
    usual_hold_s: float
    is_fixed: bool
    helps_s: float
    noise: float
    positions: int
    planned: int
    minutes: float
    forecast: dict[str, float]
    wanted: dict[str, float]
    gravity: Gravity
    scheme: str
    better: SessionTime | None = None

    @property
    def is_met(self) -> bool:
        """Whether the target is reached."""
        return is_met(self.wanted, self.forecast, self.positions)

    @property
    def gravity_ppm(self) -> float:
        """1 sigma of the scale by gravity alone."""
        return 1e6 * self.gravity.sigma_m_s2 / self.gravity.gravity_m_s2

    @property
    def hold_target(self) -> HoldTarget:
        """What ends each hold."""
        return HoldTarget.fixed(self.hold_s) if self.is_fixed else HoldTarget.lasting(self.hold_s, self.noise)

    @property
    def words(self) -> Sentence:
        """The whole in a sentence."""
        known = figures(self.forecast, self.wanted, _UNITS)
        sizes = {
            "positions": self.positions,
            "hold_s": self.hold_s,
            "usual_s": self.usual_hold_s,
            "least": SHOWS_SCATTER,
            "checked": LINEAR + 1,
        }
        sizes["minutes"] = max(self.minutes, 1.0)
        if not self.wanted and self.forecast and self.planned <= LINEAR:
            reached = "session_time.free_few"
        elif not self.wanted:
            reached = "session_time.free" if self.forecast else "session_time.nothing"
        elif not self.is_met:
            reached = "session_time.few" if self.planned < SHOWS_SCATTER else "session_time.unmet"
        else:
            reached = "session_time.met_shorter" if self.hold_s < self.usual_hold_s else "session_time.met"
        return sentence(reached, known=known, **sizes)

    @property
    def furthest(self) -> float:
        """The largest forecast as a share of what is wanted."""
        return max((self.forecast.get(name, math.inf) / limit for name, limit in self.wanted.items()), default=0.0)

    @property
    def remedy(self) -> Sentence:
        """What to do where the target is missed."""
        if self.is_met or not self.wanted:
            return sentence("session_time.no_remedy")
        if self.planned < SHOWS_SCATTER:
            return sentence("session_time.few_remedy", least=SHOWS_SCATTER)
        if self.gravity_ppm >= self.wanted.get("scale_ppm", math.inf):
            sizes = {"scale_ppm": self.wanted["scale_ppm"], "gravity_ppm": three_digits(self.gravity_ppm)}
            key = "session_time.height_remedy" if self.gravity.lacks_height else "session_time.gravity_remedy"
            return sentence(key, source=self.gravity.source_words, **sizes)
        if self.is_fixed and self.hold_s < self.helps_s:
            return sentence("session_time.fixed_remedy", helps_s=self.helps_s)
        best = self.better or self
        names = [name for name, limit in self.wanted.items() if not _is_within({name: limit}, best.forecast)]
        missed = figures(best.forecast, self.wanted, names)
        if self.better is None:
            return sentence("session_time.out_of_reach_remedy", missed=missed)
        key = "session_time.positions_remedy" if best.is_met else "session_time.unmet_remedy"
        return sentence(key, scheme=best.scheme, missed=missed, minutes=best.minutes)


def figures(forecast: dict[str, float], wanted: dict[str, float], names: Iterable[str]) -> list[str]:
    """Return what is expected of each accuracy, and wanted, in words."""
    return [
        f"{name.partition('_')[0]} {_known(forecast, name, _UNITS[name])}"
        + (f" (wanted {wanted[name]:g})" if name in wanted else "")
        for name in names
    ]


def _known(forecast: dict[str, float], name: str, unit: str) -> str:
    return f"{three_digits(forecast[name])} {unit}" if name in forecast else sentence("session_time.not_shown")


def is_met(wanted: dict[str, float], forecast: dict[str, float], positions: int) -> bool:
    """Whether a forecast is as good as wanted and enough positions check it; where nothing is wanted it is not."""
    return bool(wanted) and positions >= SHOWS_SCATTER and _is_within(wanted, forecast)


def _is_within(limits: dict[str, float], forecast: dict[str, float]) -> bool:
    return all(forecast.get(name, math.inf) <= limit for name, limit in limits.items())


def session_time(scheme: Scheme, settings: GuideSettings, *, noise: float, grade: Grade) -> SessionTime:
    """Return the time that a session takes: the shortest of those that meet the target, or one of all positions.

    Parameters
    ----------
    scheme : Scheme
    settings : GuideSettings
    noise : float
        White noise of the accelerometer, m/s^2 per sqrt(Hz).
    grade : Grade
        Tells how much positions differ beyond that noise, and what no position shows.
    """
    found = _session_time(scheme, settings, noise=noise, grade=grade)
    # Other positions are no remedy where gravity or short holds are what misses the target.
    if found.remedy.key != "session_time.out_of_reach_remedy":
        return found
    names = [name for name in SCHEMES if name != scheme.name and len(shipped(name)) >= SHOWS_SCATTER]
    others = [_session_time(shipped(name), settings, noise=noise, grade=grade) for name in names]
    if meeting := [other for other in others if other.is_met]:
        return replace(found, better=min(meeting, key=lambda other: other.minutes))
    nearest = min(others, key=lambda other: other.furthest)
    return replace(found, better=nearest) if nearest.furthest <= _CLEARLY_BETTER * found.furthest else found


def _session_time(scheme: Scheme, settings: GuideSettings, *, noise: float, grade: Grade) -> SessionTime:
    """Return the same of these positions alone."""
    usual_s = settings.hold_target.expected_s(noise)
    steps = list(_steps(scheme, settings, noise=noise / math.sqrt(usual_s)))
    unseen = [None if fit is None else fit.unseen(grade) for fit in steps]

    def forecast(positions: int, hold_s: float) -> dict[str, float]:
        fit = steps[positions - 1]
        if fit is None:
            return {}
        return fit.expecting(noise / math.sqrt(hold_s), grade.scatter_m_s2).forecast(unseen[positions - 1])

    def minutes(positions: int, hold_s: float) -> float:
        # Whoever finishes early leaves out the first position, which is otherwise asked for again at the end.
        holds = positions + int(settings.revisit_first and positions == len(scheme))
        return (BEGIN_S + holds * (hold_s + BETWEEN_S)) / 60

    best = forecast(len(scheme), LONGEST_HOLD_S)
    limits = {name: max(value, _HARDLY_WORSE * best.get(name, math.inf)) for name, value in settings.targets.items()}
    free_s = HoldTarget().expected_s(noise)
    longer_s = [free_s, *(hold_s for hold_s in _LENGTHS_S.tolist() if hold_s > free_s)]
    helps_s = next((hold_s for hold_s in longer_s if _is_within(limits, forecast(len(scheme), hold_s))), LONGEST_HOLD_S)

    # With a margin and without it the same are tried.
    @cache
    def taking(positions: int, hold_s: float) -> SessionTime:
        return SessionTime(
            hold_s=hold_s,
            usual_hold_s=usual_s,
            is_fixed=settings.hold_s is not None,
            helps_s=helps_s,
            noise=noise,
            positions=positions,
            planned=len(scheme),
            minutes=minutes(positions, hold_s),
            forecast=forecast(positions, hold_s),
            wanted=settings.targets,
            gravity=settings.gravity,
            scheme=scheme.name,
        )

    if settings.targets:
        lengths_s = _LENGTHS_S.tolist() if settings.hold_s is None else [settings.hold_s]
        counts = range(SHOWS_SCATTER, len(scheme) + 1)
        shortest_first = sorted(((count, hold_s) for hold_s in lengths_s for count in counts), key=lambda each: minutes(*each))
        for share in (_WITH_MARGIN, 1.0):
            enough = {name: share * value for name, value in settings.targets.items()}
            for count, hold_s in shortest_first:
                if is_met(enough, (time := taking(count, hold_s)).forecast, count):
                    return time
        if settings.hold_s is None:
            return taking(len(scheme), helps_s)
    return taking(len(scheme), usual_s)


def _steps(scheme: Scheme, settings: GuideSettings, *, noise: float) -> Iterator[RunningFit | None]:
    """Yield the fit to a perfect instrument position by position, in the order in which the guide asks for them.

    One fit serves all: without errors each of them finds the same parameters, and only their covariance is another.
    """
    covariance, gravity = noise**2 * np.eye(3), settings.gravity
    means = [_Mean(each.name, gravity.gravity_m_s2 * each.direction, covariance) for each in scheme.positions]
    whole, up = running_fit(means, RoughScale(accelerometer=1.0), gravity), scheme.directions()
    left, done = [*range(len(means))], list[int]()
    while left:
        done.append(left.pop(0))
        if whole is None or len(done) < FEWEST:
            yield None
            continue
        fit = whole.of(done)
        yield fit
        if len(left) > 1:
            left.insert(0, left.pop(next_best(fit, up[done], up[left], hurried=bool(settings.targets))))
