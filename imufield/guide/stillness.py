"""When the unit lies still: cells in, judgements out.

Each cell is compared with limits that come from the measured noise floor, in two ways for each triad:

vibration   the scatter inside the cell against the floor's, r = sqrt(mean over axes of (variance / limit^2));
change      the cell's mean against the running mean of the still stretch, r = sqrt(sum over axes of (difference / limit)^2).

Together they are the generalised likelihood ratio of Skog et al. [1]_ (is the force of constant size and direction, is the
rate that of a unit at rest?), kept apart so that a refusal can name triad, axis, value and limit. The largest r is the
*activity*: a stretch begins when it stays at or below 1 for the dwell time and ends when it exceeds the leave factor (2):
without this hysteresis a unit at the limit would flicker between still and moving.

A limit is a multiple of the noise floor, or an absolute allowance where that is larger: a table that trembles by 5 mg under
a navigation-grade instrument is still a table. The allowances are wide enough for a unit held against an edge. What they
let through is judged afterwards by the stretch's own standard: see ``trim_stretch``.

References
----------
.. [1] I. Skog, P. Handel, J.-O. Nilsson, J. Rantakokko, "Zero-velocity detection: an algorithm evaluation",
   IEEE Trans. Biomed. Eng. 57(11), 2010: equation 15.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from imufield.guide.cells import CELL_S, CellBuilder, Cells, join_cells
from imufield.guide.noise_floor import NoiseFloor, is_quiet, is_quieter, measure_floor
from imufield.guide.scale import RoughScale
from imufield.samples import AXES, FloatArray, Samples


@dataclass(frozen=True, slots=True)
class StillnessSettings:
    """Settings of the detector; the defaults need no tuning for any recording known to us."""

    cell_s: float = CELL_S
    floor_s: float = 3.0
    """Length of the quiet stretch that sets the noise floor."""
    dwell_s: float = 0.5
    """The activity stays at or below 1 for this long before a stretch counts as still; it counts from its first cell."""
    guard_s: float = 0.3
    """Cut off at both ends of a stretch: the hand that leaves, the hand that comes."""
    guard_without_gyroscope_s: float = 0.8
    """The same where only the accelerometer tells: a slow turn begins below its noise."""
    leave_factor: float = 2.0
    vibration_sigmas: float = 2.0
    change_sigmas: float = 5.0
    vibration_m_s2: float = 0.05
    change_m_s2: float = 0.03
    vibration_rad_s: float = math.radians(1.5)
    change_rad_s: float = math.radians(1.0)
    """The four absolute allowances, rms per axis for vibration, largest for change."""
    usable_fraction: float = 0.5
    """A cell with fewer usable samples than this share of the usual number counts as lost."""
    hand: bool = False
    """Bear a unit held in the hand as well, where the gyroscope's scale is known: see ``hand_settings``."""
    longest_s: float = 60.0
    """No more than this of a stretch is kept: beyond the minimum of the Allan deviation a hold gains nothing."""

    def cells(self, duration_s: float) -> int:
        """Return a duration as a whole number of cells."""
        return round(duration_s / self.cell_s)


def hand_settings(settings: StillnessSettings) -> StillnessSettings:
    """Return the settings for a unit in the hand.

    Tremor of 0.1 deg rms at 12 Hz is 7.5 deg/s, and 1 m/s^2 where the pivot is 10 cm away; sway of 1 deg below 2 Hz makes
    4 deg/s and changes the force by 0.4 m/s^2. A slow turn is no faster than that, so the hand must keep it up for longer.
    """
    return replace(
        settings,
        dwell_s=1.5,
        vibration_m_s2=1.2,
        change_m_s2=0.5,
        vibration_rad_s=math.radians(9.0),
        change_rad_s=math.radians(10.0),
    )


@dataclass(frozen=True, slots=True)
class Limits:
    """Where the activity is 1, in raw rates; arrays of shape (6,), accelerometer first."""

    vibration: FloatArray
    change: FloatArray
    gyroscope_offset: float
    """Largest change ratio of the gyroscope against its last known bias; g-sensitivity and temperature are in it."""


@dataclass(frozen=True, slots=True)
class Activity:
    """The largest of the ratios of a cell, with what it was measured on."""

    ratio: float
    kind: str
    """"vibration" or "change"."""
    triad: str
    """"accelerometer" or "gyroscope"."""
    axis: str
    """The axis that contributes most."""
    measured: float
    """Ratio times limit, in ``unit``: the rms over the axes (vibration) or the size of the vector (change)."""
    limit: float
    unit: str


class Phase(Enum):
    """What the detector thinks of the latest cell."""

    MOVING = "moving"
    SETTLING = "settling"
    STILL = "still"


