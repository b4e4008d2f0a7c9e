"""Advice of the guide, from the running fit to the positions so far. Advice refuses nothing.

The fit also tells which position to measure next (``plan.next_best``) and when the targets are met.

Positions that the others contradict are suspects: each suspicion is told, and withdrawn aloud when the others come to agree.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from imufield.calibrate.accelerometer.drift import MOST_CONFUSION, order_confusion
from imufield.calibrate.model.grades import DEFAULT_GRADE, find_grade
from imufield.dataclass import dataclass, replace
from imufield.earth import MILLI_G_M_S2
from imufield.guide.cross_checks.axes import GOOD_DEG, AxesCheck
from imufield.guide.cross_checks.centre import LEAST_OFFSET_M_S2
from imufield.guide.cross_checks.running_fit import (
    EXPECTED_SCATTER_M_S2,
    LINEAR,
    Disagreement,
    RunningFit,
    running_fit,
)
from imufield.guide.events import Advice, Topic
from imufield.guide.lead.plan import Plan, next_best
from imufield.guide.lead.session_time import SessionTime, figures, is_met, session_time
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_EXONERATED_SHARE = 0.5  # A suspect is none any more where it disagrees by less than this share of before.
_MATTERS_SIGMAS = 3.0  # A quadratic term of less may be chance.
_FEWEST_FOR_QUADRATIC = 18  # Of a scheme of 24; fewer positions leave the quadratic terms to the priors.
# Common scale against the nominal one: instruments repeat to 0.1 to 1 %, a wrong range or a wrong g shows as more.
_SCALE_SHARE = 0.02
# Common scale against an earlier calibration's: 2 degrees of latitude; good instruments repeat to it, chips within 1 degC.
_EARLIER_SHARE = 2e-4
_SCALE_SIGMAS = 4.0  # Nor is a change within the uncertainty of the scale told.
_DRIFT_SIGMAS = 4.0  # A false alarm in 16 000 sessions.


@dataclass(frozen=True, slots=True)
class _Kind:
    """One kind of advice: its topic, the keys of what was found and of what to do, and the unit of value and limit."""

    topic: Topic
    words: str
    remedy: str
    unit: str

    def advice(self, now_s: float, measured: float, limit: float, position: str | None = None, **values: object) -> Advice:
        """Return the advice with these numbers; ``values`` are those of the sentence."""
        return Advice(
            time_s=now_s,
            topic=self.topic,
            position=position,
            words=sentence(self.words, position=position, limit=limit, **values),
            remedy=sentence(self.remedy),
            measured=measured,
            limit=limit,
            unit=self.unit,
        )


_DOUBTFUL = _Kind(Topic.DOUBTFUL, "advice.doubtful", "advice.doubtful_remedy", "m/s^2")
_SETTLED = _Kind(Topic.SETTLED, "advice.settled", "advice.settled_remedy", "m/s^2")
_DRIFTED = _Kind(Topic.DRIFT, "advice.drifted", "advice.drifted_remedy", "m/s^2")
_NO_DRIFT = _Kind(Topic.DRIFT, "advice.no_drift", "advice.no_drift_remedy", "m/s^2")
_NO_DRIFT_TURNED = _Kind(Topic.DRIFT, "advice.no_drift_turned", "advice.no_drift_remedy", "m/s^2")
_BIAS_MET = _Kind(Topic.TARGET_MET, "advice.target_met", "advice.target_met_remedy", "ug")
_SCALE_MET = _Kind(Topic.TARGET_MET, "advice.target_met", "advice.target_met_remedy", "ppm")
_SCHEME = _Kind(Topic.SCHEME, "advice.scheme", "advice.scheme_remedy", "sigma")
_ORDER = _Kind(Topic.ORDER, "advice.order", "advice.order_remedy", "1")
_FAR_SCALE = _Kind(Topic.SCALE, "advice.far_scale", "advice.far_scale_remedy", "1")
_OFF_EARLIER = _Kind(Topic.SCALE, "advice.earlier_scale", "advice.off_scale_remedy", "1")
_LIKE_EARLIER = _Kind(Topic.SCALE, "advice.earlier_scale", "advice.earlier_scale_remedy", "1")
_OFF_NOMINAL = _Kind(Topic.SCALE, "advice.nominal_scale", "advice.off_scale_remedy", "1")
_LIKE_NOMINAL = _Kind(Topic.SCALE, "advice.nominal_scale", "advice.nominal_scale_remedy", "1")
_OFFSET = _Kind(Topic.OFFSET, "advice.offset", "advice.offset_remedy", "m/s^2")
_GYROSCOPE_SCALE = _Kind(Topic.SCALE, "advice.gyroscope_scale", "advice.gyroscope_scale_remedy", "deg")


def gyroscope_scale_advice(now_s: float, axes: AxesCheck) -> Advice:
    """Return what a gyroscope of unknown scale sends, by the moves that agree with the accelerometer."""
    count_deg_s = math.degrees(1 / axes.gyroscope_scale)
    return _GYROSCOPE_SCALE.advice(now_s, axes.misfit_deg, GOOD_DEG, count_deg_s=count_deg_s, within_deg=axes.misfit_deg)


def time_advice(now_s: float, time: SessionTime) -> Advice:
    """Return how long the session takes to its target, and what to do where it misses it."""
    return Advice(
        time_s=now_s,
        topic=Topic.TIME,
        position=None,
        words=time.words,
        remedy=time.remedy,
        measured=time.minutes,
        limit=math.inf,
        unit="min",
    )


class Adviser:
    """The running fit of a session and the advice that follows from it.

    Parameters
    ----------
    plan : Plan
    settings : GuideSettings
    """

    def __init__(self, plan: Plan, settings: GuideSettings) -> None:
        self._plan = plan
        self._settings = settings
        self.fit: RunningFit | None = None
        self.forecast: dict[str, float] | None = None  # 1 sigma of the parameters.
        self.compared: dict[int, Disagreement] = {}  # Each accepted position with the others.
        self.suspects: dict[int, Disagreement] = {}  # Positions that the fit to the others contradicts, the worst first.
        self._told: set[Topic] = set()
        self._revisited = False
        # What `solve` will take for it.
        self._grade = find_grade(settings.grade or DEFAULT_GRADE)

    @property
    def suspect_names(self) -> tuple[str, ...]:
        """Names of the suspects, the worst first."""
        return tuple(suspect.name for suspect in self.suspects.values())

    def fit_again(self, scale: RoughScale) -> None:
        """Fit everything measured so far, and choose the next position where another helps clearly more."""
        settings, plan = self._settings, self._plan
        self.fit = running_fit(list(plan.accepted.values()), scale, settings.gravity)
        self.forecast = None if self.fit is None else self.fit.forecast(self.fit.unseen(self._grade))
        self._compare(scale)
        plan.preferred = None
        pending = plan.pending()
        if self.fit is None or len(pending) < 2:
            return
        best = next_best(self.fit, self._ups(plan.accepted), self._ups(pending), hurried=bool(settings.targets))
        plan.preferred = pending[best] if best else None

    def _compare(self, scale: RoughScale) -> None:
        """Compare each position with the others but the suspects: a bump makes good ones disagree, and hides another."""
        accepted, fit_to_all = self._plan.accepted, self.fit
        out = [index for index in self.suspects if index in accepted]

        def compare(*more: int) -> dict[int, Disagreement]:
            indices = [index for index in accepted if index not in out or index in more]
            some = [accepted[index] for index in indices]
            is_all = len(some) == len(accepted)
            fit = fit_to_all if is_all else running_fit(some, scale, self._settings.gravity)
            return {} if fit is None else dict(zip(indices, fit.disagreements(), strict=True))

        compared = compare()
        while suspects := [index for index, found in compared.items() if found.is_suspect]:
            out.append(max(suspects, key=lambda index: abs(compared[index].sigmas)))
            compared = compare()
        for index in out:
            compared |= {index: found[index]} if (found := compare(index)) else {}
            before, now = self.suspects.get(index), compared.get(index)
            if before and now and abs(now.leave_one_out_m_s2) > _EXONERATED_SHARE * abs(before.leave_one_out_m_s2):
                # As far away as ever: a bump elsewhere only makes that look usual.
                compared[index] = replace(before, name=now.name, leave_one_out_m_s2=now.leave_one_out_m_s2)
        self.compared = compared
        worst_first = sorted(self.compared.items(), key=lambda found: -abs(found[1].sigmas))
        self.suspects = {index: found for index, found in worst_first if found.is_suspect}

    def session_time(self, floor: NoiseFloor, scale: RoughScale) -> SessionTime | None:
        """Return how long the session takes to its target, by the noise that was measured; None without a target."""
        noise = floor.white_noise(scale)
        if not self._settings.targets or not math.isfinite(noise):
            return None
        return session_time(self._plan.scheme, self._settings, noise=noise, grade=self._grade)

    def advise(self, now_s: float) -> list[Advice]:
        """Return what the running fit shows that the operator may want to act on; each topic once."""
        if self.fit is None:
            return []
        told = self._advise_suspects(now_s)
        for advice in self._advise_once(now_s, self.fit):
            if advice.topic not in self._told:
                self._told.add(advice.topic)
                told.append(advice)
        return told

    def _advise_once(self, now_s: float, fit: RunningFit) -> Iterator[Advice]:
        """Yield what one fit shows; each topic is told the first time."""
        settings, count = self._settings, len(fit.names)
        if count < LINEAR:
            return
        asked, forecast = settings.targets, self.forecast or {}
        if is_met(asked, forecast, count):
            kinds = {"bias_ug": _BIAS_MET, "scale_ppm": _SCALE_MET}
            key, value = next(iter(asked.items()))
            yield kinds[key].advice(now_s, forecast[key], value, known=figures(forecast, asked, asked))
        # A bump looks like a quadratic term, too.
        sigmas = 0.0 if self.suspects else fit.quadratic_sigmas()
        if count >= _FEWEST_FOR_QUADRATIC and self._plan.scheme.name.startswith("paper") and sigmas >= _MATTERS_SIGMAS:
            yield _SCHEME.advice(now_s, sigmas, _MATTERS_SIGMAS, sigmas=sigmas)
        # How alike drift and quadratic term look where the pending positions follow those so far as they are asked for.
        plan = self._plan
        asked_for = sorted(plan.pending(), key=lambda index: index != plan.preferred)
        confusion = order_confusion(self._ups([*plan.accepted, *asked_for]))
        if confusion > MOST_CONFUSION:
            yield _ORDER.advice(now_s, confusion, MOST_CONFUSION, factor=confusion)
        # The residual cannot show a common scale far from the instrument's nominal one.
        if fit.scale.accelerometer and not fit.scale.learned:
            found, sigma = fit.common_scale()
            share = found / fit.scale.accelerometer - 1
            if abs(share) >= max(_SCALE_SHARE, _SCALE_SIGMAS * sigma):
                yield _FAR_SCALE.advice(
                    now_s, abs(share), _SCALE_SHARE, off_percent=100 * share, limit_percent=100 * _SCALE_SHARE
                )

    def _ups(self, indices: Iterable[int]) -> FloatArray:
        return np.array([self._plan.position(index).direction for index in indices])

    def _advise_suspects(self, now_s: float) -> list[Advice]:
        """Return what to tell of suspects: suspicions that are settled, and the worst one if it was not told yet."""
        plan = self._plan
        no_more = plan.doubted - self.suspects.keys()
        settled = {index: found for index, found in self.compared.items() if index in no_more}
        new = {index: suspect for index, suspect in [*self.suspects.items()][:1] if index not in plan.doubted}
        plan.doubted = (plan.doubted & self.suspects.keys()) | new.keys()
        # What the guide asked for because of it, it asks for no longer; what the operator wants again stays.
        plan.wanted_again -= settled.keys() & plan.asked_again
        told = []
        for kind, found in [(_SETTLED, found) for found in settled.values()] + [(_DOUBTFUL, found) for found in new.values()]:
            off_m_s2, sigmas = abs(found.leave_one_out_m_s2), abs(found.sigmas)
            limit_m_s2 = off_m_s2 / sigmas * found.limit_sigmas if sigmas else 0.0
            sizes = {"off_mg": off_m_s2 / MILLI_G_M_S2, "sigmas": sigmas, "limit_sigmas": found.limit_sigmas}
            told.append(kind.advice(now_s, off_m_s2, limit_m_s2, found.name, **sizes))
        return told

    def ask_again(self) -> None:
        """Ask for suspects once more, each once, and then for the first position, as a check for drift."""
        plan = self._plan
        for index in self.suspects:
            if index not in plan.asked_again:
                plan.want_again(index)
        plan.asked_again.update(self.suspects)
        first, open_still = next(iter(plan.accepted), None), not self._revisited and plan.revisited is None
        if plan.proposed() is None and self._settings.revisit_first and open_still and first is not None:
            self._revisited, plan.revisiting = True, first

    def drift_advice(self, now_s: float, scale: RoughScale, index: int) -> list[Advice]:
        """Return the change of the norm of a position from its measurement to the check at the end."""
        before, after = self._plan.accepted.get(index), self._plan.revisited
        if before is None or after is None:
            return []
        forces = [scale.specific_force(observation.mean_raw) for observation in (before, after)]
        norms = [float(np.linalg.norm(force)) for force in forces]
        directions = [force / norm for force, norm in zip(forces, norms, strict=True)]
        # An uncalibrated norm changes with the placement; the gradient of the bias across it tells by how much.
        turned = math.dist(*directions)
        placement = 0.0 if self.fit is None else float(np.linalg.norm(self.fit.vector[3:6])) * turned
        change = norms[1] - norms[0]
        limit = _DRIFT_SIGMAS * math.hypot(EXPECTED_SCATTER_M_S2, placement)
        kind = _NO_DRIFT_TURNED if placement > EXPECTED_SCATTER_M_S2 else _NO_DRIFT
        kind = _DRIFTED if abs(change) > limit else kind
        values = {
            "minutes": (after.start_s - before.start_s) / 60,
            "change_mg": change / MILLI_G_M_S2,
            "limit_mg": limit / MILLI_G_M_S2,
            "same_mg": _DRIFT_SIGMAS * EXPECTED_SCATTER_M_S2 / MILLI_G_M_S2,
            "turned_deg": math.degrees(turned),
        }
        return [kind.advice(now_s, abs(change), limit, before.name, **values)]

    def offset_advice(self, now_s: float, before: RoughScale, scale: RoughScale, *, renamed: int) -> Advice:
        """Fit again to the scale about the offset that was found, and return what it is, of the reading as it comes."""
        self.fit_again(scale)
        offset = (scale.raw_zero - before.raw_zero) / (scale.accelerometer or 1.0)
        size = float(np.linalg.norm(offset))
        return _OFFSET.advice(now_s, size, LEAST_OFFSET_M_S2, offset=offset.tolist(), renamed=renamed)

    def final_advice(self, now_s: float) -> list[Advice]:
        """Return at the end the common scale against an earlier calibration's, or the nominal one where that was not told.

        Gravity and a common scale are one parameter: a wrong latitude shows here or nowhere.
        """
        fit, earlier = self.fit, self._settings.earlier_scale_raw
        if fit is None or len(fit.names) < LINEAR or (Topic.SCALE in self._told and earlier is None):
            return []
        reference = earlier or (None if fit.scale.learned else fit.scale.accelerometer)
        if reference is None:
            return []
        scale, own_sigma = fit.common_scale()
        change = scale / reference - 1
        sigma = math.hypot(own_sigma, self._settings.earlier_scale_sigma if earlier else 0.0)
        limit = max(_EARLIER_SHARE if earlier else _SCALE_SHARE, _SCALE_SIGMAS * sigma)
        off, like = (_OFF_EARLIER, _LIKE_EARLIER) if earlier else (_OFF_NOMINAL, _LIKE_NOMINAL)
        kind = off if abs(change) > limit else like
        return [kind.advice(now_s, abs(change), limit, change_ppm=1e6 * change, limit_ppm=1e6 * limit)]
