"""Is a hold long enough? Its cells, trimmed, and for a unit in the hand the mean of its turned samples.

The latest raw samples, as far back as one hold can reach: a hold in the hand is measured from them, not from cells.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from imufield.guide.hold.checks import HoldUnderTest
from imufield.guide.hold.hand_mean import HeldMean, held_mean
from imufield.guide.hold.hold_time import SHORTEST_S, AllanMinimum, is_long_enough, sigma_along
from imufield.guide.hold.observe import guard_cells, knocks_of, trim_stretch
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.stillness.cells import Cells
from imufield.guide.stillness.detector import StillnessDetector
from imufield.samples import Samples, concatenate

MOST_SAMPLES = 200_000
"""Bound on what is kept, whatever the rate: 100 s at 2000 Hz, some 17 MB."""


class RawHistory:
    """Keeps blocks of samples for a while.

    Parameters
    ----------
    keep_s : float
        Sample clock kept behind the newest sample.
    """

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._blocks: deque[Samples] = deque()
        self._count = 0

    def add(self, samples: Samples) -> None:
        """Append a block, oldest first."""
        self._blocks.append(samples)
        self._count += len(samples)

    def prune(self) -> None:
        """Let go of what is older than ``keep_s``; call it when the newest block has been used."""
        while len(self._blocks) > 1 and self._may_go(self._blocks[0], self._blocks[-1]):
            self._count -= len(self._blocks.popleft())

    def _may_go(self, oldest: Samples, newest: Samples) -> bool:
        too_old = float(oldest.time_s[-1]) < float(newest.time_s[-1]) - self._keep_s
        return too_old or self._count - len(oldest) > MOST_SAMPLES

    def clear(self) -> None:
        """Forget everything: another clock begins."""
        self._blocks.clear()
        self._count = 0

    def between(self, start_s: float, end_s: float) -> Samples | None:
        """Return the samples of a stretch, both ends included, None where there are none."""
        parts = []
        for block in self._blocks:
            first, last = block.time_s.searchsorted([start_s, end_s], side="left")
            last += int(last < len(block) and block.time_s[last] == end_s)
            if last > first:
                parts.append(block[int(first) : int(last)])
        return concatenate(parts) if parts else None


HISTORY_MARGIN_S = 5.0
WEIGH_EVERY = 5
"""Cells between two looks at a hold without a fixed time."""


class Weighing:
    """Weighs the hold under way.

    Parameters
    ----------
    detector : StillnessDetector
    settings : GuideSettings
    """

    def __init__(self, detector: StillnessDetector, settings: GuideSettings) -> None:
        self._detector = detector
        self._settings = settings
        self.history = RawHistory(detector.settings.longest_s + HISTORY_MARGIN_S)
        self.first_judged_s = math.nan  # Samples from before this time are not kept.
        self.fraction = 0.0  # How much of the hold under way is done.
        self._allan = AllanMinimum(detector.settings.cell_s)

    @property
    def latest_s(self) -> float:
        """Length at which a hold ends at the latest."""
        wish = self._settings.wish
        return wish.fixed_s or max(min(wish.longest_s, self._allan.minimum_s), SHORTEST_S)

    @property
    def left_s(self) -> float:
        """Time to go at the latest."""
        return max((1 - self.fraction) * self.latest_s, 0.0)

    def begin(self) -> None:
        """Begin with a hold."""
        self.fraction = 0.0

    def learn(self, hold: HoldUnderTest) -> None:
        """Learn the Allan minimum from an accepted hold; a hand has none."""
        if hold.held is None:
            self._allan.add(np.linalg.norm(hold.scale.specific_force(hold.cells.mean[:, :3]), axis=1))

    def guard(self, *, in_hand: bool) -> int:
        """Return the cells of a guard band."""
        settings = self._detector.settings
        return settings.cells(self._settings.hand_guard_s) if in_hand else guard_cells(self._detector.limits, settings)

    def look(self) -> HoldUnderTest | None:
        """Count the cells of the stretch; return the hold if it is long enough, to be called with each cell."""
        settings, wish = self._detector.settings, self._settings.wish
        usable = self._detector.stretch.judged - 2 * self.guard(in_hand=self._detector.in_hand)
        latest = settings.cells(self.latest_s)
        earliest = latest if wish.fixed_s is not None else settings.cells(SHORTEST_S)
        self.fraction = min(max(self.fraction, usable / latest), 1.0) if usable > 0 else 0.0
        if usable >= latest or (usable >= earliest and usable % WEIGH_EVERY == 0):
            return self._weigh(latest)
        return None

    def _weigh(self, latest: int) -> HoldUnderTest | None:
        """Return the hold if enough remains of it, guard bands and ends that stand out cut off; None if it must go on."""
        detector = self._detector
        cells = detector.stretch.cells()
        rows = trim_stretch(cells, detector.limits, detector.settings)
        in_hand = detector.in_hand or (detector.settings.hand and detector.is_hand_like(cells[rows]))
        full = detector.stretch.judged > len(detector.stretch)
        if in_hand:
            return self._weigh_in_hand(cells, rows, latest, full=full)
        cells = cells[rows]
        if not len(cells):
            return None
        sigma = sigma_along(cells, detector.scale)
        wish = self._settings.wish
        if sigma > 0 and math.isfinite(sigma) and wish.sigma_m_s2 > 0:
            self.fraction = min(max(self.fraction, (wish.sigma_m_s2 / sigma) ** 2), 1.0)
        length_s = len(cells) * detector.settings.cell_s
        if full or is_long_enough(length_s, sigma, wish, self._allan.minimum_s):
            return self._under_test(cells, None)
        return None

    def _weigh_in_hand(self, cells: Cells, rows: slice, latest: int, *, full: bool) -> HoldUnderTest | None:
        """Return a hold in the hand: between the turns by its own standard, wider guard bands, as long as holds may be."""
        guard = self.guard(in_hand=True)
        # Too short whatever the edges are: the fit of them, which costs most, is left out.
        if not full and min(rows.stop, len(cells) - guard) - max(rows.start, guard) < latest:
            return None
        edges = self._detector.hold_edges(cells)
        start = max(rows.start, edges.start + guard)
        cells = cells[start : max(min(rows.stop, edges.stop - guard), start)]
        if not len(cells) or not (full or len(cells) >= latest):
            return None
        held = self._held_mean(cells)
        return None if held is None else self._under_test(cells, held)

    def _held_mean(self, cells: Cells) -> HeldMean | None:
        """Return the mean of a hold in the hand, from its samples; None for one from before the noise floor was known."""
        floor, scale = self._detector.floor, self._detector.scale
        if floor is None or not float(cells.start_s[0]) >= self.first_judged_s:
            return None
        samples = self.history.between(float(cells.start_s[0]), float(cells.end_s[-1]))
        density = floor.cell_sigma[:3] * math.sqrt(self._detector.settings.cell_s)
        return None if samples is None else held_mean(samples, scale, density, knocks_of(cells, self._detector.limits))

    def _under_test(self, cells: Cells, held: HeldMean | None) -> HoldUnderTest | None:
        detector, floor = self._detector, self._detector.floor
        if floor is None:
            return None
        return HoldUnderTest(
            cells=cells, floor=floor, limits=detector.limits, scale=detector.scale, settings=self._settings.checks, held=held
        )
