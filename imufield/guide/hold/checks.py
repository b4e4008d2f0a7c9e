"""Checks of a hold before it counts. Each gives a refusal with value, limit, axis and remedy, or None.

Clipping that the instrument does not flag is found across holds: ``cross_checks.outputs``. Of which position a hold is, and
that this one is measured already, is decided before it begins: ``lead.guide_actions.recognise``, with the nearness of
``lead.plan``. ``hold_time`` decides how long a hold lasts, and ``observe`` which cells of a
stretch count. The words are in ``guide/sentences.toml``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imufield.dataclass import dataclass
from imufield.earth import STANDARD_GRAVITY_M_S2
from imufield.guide import refusals
from imufield.guide.hold.hand_mean import HandMean
from imufield.guide.hold.observe import correlation_factor, knocked
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.limits import Limits
from imufield.guide.stillness.noise_floor import NoiseFloor
from imufield.guide.stillness.scale import RoughScale
from imufield.samples import AXES, FloatArray, Status

# The norm may be off g by this share where the stills have shown the offset: scales reach 0.1, a wrong unit or range gives 0.5.
_GRAVITY_SHARE = 0.25
_OFFSET_SHARE = 0.88  # The same before: offsets of 0.5 g on three axes, common in cheap parts, make 0.87.
LOST_SHARE = 0.05  # Samples of a hold that may be missing or unusable.
# Samples at an end of the range from which a hold is refused, as a share and in number: 0.1 % takes 0.03 % of the noise's sigma
# from the mean, and one or two are a knock.
CLIPPED_SHARE = 0.001
CLIPPED_SAMPLES = 3
_KNOCKED_PERCENT = 10.0  # Cells of a hold that may be left out because they stand out.
# Change of the norm over a hold that is refused if it is beyond 6 sigma too; the mean corresponds to the middle of the line.
_DRIFT_M_S2 = 0.01
_TILT_DEG = 1.0  # Turn of the mean direction over a hold that is refused: the norm of the mean loses 13 ug by it.
# Sudden turn within a hold that is refused if it is beyond 6 sigma too: the norm of the mean loses 3 ug by it.
_SHIFT_DEG = 0.3
_LEAST_SHIFT_DEG = 0.05  # A smaller one never is: 0.1 ug. Between the two the limit is what costs 1 sigma of the mean.
# Of a drift or a turn. By Student's distribution with the 17 to 35 cells of a hold of 2.5 to 4 s noise alone passes 4 sigma
# in one hold of 900 to 3000, or in one session of 40 holds in 50; it passes 6 in one hold of 40,000 at most.
_REFUSED_SIGMAS = 6.0
# Of the usual jolt of a hold in the hand: tremor and noise make up to 4, bumps that shift the mean 15 to 600; a slow one
# that makes less stands out of the cells.
JOLT_SHARE = 8.0
# Of a hold in the hand, rms of each axis: what the frame of the gyroscope corrects to 5 ug (tremor) and 15 ug (sway).
_TREMOR_DEG = 0.2
_SWAY_DEG = 1.5
_LEAST_ROWS = 5  # On both sides of a sudden turn: a mean of fewer cells is mostly noise.


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldUnderTest:
    """The trimmed cells of a hold and the standards that the checks compare them with."""

    cells: Cells
    floor: NoiseFloor
    limits: Limits
    scale: RoughScale
    hand_mean: HandMean | None = None
    """For a hold in the hand."""


def examine(hold: HoldUnderTest) -> Refusal | None:
    """Return the first reason to refuse a hold, None when there is none."""
    return next((refusal for refusal in _refusals_in_order(hold) if refusal is not None), None)


def _refusals_in_order(hold: HoldUnderTest) -> Iterator[Refusal | None]:
    hand = hold.hand_mean
    yield _check_flags(hold)
    # Then nothing could shift or drift.
    if hold.scale.is_zero(hold.cells.mean[:, :3].mean(axis=0)):
        yield refusals.GRAVITY.refusal(0.0, _OFFSET_SHARE * STANDARD_GRAVITY_M_S2)
    if hand is not None:
        # Cutting a bump out would let the sway through.
        yield refusals.BUMPED.beyond(hand.jolt_m_s2, JOLT_SHARE * hand.usual_jolt_m_s2, after_s=hand.jolt_after_s)
    knocked_percent = 100 * float(knocked(hold.cells, hold.limits).mean())
    # What is cut out of a hold in the hand leaves a hole through which the sway comes in.
    yield refusals.KNOCKED.beyond(knocked_percent, _KNOCKED_PERCENT if hand is None else 0.0)
    if hand is None:
        yield _check_shift(hold)
        yield _check_drift(hold)
    else:
        yield refusals.TREMBLING.beyond(hand.tremor_deg, _TREMOR_DEG)
        yield refusals.SWAYING.beyond(hand.sway_deg, _SWAY_DEG)


def _check_flags(hold: HoldUnderTest) -> Refusal | None:
    """Refuse a hold of which too many samples are lost or unusable, or the accelerometer clipped."""
    cells = hold.cells
    slots = int(cells.slot[-1] - cells.slot[0]) + 1
    lost_share = 1 - float(cells.usable.sum()) / (slots * hold.floor.samples_per_cell)
    if lost_share > LOST_SHARE:
        return explain_flags(cells, lost_share, LOST_SHARE)
    # Clipped samples stay out of the mean by their flags: those that are left show one side of the noise.
    out = int(cells.clipped.sum())
    share = out / int(cells.count.sum())
    clipped = out >= CLIPPED_SAMPLES and share > CLIPPED_SHARE
    return explain_flags(cells, share, CLIPPED_SHARE) if clipped else None


def check_gravity(mean_raw: FloatArray, scale: RoughScale) -> Refusal | None:
    """Refuse a mean (3,) whose length is not gravity's by what is known of scale and offset."""
    # A scale learned from a still, with the offset in it, shows nothing before the offset is known.
    if scale.learned and not scale.centred:
        return None
    norm = float(np.linalg.norm(scale.specific_force(mean_raw)))
    limit_m_s2 = (_GRAVITY_SHARE if scale.centred else _OFFSET_SHARE) * STANDARD_GRAVITY_M_S2
    return refusals.GRAVITY.refusal(norm, limit_m_s2) if abs(norm - STANDARD_GRAVITY_M_S2) > limit_m_s2 else None


