"""The stillness detector: whether each cell of 0.1 s is still, by limits from the noise floor.

Each cell is compared with limits that come from the measured noise floor, in two ways for each triad:

vibration   the scatter inside the cell against the floor's, r = sqrt(mean over axes of (variance / limit^2));
change      the cell's mean against the running mean of the still stretch, r = sqrt(sum over axes of (difference / limit)^2).

Together they are the generalised likelihood ratio of Skog et al. [1]_ (is the force of constant size and direction, is the
rate that of a unit at rest?), kept apart so that a refusal can name triad, axis, value and limit. The largest r is the
*activity*: a stretch begins when it stays at or below 1 for the dwell time and ends when it exceeds the leave factor (2):
without this hysteresis a unit at the limit would flicker between still and moving.

A limit is a multiple of the noise floor, or an absolute allowance where that is larger: a table that trembles by 5 mg under
a navigation-grade instrument is still a table. The allowances are wide enough for a unit held against an edge. What passes
them is judged afterwards by the stretch's own standard: ``trim_stretch`` in ``guide.hold.observe``, and ``guide.hold.checks``.

Here the floor is learnt and table or hand is told apart; ``limits`` has the allowances and the ratio of vibration, and
``stretch.Tracker`` that of change, the dwell time and the hysteresis.

References
----------
.. [1] I. Skog, P. Handel, J.-O. Nilsson, J. Rantakokko, "Zero-velocity detection: an algorithm evaluation",
   IEEE Trans. Biomed. Eng. 57(11), 2010: equation 15.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imufield.guide.stillness.cells import Cells, cells_in, join_cells
from imufield.guide.stillness.hand_edges import hand_edges
from imufield.guide.stillness.limits import (
    IN_HAND,
    ON_TABLE,
    Activity,
    Limits,
    largest_activity,
    noise_limits,
    vibration_ratio,
)
from imufield.guide.stillness.noise_floor import (
    FEW_SAMPLES,
    FLOOR_S,
    NoiseFloor,
    is_frozen,
    is_quiet,
    is_quieter,
    measure_floor,
)
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Judgement, Phase, Standard, Stretch, Tracker
from imufield.samples import Status, median

# No more than this of a stretch is kept: beyond the minimum of the Allan deviation a hold gains nothing.
LONGEST_KEPT_S = 60.0
USABLE_SHARE = 0.5  # A cell with fewer usable samples than this share of the usual number counts as lost.
# Vibration of the gyroscope beyond its noise that tells a hand: the smallest tremor (0.02 deg rms at 8 Hz) makes 1 deg/s.
_HAND_RAD_S = math.radians(0.35)
_HAND_CHANGE_RAD_S = math.radians(0.15)  # The same for the change from cell to cell: the sway of an arm.
_HAND_CHANGE_SIGMAS = 3.0  # Changes of noise alone are smaller.
LONGEST_WAIT_S = 600.0
"""Cells kept while no quiet stretch has occurred; older ones are discarded."""
_LEARN_FROM_S = 2.0  # Shortest stretch that may lower the noise floor or tell the gyroscope's bias.
_LOOK_AGAIN_S = 1.0  # Between two checks whether a unit in the hand was put down.


class StillnessDetector:
    """Judges cells as they come.

    The result does not depend on how the samples are cut into blocks. Cells that arrive before the noise floor is known
    are judged as soon as it is; none is lost.

    Parameters
    ----------
    scale : RoughScale
        What is known of the raw units.
    hand : bool
        Use a second set of limits beside the first, where the gyroscope's scale is known: a unit that is not still as on a
        table may be as still as a hand is.
    longest_s : float
        Length of a stretch that is kept.
    """

    def __init__(self, scale: RoughScale, *, hand: bool = False, longest_s: float = LONGEST_KEPT_S) -> None:
        self.scale = scale
        self.floor: NoiseFloor | None = None  # None until there was a quiet stretch.
        self._table = Tracker(ON_TABLE, longest_s)
        self._hand = Tracker(IN_HAND, longest_s) if hand and scale.gyroscope else None
        self._trackers = (self._table,) if self._hand is None else (self._table, self._hand)
        self.in_hand = False  # Whether ``phase`` and ``stretch`` are those of a unit in the hand.
        # The longest stretch as still as on a table within the latest hold in the hand, once it ended.
        self.stillest: Stretch | None = None
        self._rest: list[float] = []  # Raw rates (6) at rest, from the last still stretch; empty without a gyroscope.
        self._waiting: list[Cells] = []
        self._cells_waiting = 0
        self._tail: list[Cells] = []  # The last of those that wait, joined; a window may begin there.
        self._slot: int | None = None

    @property
    def knows_hands(self) -> bool:
        """Whether a unit may be as still as a hand is; what a hand does shows in its turns."""
        return self._hand is not None

    @property
    def limits(self) -> Limits:
        """Limits of a placed unit in force; infinite until there is a noise floor."""
        return self._table.standard.limits

    @property
    def phase(self) -> Phase:
        """State of the unit by the latest cell."""
        return self._active.phase

    @property
    def stretch(self) -> Stretch:
        """The stretch in progress."""
        return self._active.stretch

    @property
    def _active(self) -> Tracker:
        return self._hand if self.in_hand and self._hand is not None else self._table

    def restart(self) -> None:
        """Forget the current stretch: the next one begins with the next cell at the earliest."""
        for tracker in self._trackers:
            tracker.restart()
        self.in_hand = False

    def interrupt(self) -> None:
        """Forget the current stretch and where the clock was: the link is gone, or comes from another start."""
        self.restart()
        self._slot = None
        # Cells from before must not become part of a noise floor that is measured afterwards.
        self._waiting, self._cells_waiting, self._tail = [], 0, []

    def judge(self, cells: Cells) -> Iterator[Judgement]:
        """Judge finished cells one by one; between two of them ``stretch`` and ``phase`` are those after the first."""
        if self.floor is None and len(cells):
            cells = self._learn(cells)
        judged = 0
        while self.floor is not None and judged < len(cells):
            # A floor that one cell lowers applies from the next on, wherever the block was cut.
            for judgement in self._judge_under_one_floor(cells, judged):
                judged += 1
                yield judgement

    def waited(self, duration_s: float = FLOOR_S) -> Cells:
        """Return the last cells while there is no noise floor, by default as many as it needs; at least one was judged."""
        window = cells_in(duration_s)
        return join_cells(self._waiting[-window:])[-window:]

    @property
    def has_waited(self) -> bool:
        """Whether cells were judged and there is no noise floor yet."""
        return bool(self._waiting)

    @property
    def frozen(self) -> bool:
        """Whether there is no noise floor because no output changes."""
        return self.has_waited and len(cells := self.waited()) >= cells_in(FLOOR_S) and is_frozen(cells)

    def explain(self, judgement: Judgement) -> Activity:
        """Return the cause of a cell's activity, with value and limit in SI where the scale is known."""
        limits = judgement.limits or self.limits
        mean = judgement.cells.mean[judgement.row]
        reference = np.array(judgement.reference) if judgement.reference else mean
        vibration = np.sqrt(judgement.cells.variance[judgement.row]) / limits.vibration
        return largest_activity(vibration, np.abs(mean - reference) / limits.change, limits, self.scale)

    def hold_edges(self, cells: Cells) -> slice:
        """Return the rows of a hold in the hand that are not of the turns before and after it."""
        return slice(0, len(cells)) if self._hand is None else hand_edges(cells, self._hand.standard.limits.change)

    def is_hand_like(self, cells: Cells) -> bool:
        """Whether a stretch moves as a hand does: the gyroscope shows more than its noise, in most of its cells."""
        floor, gyroscope = self.floor, self.scale.gyroscope
        if floor is None or not gyroscope or not floor.has_gyroscope:
            return False
        excess = median((cells.variance[:, 3:] - floor.sigma[3:] ** 2).mean(axis=1))
        change = median(np.abs(np.diff(cells.mean[:, 3:], axis=0))) if len(cells) > 1 else np.zeros(3)
        shakes = math.sqrt(max(float(excess), 0.0)) > _HAND_RAD_S * gyroscope
        sways = change > np.maximum(_HAND_CHANGE_RAD_S * gyroscope, _HAND_CHANGE_SIGMAS * floor.cell_sigma[3:])
        return shakes or bool(sways.any())

    def _learn(self, cells: Cells) -> Cells:
        """Search a quiet window that ends in these cells; return what can be judged now: all cells so far, or none."""
        window = cells_in(FLOOR_S)
        self._waiting.append(cells)
        self._cells_waiting += len(cells)
        tail = join_cells([*self._tail, cells])
        self._tail = [tail[1 - window :]]
        for end in range(max(len(tail) - len(cells) + 1, window), len(tail) + 1):
            if is_quiet(tail[end - window : end], self.scale):
                self._set_floor(measure_floor(tail[end - window : end]))
                waiting, self._waiting, self._cells_waiting = join_cells(self._waiting), [], 0
                return waiting
        while self._cells_waiting > cells_in(LONGEST_WAIT_S):
            self._cells_waiting -= len(self._waiting.pop(0))
        return cells[:0]

    def _set_floor(self, floor: NoiseFloor) -> None:
        self.scale = self.scale.learn(floor.mean[:3])
        self.floor = floor
        if not floor.has_gyroscope:
            self._hand, self._trackers = None, (self._table,)
        for tracker in self._trackers:
            limits = noise_limits(floor, self.scale, tracker.allowances)
            tracker.standard = Standard.of(floor, limits, self.scale)
        if not self._rest and floor.has_gyroscope:
            self._rest = floor.mean.tolist()

    def _judge_under_one_floor(self, cells: Cells, start: int) -> Iterator[Judgement]:
        standard, rows = self._table.standard, slice(start, len(cells))
        ratios = [vibration_ratio(cells.variance[rows], tracker.standard.limits).tolist() for tracker in self._trackers]
        means, slots = cells.mean[rows].tolist(), cells.slot[rows].tolist()
        full = (cells.usable[rows] >= USABLE_SHARE * standard.usual_samples).tolist()
        # Nobody knows how long it took to set the clock, nor whether the instrument was off meanwhile.
        timed = ((cells.flags[rows] & np.uint32(Status.CLOCK_SET)) == 0).tolist()
        each = zip(slots, means, full, timed, *ratios, strict=True)
        for row, (slot, mean, is_full, is_timed, *vibration) in enumerate(each, start):
            gap = 1 if self._slot is None else slot - self._slot
            if is_full:
                self._slot = slot
                # One lost cell between two is bridged.
                unbroken = gap in (1, 2) and is_timed
                found = [
                    tracker.follow((cells, row, ratio, mean), unbroken=unbroken, rest=self._rest)
                    for tracker, ratio in zip(self._trackers, vibration, strict=True)
                ]
                yield self._choose(*found)
            else:
                yield self._judge_lost(cells, row, gap)
            if self._table.standard is not standard:
                return

    def _choose(self, table: Judgement, hand: Judgement | None = None) -> Judgement:
        """Return the judgement that counts: the table's where the unit is still on it, else the hand's.

        A hold passes from the table's limits to the hand's only where it looked like a hand all the time; a unit on a table
        that is pushed has ended its hold.
        """
        if table.ended is not None:
            self._learn_from(table.ended)
        if hand is None or self._hand is None:
            return table
        if self.in_hand:
            return self._choose_in_hand(table, hand, self._hand)
        if table.phase is Phase.STILL:
            return table
        if table.ended is not None:
            if hand.phase is Phase.STILL and self.is_hand_like(table.ended.cells()):
                self.in_hand, self.stillest = True, table.ended
                return hand
            self._hand.restart()
            return table
        if hand.phase is Phase.STILL:
            self.in_hand, self.stillest = True, None
        return table if hand.phase is Phase.MOVING else hand

    def _choose_in_hand(self, table: Judgement, hand: Judgement, tracker: Tracker) -> Judgement:
        """Return the judgement that counts for a unit that was in the hand until now."""
        if table.ended is not None and (self.stillest is None or table.ended.judged > self.stillest.judged):
            self.stillest = table.ended
        if hand.ended is not None:
            hand.ended.cut(self.hold_edges(hand.ended.cells()))
        placed = self._table.stretch
        look_again = table.phase is Phase.STILL and placed.judged % cells_in(_LOOK_AGAIN_S) == 0
        if look_again and not self.is_hand_like(placed.cells()):
            # A hold that began in the hand continues on a table.
            self.in_hand = False
            tracker.restart()
            return table
        if hand.phase is Phase.STILL:
            return hand
        self.in_hand = False
        return hand if hand.ended is None or table.phase is Phase.STILL else hand._replace(phase=table.phase)

    def _judge_lost(self, cells: Cells, row: int, gap: int) -> Judgement:
        """Judge a cell that is nearly empty: the first is ignored, the second in a row ends a stretch."""
        if gap == 1:
            return Judgement(self.phase, cells, row, self.stretch.mean)
        ended = self.stretch if self.phase is Phase.STILL else None
        if ended is not None and not self.in_hand:
            self._learn_from(ended)
        self.restart()
        return Judgement(self.phase, cells, row, [], ended=ended)

    def _learn_from(self, stretch: Stretch) -> None:
        """Learn from a stretch that ended: the gyroscope's bias, and the noise floor if it was quieter."""
        if self.floor is None or stretch.judged < cells_in(_LEARN_FROM_S):
            return
        cells = stretch.cells()
        inner = cells[len(cells) // 4 : len(cells) - len(cells) // 4]
        if self._rest:
            self._rest = np.where(np.isnan(mean := np.nanmean(inner.mean, axis=0)), self._rest, mean).tolist()
        quieter = measure_floor(inner)
        if quieter.samples_per_cell < FEW_SAMPLES and len(inner) < cells_in(FLOOR_S):
            # Few samples look quieter than they are by chance.
            return
        if is_quieter(quieter, self.floor) and is_quiet(inner, self.scale):
            self._set_floor(quieter)
