"""Sentences of the guide: what was found and what to do, with value, limit and axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imufield.guide.cross_checks.axes import GOOD_DEG, AxesCheck
from imufield.guide.cross_checks.running_fit import RunningFit
from imufield.guide.events import Accepted, NoiseFloorMeasured, RefusalCode, Vector
from imufield.guide.hold.checks import Refusal
from imufield.guide.hold.observe import Observation
from imufield.guide.lead.plan import Found, Plan
from imufield.guide.positions import angle_deg
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.limits import Activity
from imufield.guide.stillness.noise_floor import NoiseFloor, is_even, why_not_quiet
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray

_IN_A_ROW = 2  # Holds that end by motion before anybody is told what to do otherwise.
_NAMED_AT_ONCE = 4  # Positions named in a sentence: what the screen has room for.


def vector(values: FloatArray) -> Vector:
    """Return an array (3,) as plain numbers."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def quantity(value: float, unit: str) -> str:
    """Return a value in the unit people use for its size: mm/s^2, deg/s."""
    if unit == "m/s^2":
        return f"{1e3 * value:.3g} mm/s^2" if abs(value) < 1 else f"{value:.2f} m/s^2"
    if unit == "rad/s":
        return f"{math.degrees(value):.2g} deg/s"
    return f"{value:.3g} {unit}"


def floor_event(now_s: float, floor: NoiseFloor, detector: StillnessDetector) -> NoiseFloorMeasured:
    """Return the event for a noise floor just measured."""
    scale = detector.scale
    force_unit, force_factor = ("m/s^2", scale.accelerometer) if scale.accelerometer else ("raw unit", 1.0)
    rate_unit, rate_factor = ("rad/s", scale.gyroscope) if scale.gyroscope else ("raw unit", 1.0)
    force = float(np.sqrt(np.mean(floor.sigma[:3] ** 2))) / force_factor
    rate = float(np.sqrt(np.mean(floor.sigma[3:] ** 2))) / rate_factor
    limit = float(np.sqrt(np.mean(detector.limits.vibration[:3] ** 2))) / force_factor
    gyroscope = f"gyroscope {quantity(rate, rate_unit)}" if floor.has_gyroscope else "no gyroscope"
    learned = "; the scale is not known, so the norm of this still is taken as g" if scale.learned else ""
    return NoiseFloorMeasured(
        time_s=now_s,
        accelerometer_sigma=force,
        accelerometer_unit=force_unit,
        gyroscope_sigma=rate,
        gyroscope_unit=rate_unit,
        vibration_limit=limit,
        rate_hz=floor.samples_per_cell / detector.settings.cell_s,
        scale_learned=scale.learned,
        words=f"noise floor: accelerometer {quantity(force, force_unit)} rms per axis, {gyroscope}; "
        f"still means below {quantity(limit, force_unit)}{learned}",
    )


def accepted_event(
    now_s: float, observation: Observation, scale: RoughScale, plan: Plan, *, replaces: bool, fit: RunningFit | None
) -> Accepted:
    """Return the event for an observation just taken; what a running fit says of it is None while there is none."""
    force = scale.specific_force(observation.mean_raw)
    direction = force / np.linalg.norm(force)
    sigma = math.sqrt(float(np.diag(observation.covariance_raw).max())) / (scale.accelerometer or math.nan)
    held = observation.held
    row = None if fit is None or observation.name not in fit.names else fit.names.index(observation.name)
    return Accepted(
        time_s=now_s,
        position=observation.name,
        direction=vector(direction),
        angle_deg=angle_deg(observation.direction, direction),
        start_s=observation.start_s,
        duration_s=observation.duration_s,
        sigma_m_s2=sigma,
        temperature_degc=observation.temperature_degc,
        accepted=len(plan.accepted),
        planned=len(plan.scheme),
        replaces=replaces,
        residual_m_s2=None if fit is None or row is None else float(fit.residual_m_s2[row]),
        forecast=None if fit is None else fit.forecast(),
        leave_one_out_m_s2=None if fit is None or row is None else fit.disagreements()[row].leave_one_out_m_s2,
        rank=None if fit is None else fit.rank,
        condition=None if fit is None else fit.condition,
        held=held is not None,
        tremor_deg=None if held is None else held.tremor_deg,
        sway_deg=None if held is None else held.sway_deg,
    )


