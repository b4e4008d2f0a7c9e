"""Checks of a hold before it is believed. Each gives a refusal with value, limit, axis and remedy, or nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide.events import RefusalCode, Rejected
from imufield.guide.hold.hand_mean import HeldMean
from imufield.guide.hold.observe import correlation_factor, knocked
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.limits import Limits
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray, Status


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckLimits:
    """Limits of the checks."""

    gravity_share: float = 0.25
    """The norm may be off g by this share: uncalibrated MEMS reach 0.2, a wrong unit or range gives 0.5 and more."""
    gravity_share_learned: float = 0.5
    """The same where g itself was learned from a still, whose own bias is then in the scale."""
    lost_share: float = 0.05
    """Samples of a hold that may be missing or unusable."""
    knocked_share: float = 0.1
    """Cells of a hold that may be left out because they stand out."""
    drift_m_s2: float = 0.01
    """Change of the norm over a hold that is refused if it is beyond 4 sigma too; the mean takes the middle of the line."""
    tilt_deg: float = 1.0
    """Turn of the mean direction over a hold that is refused: the norm of the mean loses 13 ug by it."""
    shift_deg: float = 0.3
    """Sudden turn within a hold that is refused if it is beyond 6 sigma too: the norm of the mean loses 3 ug by it."""
    least_shift_deg: float = 0.05
    """Less than that never is: 0.1 ug. Between the two the limit is what costs 1 sigma of the mean."""
    tremor_deg: float = 0.2
    jolt_share: float = 8.0
    """Of the usual jolt of a hold in the hand: tremor and noise make up to 4, bumps that shift the mean 15 to 600; a slow one
    that makes less stands out of the cells."""
    sway_deg: float = 1.5
    """Of a hold in the hand, rms of each axis: what the frame of the gyroscope corrects to 5 ug and 15 ug."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """Why a hold does not count."""

    reason: RefusalCode
    words: str
    remedy: str
    measured: float
    limit: float
    unit: str
    axis: str | None = None

    def event(self, now_s: float, position: str | None) -> Rejected:
        """Return the event that says it."""
        return Rejected(time_s=now_s, position=position, **{field.name: getattr(self, field.name) for field in fields(self)})


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldUnderTest:
    """What the checks look at: the trimmed cells of a hold and the standards they are held against."""

    cells: Cells
    floor: NoiseFloor
    limits: Limits
    scale: RoughScale
    settings: CheckLimits
    held: HeldMean | None = None
    """For a hold in the hand."""


def examine(hold: HoldUnderTest) -> Refusal | None:
    """Return the first reason not to believe a hold, None when there is none."""
    always = (_check_samples, _check_stuck, _check_gravity)
    in_hand = (_check_jolt, _check_knocks, _check_tremor, _check_sway)
    by_kind = (_check_knocks, _check_shift, _check_drift) if hold.held is None else in_hand
    checks: tuple[Callable[[HoldUnderTest], Refusal | None], ...] = (*always, *by_kind)
    for check in checks:
        refusal = check(hold)
        if refusal is not None:
            return refusal
    return None


def explain_flags(cells: Cells, usable_share: float, limit: float) -> Refusal:
    """Return the refusal for cells with too few usable samples: what their flags say."""
    flags = Status(int(np.bitwise_or.reduce(cells.flags)) & 0xFFFF)
    percent, limit_percent = 100 * (1 - usable_share), 100 * (1 - limit)
    share = f"{percent:.1f} % of the samples (limit {limit_percent:.0f} %)"
    if flags & (Status.ACCELEROMETER_SATURATED | Status.GYROSCOPE_SATURATED):
        accelerometer = bool(flags & Status.ACCELEROMETER_SATURATED)
        triad, axis = ("accelerometer", 0) if accelerometer else ("gyroscope", 3)
        peak = np.fmax(np.abs(cells.low), np.abs(cells.high))[:, axis : axis + 3]
        name = AXES[int(np.argmax(np.nan_to_num(np.nanmax(peak, axis=0))))] if np.isfinite(peak).any() else None
        return Refusal(
            reason=RefusalCode.SATURATED,
            words=f"the {triad} is at the end of its range{f' on axis {name}' if name else ''} in {share}",
            remedy="choose a larger range, or check the range setting of the driver, then hold again",
            measured=percent,
            limit=limit_percent,
            unit="%",
            axis=name,
        )
    for flag, reason, found, remedy in (
        (Status.START_UP, RefusalCode.START_UP, "the instrument is still starting up", "leave it alone until it is ready"),
        (Status.INSTRUMENT_FAULT, RefusalCode.INVALID, "the instrument reports a fault", "read its status in the manual"),
        (Status.ACCELEROMETER_INVALID, RefusalCode.INVALID, "the accelerometer is reported invalid", "check the instrument"),
        (Status.GYROSCOPE_INVALID, RefusalCode.INVALID, "the gyroscope is reported invalid", "check the instrument"),
    ):
        if flags & flag:
            again = "" if reason is RefusalCode.START_UP else ", then hold again"
            return Refusal(
                reason=reason,
                words=f"{found} in {share}",
                remedy=f"{remedy}{again}",
                measured=percent,
                limit=limit_percent,
                unit="%",
            )
    return Refusal(
        reason=RefusalCode.SAMPLE_LOSS,
        words=f"lost or not finite: {share}",
        remedy="check cable, baud rate and load of the computer, then hold again",
        measured=percent,
        limit=limit_percent,
        unit="%",
    )


def _check_samples(hold: HoldUnderTest) -> Refusal | None:
    slots = int(hold.cells.slot[-1] - hold.cells.slot[0]) + 1
    share = float(hold.cells.usable.sum()) / (slots * hold.floor.samples_per_cell)
    limit = 1 - hold.settings.lost_share
    return explain_flags(hold.cells, share, limit) if share < limit else None


def _check_stuck(hold: HoldUnderTest) -> Refusal | None:
    """Refuse an axis that does not change at all although its noise floor says that it should."""
    span = np.max(hold.cells.high[:, :3], axis=0) - np.min(hold.cells.low[:, :3], axis=0)
    noisy = hold.floor.sigma[:3] > np.where(np.isfinite(hold.floor.step[:3]), hold.floor.step[:3], np.inf)
    stuck = np.flatnonzero((span == 0) & noisy)
    if not len(stuck):
        return None
    axis = int(stuck[0])
    reading, noise = hold.cells.high[0, axis], hold.floor.sigma[axis]
    return Refusal(
        reason=RefusalCode.STUCK,
        words=f"accelerometer axis {AXES[axis]} stays at {reading:g} (raw) although its noise is {noise:.3g}: "
        "at the end of its range, or broken",
        remedy="choose a larger range, or check the instrument, then hold again",
        measured=0.0,
        limit=float(noise),
        unit="raw unit",
        axis=AXES[axis],
    )


def _check_gravity(hold: HoldUnderTest) -> Refusal | None:
    norm = float(np.linalg.norm(hold.scale.specific_force(hold.cells.mean[:, :3].mean(axis=0))))
    share = hold.settings.gravity_share_learned if hold.scale.learned else hold.settings.gravity_share
    limit = share * STANDARD_GRAVITY_M_S2
    if abs(norm - STANDARD_GRAVITY_M_S2) <= limit:
        return None
    return Refusal(
        reason=RefusalCode.GRAVITY,
        words=f"at rest the accelerometer shows {norm:.2f} m/s^2, further than {limit:.2f} m/s^2 from gravity",
        remedy="check the unit, range and scale settings of the driver",
        measured=norm,
        limit=limit,
        unit="m/s^2",
    )


def _check_knocks(hold: HoldUnderTest) -> Refusal | None:
    share = float(knocked(hold.cells, hold.limits).mean())
    # What is cut out of a hold in the hand leaves a hole through which the sway comes in.
    allowed = hold.settings.knocked_share if hold.held is None else 0.0
    if share <= allowed:
        return None
    return Refusal(
        reason=RefusalCode.KNOCKED,
        words=f"knocks or vibration in {100 * share:.0f} % of the hold (limit {100 * allowed:.0f} %)",
        remedy="keep hands and machines off the table, and hold again",
        measured=100 * share,
        limit=100 * allowed,
        unit="%",
    )


def _check_shift(hold: HoldUnderTest) -> Refusal | None:
    """Refuse a unit that was pushed: its direction before and after some moment differ."""
    force = hold.scale.specific_force(hold.cells.mean[:, :3])
    step, sigma, row = largest_step(force)
    norm = float(np.linalg.norm(force.mean(axis=0)))
    turn = math.degrees(float(np.linalg.norm(step)) / norm)
    limit = max(_harmless_shift_deg(hold, force, norm), 6 * math.degrees(sigma / norm))
    if turn <= limit:
        return None
    after_s = float(hold.cells.start_s[row] - hold.cells.start_s[0])
    axis = AXES[int(np.argmax(np.abs(step)))]
    return Refusal(
        reason=RefusalCode.KNOCKED,
        words=f"it was pushed by {turn:.2f} deg after {after_s:.1f} s of the hold (limit {limit:.2f} deg, axis {axis})",
        remedy="leave it: it is measured again",
        measured=turn,
        limit=limit,
        unit="deg",
        axis=axis,
    )


def _harmless_shift_deg(hold: HoldUnderTest, force: FloatArray, norm: float) -> float:
    """Return the turn in the middle of a hold that shortens the mean, by its square over 8, by 1 sigma of the mean."""
    along = force @ force.mean(axis=0) / norm
    variance = float(along.var(ddof=1)) / len(along) * correlation_factor(along - along.mean())
    return min(
        hold.settings.shift_deg, max(hold.settings.least_shift_deg, math.degrees(math.sqrt(8 * math.sqrt(variance) / norm)))
    )


def _check_jolt(hold: HoldUnderTest) -> Refusal | None:
    """Refuse a hold in the hand that was bumped: cutting the bump out would let the sway through."""
    held = hold.held
    limit = math.inf if held is None else hold.settings.jolt_share * held.usual_jolt_m_s2
    if held is None or held.jolt_m_s2 <= limit:
        return None
    return Refusal(
        reason=RefusalCode.KNOCKED,
        words=f"it was bumped after {held.jolt_after_s:.1f} s: a jolt of {held.jolt_m_s2:.2f} m/s^2 (limit {limit:.2f} m/s^2)",
        remedy="go on holding: it is measured again",
        measured=held.jolt_m_s2,
        limit=limit,
        unit="m/s^2",
    )


def _check_tremor(hold: HoldUnderTest) -> Refusal | None:
    held = hold.held
    if held is None or held.tremor_deg <= hold.settings.tremor_deg:
        return None
    return Refusal(
        reason=RefusalCode.TREMBLING,
        words=f"the hand trembles by {held.tremor_deg:.2f} deg rms (limit {hold.settings.tremor_deg:g} deg)",
        remedy="rest the arm on something, or lean the unit against a support; it is measured again",
        measured=held.tremor_deg,
        limit=hold.settings.tremor_deg,
        unit="deg",
    )


def _check_sway(hold: HoldUnderTest) -> Refusal | None:
    held = hold.held
    if held is None or held.sway_deg <= hold.settings.sway_deg:
        return None
    return Refusal(
        reason=RefusalCode.SWAYING,
        words=f"the hand sways by {held.sway_deg:.1f} deg rms (limit {hold.settings.sway_deg:g} deg)",
        remedy="rest the elbows on the table, or lean the unit against a support; it is measured again",
        measured=held.sway_deg,
        limit=hold.settings.sway_deg,
        unit="deg",
    )


def largest_step(series: FloatArray) -> tuple[FloatArray, float, int]:
    """Return the largest difference between the means after and before a row, its 1 sigma, and the row.

    Parameters
    ----------
    series : ndarray, shape (m, 3)
        Zero and infinite sigma for fewer than 10 rows.
    """
    m, least = len(series), 5
    if m < 2 * least:
        return np.zeros(3), math.inf, 0
    before = np.arange(least, m - least + 1)
    sums = np.cumsum(series - series.mean(axis=0), axis=0)[before - 1]
    steps = -sums * (m / (before * (m - before)))[:, None]
    worst = int(np.argmax(np.linalg.norm(steps, axis=1) * np.sqrt(before * (m - before))))
    row = int(before[worst])
    residual = np.concatenate([part - part.mean(axis=0) for part in (series[:row], series[row:])])
    factor = max(correlation_factor(column) for column in residual.T)
    variance = float((residual**2).sum()) / (m - 2) * factor * m / (row * (m - row))
    return steps[worst], math.sqrt(variance), row


def _check_drift(hold: HoldUnderTest) -> Refusal | None:
    """Refuse a mean that creeps: settling foam, a warming instrument, a hand that tires."""
    force = hold.scale.specific_force(hold.cells.mean[:, :3])
    mean = force.mean(axis=0)
    norm = float(np.linalg.norm(mean))
    along = force @ mean / norm
    change, sigma = change_over(along)
    limit = max(hold.settings.drift_m_s2, 4 * sigma)
    if abs(change) > limit:
        return _drift_refusal(
            f"the reading drifts by {1e3 * abs(change):.1f} mm/s^2", abs(change), limit, "m/s^2", direction=mean
        )
    changes = np.array([change_over(column) for column in force.T])
    sideways = changes[:, 0] - mean * (mean @ changes[:, 0]) / norm**2
    turn = math.degrees(float(np.linalg.norm(sideways)) / norm)
    limit = max(hold.settings.tilt_deg, 4 * math.degrees(float(changes[:, 1].max()) / norm))
    if turn > limit:
        return _drift_refusal(f"the unit tilts by {turn:.2f} deg", turn, limit, "deg", direction=sideways)
    return None


def _drift_refusal(found: str, measured: float, limit: float, unit: str, *, direction: FloatArray) -> Refusal:
    shown = f"{1e3 * limit:.1f} mm/s^2" if unit == "m/s^2" else f"{limit:.2f} deg"
    axis = AXES[int(np.argmax(np.abs(direction)))]
    return Refusal(
        reason=RefusalCode.DRIFTING,
        words=f"{found} over the hold (limit {shown}, axis {axis})",
        remedy="leave it: it is measured again; if this repeats, use a firmer support or let the unit warm up",
        measured=measured,
        limit=limit,
        unit=unit,
        axis=axis,
    )


def change_over(series: FloatArray) -> tuple[float, float]:
    """Return the change of a straight line through a series (m,) from end to end, and its 1 sigma."""
    m = len(series)
    if m < 4:
        return 0.0, math.inf
    time = np.linspace(-0.5, 0.5, m)
    slope = float(time @ series / (time @ time))
    residual = series - series.mean() - slope * time
    variance = float(residual @ residual) / (m - 2) * correlation_factor(residual)
    return slope, math.sqrt(variance / float(time @ time))