class Stretch:
    """The cells of a still stretch, oldest first, at most ``longest`` of them."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._parts: list[tuple[Cells, int, int]] = []
        self.mean: list[float] = []
        self.judged = 0
        """Cells that belong to the stretch, kept or not."""

    def add(self, cells: Cells, row: int, mean: list[float]) -> None:
        """Append one cell and follow the running mean: of all cells at first, of the last 50 or so later."""
        if self.judged < self._longest:
            if self._parts and self._parts[-1][0] is cells and self._parts[-1][2] == row:
                self._parts[-1] = (cells, self._parts[-1][1], row + 1)
            else:
                self._parts.append((cells, row, row + 1))
        self.judged += 1
        if not self.mean:
            self.mean = list(mean)
            return
        share = 1 / min(self.judged, 50)
        self.mean = [old if math.isnan(new) else old + share * (new - old) for old, new in zip(self.mean, mean, strict=True)]

    def cells(self) -> Cells:
        """Return the kept cells; at least one was added."""
        return join_cells([cells[start:stop] for cells, start, stop in self._parts])

    def __len__(self) -> int:
        return min(self.judged, self._longest)


class Judgement(NamedTuple):
    """What one cell meant."""

    phase: Phase
    activity: float
    cells: Cells
    row: int
    reference: list[float]
    """Running mean of the stretch before this cell, raw rates (6); empty outside a stretch."""
    began: bool = False
    """A stretch counts as still with this cell."""
    ended: Stretch | None = None
    """The stretch that this cell ended."""
    limits: Limits | None = None
    """Those that the activity was measured against; None: those of a placed unit."""


def noise_limits(floor: NoiseFloor, scale: RoughScale, settings: StillnessSettings) -> Limits:
    """Return the limits for a noise floor."""
    allowances = (
        (settings.vibration_m_s2, settings.vibration_rad_s),
        (settings.change_m_s2, settings.change_rad_s),
    )
    vibration, change = (
        np.repeat([accelerometer * (scale.accelerometer or 0.0), gyroscope * (scale.gyroscope or 0.0)], 3)
        for accelerometer, gyroscope in allowances
    )
    step = np.where(np.isfinite(floor.step), floor.step, 0.0)
    sigmas = max(settings.vibration_sigmas, scatter_of_variance(3 * (floor.samples_per_cell - 1)))
    vibration = np.maximum(vibration, sigmas * np.maximum(floor.sigma, step / 2))
    change = np.maximum(change, settings.change_sigmas * np.maximum(floor.cell_sigma, step / 2))
    return Limits(
        # An axis that shows no noise and has no known scale (a dead one) sets no limit.
        np.where(vibration > 0, vibration, np.inf),
        np.where(change > 0, change, np.inf),
        1.5 if scale.gyroscope else 6.0,
    )


def scatter_of_variance(freedom: float) -> float:
    """Return the factor on sigma that a sample variance exceeds once in a million cells.

    Laurent and Massart, Ann. Statist. 28(5), 2000, lemma 1: P(chi2_k >= k + 2 sqrt(k x) + 2 x) <= exp(-x).
    """
    if freedom <= 0:
        return 0.0
    x = 14.0
    return math.sqrt(1 + 2 * math.sqrt(x / freedom) + 2 * x / freedom)


class _Standard(NamedTuple):
    """What a cell is held against, with the limits in the form that the loop over cells needs."""

    limits: Limits
    change_weight: list[float]
    """1 / change, 0 where there is no gyroscope."""
    usual_samples: float

    @classmethod
    def of(cls, floor: NoiseFloor, limits: Limits) -> _Standard:
        weight = np.where(np.isnan(limits.change), 0.0, 1 / limits.change)
        return cls(limits, weight.tolist(), floor.samples_per_cell)


HAND_RAD_S = math.radians(0.35)
"""Vibration of the gyroscope beyond its noise that tells a hand: the smallest tremor (0.02 deg rms at 8 Hz) makes 1 deg/s."""
HAND_CHANGE_RAD_S = math.radians(0.15)
"""The same for the change from cell to cell: the sway of an arm."""

_NO_STANDARD = _Standard(Limits(np.full(6, np.inf), np.full(6, np.inf), 1.0), [0.0] * 6, 0.0)


class _Tracker:
    """Follows a stream of cells under one standard: moving, settling or still, and the stretch under way."""

    def __init__(self, settings: StillnessSettings) -> None:
        self.settings = settings
        self.standard = _NO_STANDARD
        self.phase = Phase.MOVING
        self.stretch = Stretch(settings.cells(settings.longest_s))

    def restart(self) -> None:
        self.stretch = Stretch(self.settings.cells(self.settings.longest_s))
        self.phase = Phase.MOVING

    def follow(self, cells: Cells, row: int, vibration: float, mean: list[float], where: tuple[bool, list[float]]) -> Judgement:
        """Judge one cell; ``where`` says whether it follows the one before, and the gyroscope's bias."""
        unbroken, bias = where
        activity = max(vibration, self._change_ratio(mean))
        reference, limits = self.stretch.mean, self.standard.limits
        if self.phase is Phase.STILL:
            if unbroken and activity <= self.settings.leave_factor:
                self.stretch.add(cells, row, mean)
                return Judgement(Phase.STILL, activity, cells, row, reference, limits=limits)
            ended = self.stretch
            self._begin(cells, row, vibration, mean, bias)
            return Judgement(self.phase, activity, cells, row, reference, ended=ended, limits=limits)
        if unbroken and activity <= 1 and self.stretch.judged:
            self.stretch.add(cells, row, mean)
            began = self.stretch.judged >= self.settings.cells(self.settings.dwell_s)
            self.phase = Phase.STILL if began else Phase.SETTLING
            return Judgement(self.phase, activity, cells, row, reference, began=began, limits=limits)
        self._begin(cells, row, vibration, mean, bias)
        return Judgement(self.phase, activity, cells, row, reference, limits=limits)

    def _begin(self, cells: Cells, row: int, vibration: float, mean: list[float], bias: list[float]) -> None:
        """Begin a candidate with this cell if it could be the first of a stretch."""
        self.restart()
        if vibration <= 1 and self._offset_ratio(mean, bias) <= 1:
            self.stretch.add(cells, row, mean)
            self.phase = Phase.SETTLING

    def _change_ratio(self, mean: list[float]) -> float:
        """Return the larger change ratio of the two triads against the stretch's running mean, 0 without one."""
        before = self.stretch.mean
        if not before:
            return 0.0
        weight = self.standard.change_weight
        accelerometer = math.hypot(*((mean[i] - before[i]) * weight[i] for i in range(3)))
        gyroscope = math.hypot(*((mean[i] - before[i]) * weight[i] for i in range(3, 6)))
        return max(accelerometer, gyroscope)

    def _offset_ratio(self, mean: list[float], bias: list[float]) -> float:
        """Return the gyroscope's distance from its last known bias over what is allowed, 0 without a gyroscope."""
        if not bias:
            return 0.0
        weight = self.standard.change_weight
        distance = math.hypot(*((mean[i] - bias[i - 3]) * weight[i] for i in range(3, 6)))
        return 0.0 if math.isnan(distance) else distance / self.standard.limits.gyroscope_offset


