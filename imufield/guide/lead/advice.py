"""What the running fit has to say to the operator. Advice refuses nothing.

Positions that the others contradict: each doubt is said, and withdrawn aloud when the others come to agree.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.earth import MILLI_G_M_S2
from imufield.guide.cross_checks.running_fit import EXPECTED_SCATTER_M_S2, Disagreement, RunningFit
from imufield.guide.events import Advice, Topic
from imufield.guide.hold.observe import Observation
from imufield.guide.lead.plan import Plan
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.stillness.scale import RoughScale


class Doubts:
    """What the running fit doubts, and what was said of it."""

    def __init__(self) -> None:
        self.now: list[Disagreement] = []  # The worst first.
        self._told: set[str] = set()
        self._asked: set[str] = set()

    def follow(self, fit: RunningFit | None) -> None:
        """Take the newest fit."""
        found = [] if fit is None else [one for one in fit.disagreements() if one.doubtful]
        self.now = sorted(found, key=lambda one: -abs(one.sigmas))

    def say(self, now_s: float, fit: RunningFit, plan: Plan) -> list[Advice]:
        """Return what to say: doubts that no longer stand, and the worst one where it was not said."""
        standing = {one.name for one in self.now}
        settled = [one for one in fit.disagreements() if one.name in self._told - standing]
        self._told &= standing
        # What the guide asked for because of it, it asks for no longer; what the operator wants again stays.
        asked = {one.name for one in settled} & self._asked
        plan.wanted_again = {index for index in plan.wanted_again if plan.position(index).name not in asked}
        new = [one for one in self.now[:1] if one.name not in self._told]
        self._told.update(one.name for one in new)
        return [*(settled_advice(now_s, one) for one in settled), *(doubtful_advice(now_s, one) for one in new)]

    def ask_again(self) -> list[str]:
        """Return what is to be measured once more: what is doubted, each position once."""
        names = [one.name for one in self.now if one.name not in self._asked]
        self._asked.update(names)
        return names


MATTERS_SIGMAS = 3.0
_FEWEST_FOR_QUADRATIC = 18
_FEWEST_FOR_SCALE = 9
SCALE_SHARE = 0.02
"""Common scale against the nominal one: instruments repeat to 0.1 to 1 %, a wrong range or a wrong g shows as more."""
EARLIER_SHARE = 2e-4
"""Common scale against an earlier calibration's: 2 degrees of latitude; good instruments repeat to it, chips within 1 degC."""
DRIFT_SIGMAS = 4.0


def doubtful_advice(now_s: float, found: Disagreement) -> Advice:
    """Return the advice to look at a position again."""
    value = abs(found.leave_one_out_m_s2) / MILLI_G_M_S2
    return Advice(
        time_s=now_s,
        topic=Topic.DOUBTFUL,
        position=found.name,
        words=f"position {found.name} disagrees with the others by {value:.2g} mg, {abs(found.sigmas):.0f} sigma: "
        "moved or bumped",
        remedy="r retakes it now; otherwise it is asked for again at the end, if it disagrees then",
        measured=abs(found.leave_one_out_m_s2),
        limit=abs(found.leave_one_out_m_s2 / found.sigmas) * found.limit_sigmas,
        unit="m/s^2",
    )


def settled_advice(now_s: float, found: Disagreement) -> Advice:
    """Return the withdrawal of a doubt."""
    value = abs(found.leave_one_out_m_s2) / MILLI_G_M_S2
    return Advice(
        time_s=now_s,
        topic=Topic.SETTLED,
        position=found.name,
        words=f"position {found.name} no longer disagrees with the others ({value:.2g} mg, {abs(found.sigmas):.1f} sigma)",
        remedy="the doubt is withdrawn",
        measured=abs(found.leave_one_out_m_s2),
        limit=abs(found.leave_one_out_m_s2 / found.sigmas) * found.limit_sigmas if found.sigmas else 0.0,
        unit="m/s^2",
    )


def target_advice(now_s: float, fit: RunningFit, settings: GuideSettings) -> Advice | None:
    """Return the offer to finish early, None while the target is not met or there is none."""
    forecast = fit.forecast()
    wanted = {"bias_ug": settings.target_bias_ug, "scale_ppm": settings.target_scale_ppm}
    asked = {key: value for key, value in wanted.items() if value is not None}
    missed = any(forecast.get(key, math.inf) > value for key, value in asked.items())
    if not asked or missed or len(fit.names) < _FEWEST_FOR_SCALE:
        return None
    unit = {"bias_ug": "ug", "scale_ppm": "ppm"}
    said = ", ".join(f"{key.split('_')[0]} {forecast[key]:.3g} {unit[key]} (wanted {value:g})" for key, value in asked.items())
    key, value = next(iter(asked.items()))
    return Advice(
        time_s=now_s,
        topic=Topic.TARGET_MET,
        position=None,
        words=f"the target is met: {said}",
        remedy="f, pressed twice, finishes now; going on makes it better still",
        measured=forecast[key],
        limit=value,
        unit=unit[key],
    )