def warming_refusal(slope_degc_min: float, limit_degc_min: float) -> Refusal | None:
    """Return the refusal of a unit whose temperature changes too fast, None for one that is warm enough."""
    if abs(slope_degc_min) <= limit_degc_min:
        return None
    return Refusal(
        reason=RefusalCode.WARMING_UP,
        words=f"the temperature changes by {slope_degc_min:+.1f} degC per minute (limit {limit_degc_min:g})",
        remedy="leave it on and wait: it is measured as soon as it is warm; press g to go on cold",
        measured=abs(slope_degc_min),
        limit=limit_degc_min,
        unit="degC/min",
    )


def moved_refusal(activity: Activity, leave_factor: float, held_of_s: tuple[float, float], times: int = 1) -> Refusal:
    """Return the refusal of a hold that ended by motion: after how long of how long, for which time in a row."""
    held_s, hold_s = held_of_s
    limit = leave_factor * activity.limit
    what = {"vibration": "shook", "change": "moved"}[activity.kind]
    return Refusal(
        reason=RefusalCode.MOVED,
        words=f"it {what} after {held_s:.1f} of {hold_s:g} s: {activity.triad} {activity.axis} "
        f"{quantity(activity.measured, activity.unit)} (limit {quantity(limit, activity.unit)})",
        remedy="hold again; only this hold is repeated"
        if times < _IN_A_ROW
        else f"{times} times in a row it was let go or lifted too early: keep it as it is until the two tones, or until the "
        "screen says accepted",
        measured=activity.measured,
        limit=limit,
        unit=activity.unit,
        axis=activity.axis,
    )


def motion_words(activity: Activity) -> str:
    """Return what moves, in words, and by how much: "turns, gyroscope z 12 deg/s"."""
    changes = {"accelerometer": "tilts", "gyroscope": "turns"}[activity.triad]
    what = changes if activity.kind == "change" else "shakes"
    return f"{what}, {activity.triad} {activity.axis} {quantity(activity.measured, activity.unit)}"


def not_still_refusal(activity: Activity) -> Refusal:
    """Return what keeps a unit from being still that somebody holds in place."""
    return Refusal(
        reason=RefusalCode.NOT_STILL,
        words=f"not still yet: it {motion_words(activity)} (limit {quantity(activity.limit, activity.unit)})",
        remedy="put it on a firm support or lean it on one, hands off",
        measured=activity.measured,
        limit=activity.limit,
        unit=activity.unit,
        axis=activity.axis,
    )


def place_refusal(plan: Plan, nearest: Found, pending: Found | None) -> Refusal:
    """Return the refusal of a still unit that is in no pending position."""
    limit = plan.tolerance_deg
    if nearest.angle_deg <= limit:
        name = plan.position(nearest.index).name
        found, remedy = f"{name} is already done", _what_is_left(plan.missing())
        return Refusal(
            reason=RefusalCode.ALREADY_DONE, words=found, remedy=remedy, measured=nearest.angle_deg, limit=limit, unit="deg"
        )
    closest = pending or nearest
    name = plan.position(closest.index).name
    # The picture shows what is proposed; the words must not ask for another side.
    target = plan.proposed()
    wanted = plan.position(closest.index if target is None else target)
    return Refusal(
        reason=RefusalCode.NOT_NEAR,
        words=f"not near any pending position: nearest is {name} at {closest.angle_deg:.0f} deg (limit {limit:.0f} deg)",
        remedy=f"bring it to {wanted.name}: {wanted.words}",
        measured=closest.angle_deg,
        limit=limit,
        unit="deg",
    )