class StillnessDetector:
    """Judges cells as they come.

    The result does not depend on how the samples are cut into blocks. Cells that arrive before the noise floor is known
    are judged as soon as it is, none is lost. With ``settings.hand`` a second set of limits is held beside the first: a
    unit that is not still as on a table may be as still as a hand is.

    Parameters
    ----------
    settings : StillnessSettings
    scale : RoughScale
        What is known of the raw units.
    """

    LONGEST_WAIT_S = 600.0
    """Cells kept while no quiet stretch has been seen; older ones are let go."""
    LEARN_FROM_S = 2.0
    """Shortest stretch that may lower the noise floor or tell the gyroscope's bias."""

    def __init__(self, scale: RoughScale, settings: StillnessSettings | None = None) -> None:
        self.settings = settings or StillnessSettings()
        self.scale = scale
        self.floor: NoiseFloor | None = None
        """None until a quiet stretch was seen."""
        self._table = _Tracker(self.settings)
        self._hand = _Tracker(hand_settings(self.settings)) if self.settings.hand and scale.gyroscope else None
        self.in_hand = False
        """Whether ``phase`` and ``stretch`` are those of a unit in the hand."""
        self.bias: list[float] = []
        """Gyroscope at rest, raw rate, from the last still stretch; empty without a gyroscope."""
        self._builder = CellBuilder(self.settings.cell_s)
        self._waiting: list[Cells] = []
        self._slot: int | None = None

    @property
    def limits(self) -> Limits:
        """Limits of a placed unit in force; infinite until there is a noise floor."""
        return self._table.standard.limits

    @property
    def phase(self) -> Phase:
        """What the detector thinks of the latest cell."""
        return self._active.phase

    @property
    def stretch(self) -> Stretch:
        """The stretch under way."""
        return self._active.stretch

    @property
    def _active(self) -> _Tracker:
        return self._hand if self.in_hand and self._hand is not None else self._table

    def feed(self, samples: Samples) -> list[Judgement]:
        """Judge the cells that these samples finish."""
        cells = self._builder.feed(samples)
        return [] if cells is None else list(self.judge(cells))

    def flush(self) -> list[Judgement]:
        """Judge the unfinished cell; for the end of a recording or of a link."""
        cells = self._builder.flush()
        return [] if cells is None else list(self.judge(cells))

    def restart(self) -> None:
        """Forget the current stretch: the next one begins with the next cell at the earliest."""
        self._table.restart()
        if self._hand is not None:
            self._hand.restart()
        self.in_hand = False

    def interrupt(self) -> None:
        """Forget the current stretch and where the clock was: the link is gone, or comes from another start."""
        self.restart()
        self._builder = CellBuilder(self.settings.cell_s)
        self._slot = None

    def judge(self, cells: Cells) -> Iterator[Judgement]:
        """Judge finished cells one by one; between two of them ``stretch`` and ``phase`` are as the last one left them."""
        if self.floor is None and len(cells):
            cells = self._learn(cells)
        judged = 0
        while self.floor is not None and judged < len(cells):
            # A floor lowered by one cell holds from the next on, wherever the block was cut.
            for judgement in self._judge_under_one_floor(cells, judged):
                judged += 1
                yield judgement

    def explain(self, judgement: Judgement) -> Activity:
        """Return what the activity of a cell comes from, with value and limit in SI where the scale is known."""
        limits = judgement.limits or self.limits
        mean = judgement.cells.mean[judgement.row]
        reference = np.array(judgement.reference) if judgement.reference else mean
        vibration = np.sqrt(judgement.cells.variance[judgement.row]) / limits.vibration
        return largest_activity(vibration, np.abs(mean - reference) / limits.change, limits, self.scale)

    def is_hand_like(self, cells: Cells) -> bool:
        """Whether a stretch moves as a hand does: the gyroscope shows more than its noise, in most of its cells."""
        floor, gyroscope = self.floor, self.scale.gyroscope
        if floor is None or not gyroscope or not floor.has_gyroscope:
            return False
        excess = np.median((cells.variance[:, 3:] - floor.sigma[3:] ** 2).mean(axis=1))
        change = np.median(np.abs(np.diff(cells.mean[:, 3:], axis=0)), axis=0) if len(cells) > 1 else np.zeros(3)
        shakes = math.sqrt(max(float(excess), 0.0)) > HAND_RAD_S * gyroscope
        return shakes or bool((change > np.maximum(HAND_CHANGE_RAD_S * gyroscope, 3 * floor.cell_sigma[3:])).any())

    def _learn(self, cells: Cells) -> Cells:
        """Look for a quiet window that ends in these cells; return what can be judged now: all cells so far, or none."""
        window = self.settings.cells(self.settings.floor_s)
        self._waiting.append(cells)
        tail = join_cells([*self._waiting[-window:-1], cells])
        for end in range(max(len(tail) - len(cells) + 1, window), len(tail) + 1):
            if is_quiet(tail[end - window : end], self.scale):
                self._set_floor(measure_floor(tail[end - window : end]))
                waiting, self._waiting = join_cells(self._waiting), []
                return waiting
        kept = sum(len(part) for part in self._waiting)
        while kept > self.settings.cells(self.LONGEST_WAIT_S):
            kept -= len(self._waiting.pop(0))
        return cells[:0]

    def _set_floor(self, floor: NoiseFloor) -> None:
        self.scale = self.scale.learn(floor.mean[:3])
        self.floor = floor
        for tracker in self._trackers():
            tracker.standard = _Standard.of(floor, noise_limits(floor, self.scale, tracker.settings))
        if not self.bias and floor.has_gyroscope:
            self.bias = floor.mean[3:].tolist()

    def _trackers(self) -> tuple[_Tracker, ...]:
        return (self._table,) if self._hand is None else (self._table, self._hand)

    def _judge_under_one_floor(self, cells: Cells, start: int) -> Iterator[Judgement]:
        standard = self._table.standard
        vibration = [vibration_ratio(cells[start:], tracker.standard.limits).tolist() for tracker in self._trackers()]
        means = cells.mean[start:].tolist()
        slots = cells.slot[start:].tolist()
        full = (cells.usable[start:] >= self.settings.usable_fraction * standard.usual_samples).tolist()
        for offset, mean in enumerate(means):
            gap = 1 if self._slot is None else slots[offset] - self._slot
            if full[offset]:
                self._slot = slots[offset]
                # One lost cell between two is bridged.
                where = (gap in (1, 2), self.bias)
                row = start + offset
                found = [
                    tracker.follow(cells, row, ratio[offset], mean, where)
                    for tracker, ratio in zip(self._trackers(), vibration, strict=True)
                ]
                yield self._choose(*found)
            else:
                yield self._judge_lost(cells, start + offset, gap)
            if self._table.standard is not standard:
                return

    def _choose(self, table: Judgement, hand: Judgement | None = None) -> Judgement:
        """Return the judgement that counts: of the table where it is still, else of the hand.

        A hold goes over from the table's limits to the hand's only where it looked like a hand all the time; a unit on a table
        that is pushed has ended its hold.
        """
        if table.ended is not None:
            self._learn_from(table.ended)
        if hand is None or self._hand is None:
            return table
        if self.in_hand:
            if table.phase is Phase.STILL and self._was_put_down():
                self.in_hand = False
                self._hand.restart()
                return table
            if hand.phase is Phase.STILL:
                return hand
            self.in_hand = False
            return hand if hand.ended is None or table.phase is Phase.STILL else hand._replace(phase=table.phase)
        if table.phase is Phase.STILL:
            return table
        if table.ended is not None:
            if hand.phase is Phase.STILL and self.is_hand_like(table.ended.cells()):
                self.in_hand = True
                return hand
            self._hand.restart()
            return table
        if hand.phase is Phase.STILL:
            self.in_hand = True
        return table if hand.phase is Phase.MOVING else hand

    def _was_put_down(self) -> bool:
        """Whether a hold that began in the hand goes on upon a table: looked at once a second."""
        stretch = self._table.stretch
        return stretch.judged % self.settings.cells(1.0) == 0 and not self.is_hand_like(stretch.cells())

    def _judge_lost(self, cells: Cells, row: int, gap: int) -> Judgement:
        """Judge a cell that is nearly empty: the first is passed over, the second in a row ends a stretch."""
        if gap == 1:
            return Judgement(self.phase, 0.0, cells, row, self.stretch.mean)
        ended = self.stretch if self.phase is Phase.STILL else None
        if ended is not None and not self.in_hand:
            self._learn_from(ended)
        self.restart()
        return Judgement(self.phase, 0.0, cells, row, [], ended=ended)

    def _learn_from(self, stretch: Stretch) -> None:
        """Learn from a stretch that ended: the gyroscope's bias, and the noise floor if it was quieter."""
        if self.floor is None or stretch.judged < self.settings.cells(self.LEARN_FROM_S):
            return
        cells = stretch.cells()
        inner = cells[len(cells) // 4 : len(cells) - len(cells) // 4]
        if self.bias:
            self.bias = np.where(np.isnan(mean := np.nanmean(inner.mean[:, 3:], axis=0)), self.bias, mean).tolist()
        quieter = measure_floor(inner)
        if is_quieter(quieter, self.floor) and is_quiet(inner, self.scale):
            self._set_floor(quieter)


def vibration_ratio(cells: Cells, limits: Limits) -> FloatArray:
    """Return the larger vibration ratio of the two triads for each cell, shape (m,)."""
    share = cells.variance / limits.vibration**2
    # A missing gyroscope has no limit (NaN) and no share.
    share = np.where(np.isnan(share), 0.0, share)
    ratio: FloatArray = np.sqrt(np.maximum(share[:, :3].mean(axis=1), share[:, 3:].mean(axis=1)))
    return ratio


def largest_activity(vibration: FloatArray, change: FloatArray, limits: Limits, scale: RoughScale) -> Activity:
    """Return the largest of the four ratios and what it was measured on.

    Parameters
    ----------
    vibration, change : ndarray, shape (6,)
        Ratios of each axis.
    limits : Limits
    scale : RoughScale
    """
    found: list[Activity] = []
    for first, triad, factor, unit in (
        (0, "accelerometer", scale.accelerometer, "m/s^2"),
        (3, "gyroscope", scale.gyroscope, "rad/s"),
    ):
        axes = slice(first, first + 3)
        for kind, ratios, limit in (("vibration", vibration, limits.vibration), ("change", change, limits.change)):
            parts = np.nan_to_num(ratios[axes])
            ratio = float(np.sqrt((parts**2).mean() if kind == "vibration" else (parts**2).sum()))
            finite = limit[axes][np.isfinite(limit[axes])]
            in_unit = float(np.sqrt((finite**2).mean())) / (factor or 1.0) if len(finite) else math.inf
            axis = AXES[int(np.argmax(parts))]
            found.append(Activity(ratio, kind, triad, axis, ratio * in_unit, in_unit, unit if factor else "raw unit"))
    return max(found, key=lambda activity: activity.ratio)