def scheme_advice(now_s: float, fit: RunningFit, plan: Plan) -> Advice | None:
    """Return the proposal of corners24 where the quadratic terms matter."""
    known = len(fit.names) >= _FEWEST_FOR_QUADRATIC
    if not known or not plan.scheme.name.startswith("paper") or fit.quadratic_sigmas() < MATTERS_SIGMAS:
        return None
    return Advice(
        time_s=now_s,
        topic=Topic.SCHEME,
        position=None,
        words=f"the quadratic terms matter here ({fit.quadratic_sigmas():.1f} sigma)",
        remedy="next time use --positions corners24, which knows them and the biases a quarter better",
        measured=fit.quadratic_sigmas(),
        limit=MATTERS_SIGMAS,
        unit="sigma",
    )


def scale_advice(now_s: float, fit: RunningFit) -> Advice | None:
    """Return a warning where the common scale is far from the instrument's nominal one: the residual cannot see it."""
    nominal = fit.scale.accelerometer
    if not nominal or fit.scale.learned or len(fit.names) < _FEWEST_FOR_SCALE:
        return None
    found, sigma = fit.common_scale()
    share = found / nominal - 1
    if abs(share) < max(SCALE_SHARE, 4 * sigma):
        return None
    return Advice(
        time_s=now_s,
        topic=Topic.SCALE,
        position=None,
        words=f"the common scale is {100 * share:+.1f} % off the instrument's nominal one (limit {100 * SCALE_SHARE:g} %)",
        remedy="check range and unit settings, latitude and gravity: the residual cannot show this",
        measured=abs(share),
        limit=SCALE_SHARE,
        unit="1",
    )


def final_scale_advice(now_s: float, fit: RunningFit, settings: GuideSettings) -> Advice | None:
    """Return what the common scale is against an earlier calibration's, or the nominal one; None where neither is known.

    Gravity and a common scale are one parameter: a wrong latitude shows here or nowhere.
    """
    earlier = settings.earlier_scale_raw
    nominal = None if fit.scale.learned else fit.scale.accelerometer
    reference = earlier or nominal
    if reference is None or len(fit.names) < _FEWEST_FOR_SCALE:
        return None
    share, own_sigma = fit.common_scale()
    change = share / reference - 1
    sigma = math.hypot(own_sigma, settings.earlier_scale_sigma if earlier else 0.0)
    limit = max(EARLIER_SHARE if earlier else SCALE_SHARE, 4 * sigma)
    whose = "the earlier calibration's" if earlier else "the instrument's nominal one"
    if abs(change) > limit:
        remedy = "check latitude, height and gravity: the residual cannot show a wrong one"
    elif earlier:
        remedy = "gravity and scale are what they were"
    else:
        remedy = "a wrong latitude (0.5 % from equator to pole) shows only against an earlier calibration: capture --preset"
    return Advice(
        time_s=now_s,
        topic=Topic.SCALE,
        position=None,
        words=f"the common scale is {1e6 * change:+.0f} ppm off {whose} (limit {1e6 * limit:.0f} ppm)",
        remedy=remedy,
        measured=abs(change),
        limit=limit,
        unit="1",
    )


def drift_advice(now_s: float, before: Observation, after: Observation, scale: RoughScale, *, fit: RunningFit | None) -> Advice:
    """Return what the first position says when it is shown again at the end."""
    norms = [float(np.linalg.norm(scale.specific_force(one.mean_raw))) for one in (before, after)]
    directions = [scale.specific_force(one.mean_raw) / norm for one, norm in zip((before, after), norms, strict=True)]
    # An uncalibrated norm changes with the placement; the gradient of the bias across it tells by how much.
    placement = 0.0 if fit is None else float(np.linalg.norm(fit.vector[3:6])) * math.dist(*directions)
    change = norms[1] - norms[0]
    sigma = math.hypot(EXPECTED_SCATTER_M_S2, placement)
    minutes = (after.start_s - before.start_s) / 60
    drifted = abs(change) > DRIFT_SIGMAS * sigma
    return Advice(
        time_s=now_s,
        topic=Topic.DRIFT,
        position=before.name,
        words=f"{before.name} again after {minutes:.0f} min: {change / MILLI_G_M_S2:+.2f} mg, "
        + ("it has drifted" if drifted else f"no drift beyond {DRIFT_SIGMAS * sigma / MILLI_G_M_S2:.1f} mg"),
        remedy="let the unit warm up longer and measure again" if drifted else "nothing to do",
        measured=abs(change),
        limit=DRIFT_SIGMAS * sigma,
        unit="m/s^2",
    )