def _what_is_left(names: Sequence[str]) -> str:
    if not names:
        return "bring another side up"
    more = f" and {len(names) - _NAMED_AT_ONCE} more" if len(names) > _NAMED_AT_ONCE else ""
    return f"{len(names)} left: {', '.join(names[:_NAMED_AT_ONCE])}{more}"


def not_quiet_refusal(cells: Cells, scale: RoughScale, floor_s: float, *, in_vain: bool = False) -> Refusal:
    """Return what kept the last cells from being quiet while there is no noise floor.

    ``in_vain`` says that this was waited for long enough to doubt the settings where it looks like noise.
    """
    cells = cells[np.flatnonzero(cells.usable)]
    found = why_not_quiet(cells, scale) if len(cells) > 1 else None
    waiting = f"waiting for {floor_s:g} s without motion to measure the noise floor"
    if found is None:
        remedy, whole_s = "check cable, baud rate and load of the computer", float((cells.end_s - cells.start_s).sum())
        return Refusal(
            reason=RefusalCode.NOT_QUIET,
            words=f"{waiting}: samples are missing",
            remedy=remedy,
            measured=whole_s,
            limit=floor_s,
            unit="s",
        )
    triad, axis = ("accelerometer", "gyroscope")[found.column // 3], AXES[found.column % 3]
    factor, unit = ((scale.accelerometer, "m/s^2"), (scale.gyroscope, "rad/s"))[found.column // 3]
    measured, limit = (value / (factor or 1.0) for value in (found.measured, found.limit))
    unit = unit if factor else "raw unit"
    what = "it shakes" if found.shakes else "it does not keep still"
    remedy = "lay the unit on a firm surface and take the hands off"
    if in_vain and found.shakes and is_even(cells, scale):
        remedy = (
            f"noise this even is no motion of a hand: if the unit lies still, the {triad}'s unit or range is set wrong "
            "(--set or the protocol)"
        )
    return Refusal(
        reason=RefusalCode.NOT_QUIET,
        words=f"{waiting}: {what}, {triad} {axis} {'' if found.shakes else 'strays by '}{quantity(measured, unit)} "
        f"(limit {quantity(limit, unit)})",
        remedy=remedy,
        measured=measured,
        limit=limit,
        unit=unit,
        axis=axis,
    )


def axes_refusal(axes: AxesCheck) -> Refusal:
    """Return the warning that gyroscope and accelerometer do not belong together."""
    return Refusal(
        reason=RefusalCode.SCALE if axes.turns_ratio != 1.0 else RefusalCode.AXES,
        words=axes.words,
        remedy="the accelerometer positions stay valid; nothing of the gyroscope will be until this is corrected",
        measured=axes.misfit_deg,
        limit=GOOD_DEG,
        unit="deg",
    )


def clock_refusal(gap_s: float, limit_s: float) -> Refusal:
    """Return the word on a sample clock that jumped."""
    way = f"forward by {gap_s:.1f} s" if gap_s > 0 else f"back by {-gap_s:.1f} s"
    return Refusal(
        reason=RefusalCode.CLOCK_JUMP,
        words=f"the sample clock jumped {way} (limit {limit_s:g} s): the computer was suspended, or the instrument began anew",
        remedy="nothing measured is lost; a hold that was under way begins anew",
        measured=abs(gap_s),
        limit=limit_s,
        unit="s",
    )


def rate_refusal(share: float, limit: float, usual_hz: float) -> Refusal:
    """Return the word on a sample rate that is not what it was."""
    return Refusal(
        reason=RefusalCode.RATE,
        words=f"the sample rate has changed by {100 * share:+.0f} % from {usual_hz:.0f} Hz (limit {100 * limit:g} %)",
        remedy="check the load of the computer, the baud rate and the instrument's settings",
        measured=abs(share) * usual_hz,
        limit=limit * usual_hz,
        unit="Hz",
    )
