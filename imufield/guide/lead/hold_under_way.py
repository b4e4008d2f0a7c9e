"""The hold under way: where it belongs, how long it is, and its mean once it is long enough.

A placed hold is measured from its cells, one in the hand from the samples of a history as long as the longest hold. What
becomes of it (accepted, refused, ended too early) is in ``guide_actions``, by ``state_table.toml``.
"""

from __future__ import annotations

import math

import numpy as np

from imufield.guide.hold.checks import HoldUnderTest
from imufield.guide.hold.hold_time import SHORTEST_S, AllanMinimum, HoldTarget, sigma_along
from imufield.guide.hold.in_hand import HAND_GUARD_S, SampleHistory, measure_in_hand, trim_in_hand
from imufield.guide.hold.observe import guard_cells, trim_stretch
from imufield.guide.hold.output import HoldOutput
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.cells import Cells, cells_in
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.stretch import Stretch
from imufield.samples import CELL_S

_HISTORY_MARGIN_S = 5.0  # Guard bands, and the cells that are judged late.
_EVALUATE_EVERY = 5  # Cells between two evaluations of a hold without a fixed time: one costs as much as 20 cells.


class HoldUnderWay:
    """The hold under way.

    Parameters
    ----------
    detector : StillnessDetector
    target : HoldTarget
    longest_s : float
        Length of a stretch that the detector keeps.
    """

    def __init__(self, detector: StillnessDetector, target: HoldTarget, longest_s: float) -> None:
        self._detector = detector
        self.target = target
        self._allan = AllanMinimum()
        self.history = SampleHistory()
        self.history_s = longest_s + _HISTORY_MARGIN_S
        self.first_judged_s = math.nan  # Samples from before this time are not kept.
        self.position: int | None = None  # Where the hold belongs.
        self.fraction = 0.0  # Part of the hold that is done.
        self.expected_s = 0.0  # Length at which it will end by what is known of its noise, guard bands off.
        self.left_s = 0.0  # Until then, guard bands included.
        self._guard = 0  # Cells of a guard band.
        self.measured: HoldUnderTest | None = None  # The hold, once it is long enough.
        self.output: HoldOutput | None = None  # Of the hold that was judged.
        self.again_at: int | None = None  # Where the hold before was to be measured again.
        self.refusal: Refusal | None = None  # Of the latest hold.

    @property
    def latest_s(self) -> float:
        """Length at which a hold ends at the latest."""
        return self.target.latest_s(self._allan.minimum_s)

    def begin(self) -> None:
        """Begin a hold."""
        self.fraction, self.measured = 0.0, None
        floor, detector = self._detector.floor, self._detector
        self.expected_s = self.latest_s
        # As on a table: whether it is in the hand shows later.
        if floor is not None:
            self.expected_s = min(self.target.expected_s(floor.white_noise(detector.scale)), self.latest_s)
        self._guard = cells_in(HAND_GUARD_S) if detector.in_hand else guard_cells(detector.limits)
        self.left_s = self.expected_s

    def forget(self) -> None:
        """Forget the hold: it was accepted, refused or left."""
        self.position = self.again_at = None
        self.begin()

    def learn(self, hold: HoldUnderTest) -> None:
        """Learn the Allan minimum from an accepted hold; a hand has none."""
        if hold.hand_mean is None:
            self._allan.add(np.linalg.norm(hold.scale.specific_force(hold.cells.mean[:, :3]), axis=1))

    def lasted_s(self, stretch: Stretch) -> float:
        """Return the length of a hold that has ended, guard bands off."""
        return max(stretch.judged - 2 * self._guard, 0) * CELL_S

    def evaluate(self) -> bool:
        """Count the cells of the stretch; return whether the hold is long enough. To be called with each cell."""
        detector = self._detector
        self._guard = cells_in(HAND_GUARD_S) if detector.in_hand else guard_cells(detector.limits)
        usable = detector.stretch.judged - 2 * self._guard
        latest = cells_in(self.latest_s)
        earliest = latest if self.target.fixed_s is not None else cells_in(SHORTEST_S)
        due = usable >= latest or (usable >= earliest and usable % _EVALUATE_EVERY == 0)
        self.measured = self._measure(latest) if due else None
        if due and self.measured is None:
            # Not yet: it will end at the next evaluation at the earliest, and in the hand at the latest.
            self.expected_s = self.latest_s if detector.in_hand else max(self.expected_s, (usable + _EVALUATE_EVERY) * CELL_S)
        # Guard bands are held, too: before the first has passed more is left than the hold takes.
        self.left_s = max(self.expected_s - usable * CELL_S, 0.0)
        self.fraction = min(max(self.fraction, 1 - self.left_s / self.expected_s), 1.0) if usable > 0 else 0.0
        return self.measured is not None

    def _measure(self, latest: int) -> HoldUnderTest | None:
        """Return the hold if enough remains of it, guard bands and ends that stand out cut off; None if it must go on."""
        detector, floor = self._detector, self._detector.floor
        if floor is None:
            return None
        cells = detector.stretch.cells()
        rows = trim_stretch(cells, detector.limits)
        # A longer stretch is not kept: what there is must do.
        full = detector.stretch.judged > len(detector.stretch)
        hand_mean = None
        if detector.in_hand or (detector.knows_hands and detector.is_hand_like(cells[rows])):
            kept = self._trim_in_hand(cells, rows, latest, full=full)
            # None either where the hold began before the noise floor was known.
            if not len(kept) or not (full or len(kept) >= latest) or not float(kept.start_s[0]) >= self.first_judged_s:
                return None
            hand_mean = measure_in_hand(kept, self.history, detector)
            if hand_mean is None:
                return None
        else:
            kept = cells[rows]
            if not len(kept):
                return None
            sigma, wanted, length_s = sigma_along(kept, detector.scale), self.target.sigma_m_s2, len(kept) * CELL_S
            if not full and not self.target.is_met(length_s, sigma, self._allan.minimum_s):
                if math.isfinite(sigma) and wanted > 0:
                    self.expected_s = min(length_s * (sigma / wanted) ** 2, self.latest_s)
                return None
        return HoldUnderTest(cells=kept, floor=floor, limits=detector.limits, scale=detector.scale, hand_mean=hand_mean)

    def _trim_in_hand(self, cells: Cells, rows: slice, latest: int, *, full: bool) -> Cells:
        guard = cells_in(HAND_GUARD_S)
        # Too short whatever the edges are: the fit of them, which costs most, is left out.
        is_long_enough = min(rows.stop, len(cells) - guard) - max(rows.start, guard) >= latest
        return trim_in_hand(cells, rows, self._detector) if full or is_long_enough else cells[:0]