def explain_flags(cells: Cells, share: float, limit: float) -> Refusal:
    """Return the refusal of cells of whose samples too large a share is unusable, by their flags."""
    flags = Status(int(np.bitwise_or.reduce(cells.flags)) & 0xFFFF)
    percent, limit_percent = 100 * share, 100 * limit
    if flags & (Status.ACCELEROMETER_SATURATED | Status.GYROSCOPE_SATURATED):
        triad, first = ("accelerometer", 0) if flags & Status.ACCELEROMETER_SATURATED else ("gyroscope", 3)
        peak = np.fmax(np.abs(cells.low), np.abs(cells.high))[:, first : first + 3]
        axis = AXES[int(np.argmax(np.nan_to_num(np.nanmax(peak, axis=0))))] if np.isfinite(peak).any() else None
        kind = refusals.SATURATED_ON_AXIS if axis else refusals.SATURATED
        return kind.refusal(percent, limit_percent, axis=axis, triad=triad)
    for flag, kind in (
        (Status.START_UP, refusals.START_UP),
        (Status.INSTRUMENT_FAULT, refusals.FAULT),
        (Status.ACCELEROMETER_INVALID, refusals.ACCELEROMETER_INVALID),
        (Status.GYROSCOPE_INVALID, refusals.GYROSCOPE_INVALID),
        (Status.CLOCK_SET, refusals.CLOCK_SET),
    ):
        if flags & flag:
            return kind.refusal(percent, limit_percent)
    return refusals.SAMPLE_LOSS.refusal(percent, limit_percent)


def _check_shift(hold: HoldUnderTest) -> Refusal | None:
    """Refuse a unit that was pushed: its direction before and after some moment differ."""
    force = hold.scale.specific_force(hold.cells.mean[:, :3])
    step, sigma, row = largest_step(force)
    norm = float(np.linalg.norm(force.mean(axis=0)))
    turn = math.degrees(float(np.linalg.norm(step)) / norm)
    # A turn in the middle of a hold shortens the mean by its square over 8: the harmless one by 1 sigma of the mean.
    along = force @ force.mean(axis=0) / norm
    variance = float(along.var(ddof=1)) / len(along) * correlation_factor(along - along.mean())
    harmless = min(_SHIFT_DEG, max(_LEAST_SHIFT_DEG, math.degrees(math.sqrt(8 * math.sqrt(variance) / norm))))
    limit = max(harmless, _REFUSED_SIGMAS * math.degrees(sigma / norm))
    after_s = float(hold.cells.start_s[row] - hold.cells.start_s[0])
    return refusals.PUSHED.beyond(turn, limit, axis=AXES[int(np.argmax(np.abs(step)))], after_s=after_s)


def largest_step(series: FloatArray) -> tuple[FloatArray, float, int]:
    """Return the largest difference between the means after and before a row, its 1 sigma, and the row.

    Parameters
    ----------
    series : ndarray, shape (m, 3)
        Zero and infinite sigma for fewer than 10 rows.
    """
    m = len(series)
    if m < 2 * _LEAST_ROWS:
        return np.zeros(3), math.inf, 0
    before = np.arange(_LEAST_ROWS, m - _LEAST_ROWS + 1)
    sums = np.cumsum(series - series.mean(axis=0), axis=0)[before - 1]
    steps = -sums * (m / (before * (m - before)))[:, None]
    # The step whose size over its own sigma is largest: a step at an end is known from few rows only.
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
    (change, *changes), (sigma, *sigmas) = change_over(np.column_stack([force @ mean / norm, force])).tolist()
    limit = max(_DRIFT_M_S2, _REFUSED_SIGMAS * sigma)
    if abs(change) > limit:
        axis = AXES[int(np.argmax(np.abs(mean)))]
        drift, allowed = 1e3 * abs(change), 1e3 * limit
        return refusals.DRIFTS.refusal(abs(change), limit, axis=axis, drift_mm_s2=drift, limit_mm_s2=allowed)
    sideways = changes - mean * (mean @ changes) / norm**2
    turn = math.degrees(float(np.linalg.norm(sideways)) / norm)
    limit = max(_TILT_DEG, _REFUSED_SIGMAS * math.degrees(max(sigmas) / norm))
    return refusals.TILTS.beyond(turn, limit, axis=AXES[int(np.argmax(np.abs(sideways)))])


def change_over(series: FloatArray) -> FloatArray:
    """Return the changes of straight lines through k series (m, k) from end to end, and their 1 sigma, shape (2, k)."""
    m, k = series.shape
    if m < 4:
        return np.array([[0.0] * k, [math.inf] * k])
    time = np.linspace(-0.5, 0.5, m)
    square = float(time @ time)
    slope = time @ series / square
    residual = series - series.mean(axis=0) - np.outer(time, slope)
    factor = np.array([correlation_factor(column) for column in residual.T])
    return np.array([slope, np.sqrt((residual**2).sum(axis=0) / (m - 2) * factor / square)])
