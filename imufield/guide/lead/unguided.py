"""Still intervals of a recording without a guide: each is an observation."""

from __future__ import annotations

import math
from bisect import bisect

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.dataclass import dataclass, replace
from imufield.errors import CalibrationError, Reason
from imufield.guide.cross_checks.axes import AxesCheck, MoveLog, check_axes, check_while_waiting
from imufield.guide.cross_checks.centre import centred
from imufield.guide.cross_checks.outputs import Outputs
from imufield.guide.hold.checks import HoldUnderTest, check_gravity, examine
from imufield.guide.hold.in_hand import HAND_GUARD_S, SampleHistory, measure_in_hand, trim_in_hand
from imufield.guide.hold.observe import Observation, gather, observe, trim_stretch
from imufield.guide.hold.shaken import RefusedHold, ShakenHolds
from imufield.guide.lead.settings import MOVED_DEG, MOVED_S
from imufield.guide.positions import angle_deg, nearest_cube_direction
from imufield.guide.refusals import FROZEN, TOO_SHORT_IN_HAND, Refusal
from imufield.guide.stillness.cells import CellBuilder, Cells, cells_in
from imufield.guide.stillness.detector import LONGEST_WAIT_S, StillnessDetector
from imufield.guide.stillness.noise_floor import FLOOR_S, MAX_FLOOR_M_S2, MAX_FLOOR_RAD_S, is_quiet, measure_floor
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Phase, Stretch
from imufield.samples import CELL_S, Samples, SampleUnits, median
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# A still interval shorter than this, guard bands off, is a pause in a motion; in the hand, where sway decides, of no use.
_SHORTEST_S = 1.0
_SHORTEST_IN_HAND_S = 3.0
_LONGEST_IN_HAND_S = 45.0  # Nobody holds still for longer: a person walks with the unit, or a car drives.
_HISTORY_S = 120.0  # Samples kept: longer than such a hold, and what is still before and behind it.
_TURNED_DEG = 20.0  # Of the force between two holds in the hand; a car that brakes tilts it by as much.
_NOTED_IN_HAND_S = 2.5  # One in the hand that is shorter than it must be, and longer than a pause in a motion.
_HABIT = 6  # Of these in a session, and half as many as sound ones: a person holds too shortly, and does not just look.
_LONG_IN_HAND_S = 5.0  # One in the hand that is as still as on a table is measured as such where it is shorter.
_HAND_SHOWS_S = 2.5  # Whether a unit is in the hand or on a table shows so long after it came to rest.


@dataclass(frozen=True, slots=True, kw_only=True)
class StillIntervals:
    """Observations of a recording, and start time and reason of the still intervals that were refused."""

    observations: Observations
    refused: tuple[tuple[float, Refusal], ...]
    scale: RoughScale
    axes: AxesCheck
    """Whether the gyroscope's axes belong to the accelerometer's."""
    sticking: tuple[str, ...]
    """A sentence for each output whose codes stick."""


class StillIntervalFinder:
    """Collects an observation from each still interval of a stream; memory does not grow with its length.

    An observation is named after the nearest face, edge or corner of a cube, "free 7: near +x+y", and has no planned direction.

    Parameters
    ----------
    units : SampleUnits
    scale : RoughScale, optional
        What is known of the raw units; by default that of their names.
    """

    def __init__(self, units: SampleUnits, scale: RoughScale | None = None) -> None:
        self.units = units
        self.detector = StillnessDetector(scale or RoughScale.of_units(units), hand=True)
        self._history = SampleHistory()  # For holds in the hand.
        self._held = 0  # Cells up to the one before in which the unit was in the hand.
        # Each time that the unit was put down, and why that does not count, as far as itself shows.
        self._placements: list[tuple[Observation, Refusal | None]] = []
        self._last: Stretch | None = None  # The stretch before, of whatever length.
        self._lain: Stretch | None = None  # The latest one that was as still as on a table.
        self._put_down = True  # Whether the unit was put down since the last of the placements.
        self._shaken = ShakenHolds()
        self._short: list[RefusedHold] = []  # In the hand.
        self._rest_raw = np.full(3, np.nan)  # Of the gyroscope, in the hold before.
        self._outputs = Outputs()
        self._moves = MoveLog()
        self._builder = CellBuilder()

    @property
    def placed(self) -> int:
        """How often the unit was put down so far, in holds that are sound as far as themselves show."""
        return sum(own is None for _, own in self._placements)

    def feed(self, samples: Samples) -> None:
        """Process the next samples."""
        if self.detector.knows_hands:
            self._history.add(samples)
        self._process(self._builder.feed(samples))
        # Cells that came before the first rest are judged when it has come.
        self._history.prune(LONGEST_WAIT_S if self.detector.floor is None else _HISTORY_S)

    def finish(self) -> StillIntervals:
        """Return the still intervals; the last one ends here.

        Raises
        ------
        CalibrationError
            If no stretch was quiet enough to be a noise floor.
        """
        self._process(self._builder.flush())
        if self.detector.phase is Phase.STILL:
            self._add(self.detector.stretch, in_hand=self._held > 0)
            self.detector.restart()
        self._shaken.end(self.detector)
        if self.detector.floor is None:
            raise self._never_quiet()
        sound = [observation.mean_raw for observation, own in self._placements if own is None]
        scale = centred(self.detector.scale, np.array(sound))
        found, refused = list[Observation](), list[tuple[float, Refusal]]()
        for observation, own in self._placements:
            # Only now all holds show together which offset there is, and what the outputs can do.
            refusal = self._outputs.refusal(observation.output, own or check_gravity(observation.mean_raw, scale))
            if refusal is not None:
                refused.append((observation.start_s, refusal))
            else:
                name = f"free {len(found) + 1}: near {nearest_cube_direction(scale.specific_force(observation.mean_raw))}"
                found.append(replace(self._outputs.with_resolution(observation), name=name))
        refused += self._elsewhere(self._shaken.found, scale)
        short = self._elsewhere(self._short, scale)
        refused += short if len(short) >= max(_HABIT, len(found) / 2) else []
        return StillIntervals(
            observations=gather(found, self.units),
            refused=tuple(sorted(refused, key=lambda still: still[0])),
            scale=scale,
            axes=check_axes(self._moves.moves(scale), scale.gyroscope),
            sticking=self._outputs.sticking(),
        )

    def _elsewhere(self, holds: list[RefusedHold], scale: RoughScale) -> list[tuple[float, Refusal]]:
        """Return these holds except where the unit lay still just before or afterwards: it was put down there."""
        refused = list[tuple[float, Refusal]]()
        times_s = [observation.start_s for observation, _ in self._placements]
        for start_s, mean_raw, refusal in holds:
            after = bisect(times_s, start_s)
            near = (observation.mean_raw for observation, _ in self._placements[max(after - 1, 0) : after + 1])
            up = scale.up(mean_raw)
            if all(angle_deg(up, scale.up(each)) > _TURNED_DEG for each in near):
                refused.append((start_s, refusal))
        return refused

    def _never_quiet(self) -> CalibrationError:
        """Return why there is no noise floor."""
        if self.detector.frozen:
            return CalibrationError(FROZEN.refusal(FLOOR_S, 0.0).words, Reason.TOO_FEW)
        if self.detector.has_waited and (axes := check_while_waiting(self.detector)).turns_ratio != 1.0:
            return CalibrationError(axes.words, Reason.UNITS)
        if self.detector.has_waited:
            means = self.detector.waited().mean[:, :3]
            key = "unguided.no_accelerometer" if np.isnan(means).all() else "unguided.zero"
            if np.isnan(means).all() or self.detector.scale.is_zero(means.mean(axis=0)):
                return CalibrationError(sentence(key), Reason.TOO_FEW)
        if self.detector.has_waited and (sigma_rad_s := self._least_scatter_rad_s()):
            limit_deg_s, found_deg_s = math.degrees(MAX_FLOOR_RAD_S), math.degrees(sigma_rad_s)
            told = {"floor_s": FLOOR_S, "found_deg_s": found_deg_s, "limit_deg_s": limit_deg_s}
            return CalibrationError(sentence("unguided.gyroscope_scatters", **told), Reason.UNITS)
        never = sentence("unguided.never_quiet", floor_s=FLOOR_S, limit_m_s2=MAX_FLOOR_M_S2)
        return CalibrationError(never, Reason.TOO_FEW)

    def _least_scatter_rad_s(self) -> float:
        """Return the gyroscope's scatter in the calmest window that is a rest but for it, by the given scale; 0 without one."""
        scale, cells, window = self.detector.scale, self.detector.waited(LONGEST_WAIT_S), cells_in(FLOOR_S)
        windows = (cells[end - window : end] for end in range(window, len(cells) + 1, window // 3))
        rests = [measure_floor(each) for each in windows if is_quiet(each, replace(scale, gyroscope=None))]
        found = [float(rest.sigma[3:].max()) / scale.gyroscope for rest in rests if scale.gyroscope and rest.has_gyroscope]
        return min(found, default=0.0)

    def _process(self, cells: Cells | None) -> None:
        if cells is None:
            return
        self._outputs.follow(cells)
        for judgement in self.detector.judge(cells):
            held = self._held + 1 if self.detector.in_hand else 0
            # A unit that is put down passes for one in the hand before it lies: the move is not over then.
            moves = 0 < held < cells_in(_HAND_SHOWS_S)
            self._shaken.follow(judgement, self.detector, self._rest_raw)
            self._moves.follow(judgement._replace(phase=Phase.MOVING) if moves else judgement, self.detector.stretch.mean)
            if judgement.ended is not None:
                self._add(judgement.ended, in_hand=self._held > 0)
            self._held = held

    def _add(self, stretch: Stretch, *, in_hand: bool) -> None:
        """Add the observation of a stretch, or its refusal; of the stretches of one placement the best counts."""
        self._put_down |= not self._is_where_it_was(stretch, in_hand=in_hand)
        self._last = stretch
        self._lain = self._lain if in_hand else stretch
        hold = self._hold(stretch, in_hand=in_hand)
        if hold is None:
            if in_hand:
                self._note_short(stretch)
            return
        self._rest_raw = median(hold.cells.mean[:, 3:])
        placement = observe(hold.cells, hold.limits, "", hand_mean=hold.hand_mean), examine(hold)
        if not self._put_down:
            # A soft support gives way, a table is knocked: the unit was not put down a second time.
            before, refusal = self._placements[-1]
            if in_hand and refusal is None and before.hand_mean is None:
                # What lay on a table tells more than what was lifted from it.
                return
            placement = max(placement, self._placements.pop(), key=lambda found: (found[1] is None, found[0].duration_s))
        self._outputs.add(placement[0].output, again=not self._put_down)
        self._placements.append(placement)
        self._put_down = False

    def _note_short(self, stretch: Stretch) -> None:
        """Note a hold in the hand that is too short; where samples are missing, one that goes on is the same."""
        duration_s, limit_s = stretch.judged * CELL_S, _SHORTEST_IN_HAND_S + 2 * HAND_GUARD_S
        mean_raw, up = np.array(stretch.mean[:3]), self.detector.scale.up
        goes_on = bool(self._short) and angle_deg(up(mean_raw), up(self._short[-1].mean_raw)) < _TURNED_DEG
        if _NOTED_IN_HAND_S <= duration_s < limit_s and not goes_on:
            refusal = TOO_SHORT_IN_HAND.refusal(duration_s, limit_s)
            self._short.append(RefusedHold(float(stretch.cells().start_s[0]), mean_raw, refusal))

    def _hold(self, stretch: Stretch, *, in_hand: bool) -> HoldUnderTest | None:
        """Return the hold of a stretch, guard bands off; None where it is too short."""
        detector, limits, mean = self.detector, self.detector.limits, None
        # In the hand the unit may have been as still as on a table for some time.
        placed, cells = detector.stillest if in_hand else stretch, stretch.cells()
        kept = cells[:0] if placed is None else placed.cells()[trim_stretch(placed.cells(), limits)]
        is_placed = len(kept) >= cells_in(_SHORTEST_S)
        if in_hand or (is_placed and detector.knows_hands and detector.is_hand_like(kept)):
            held = trim_in_hand(cells, trim_stretch(cells, limits), detector)
            shortest_s = _LONG_IN_HAND_S if is_placed else _SHORTEST_IN_HAND_S
            if cells_in(shortest_s) <= len(held) <= cells_in(_LONGEST_IN_HAND_S):
                mean = measure_in_hand(held, self._history, detector)
            kept = kept if mean is None else held
        if detector.floor is None or (mean is None and not is_placed):
            return None
        return HoldUnderTest(cells=kept, floor=detector.floor, limits=limits, scale=detector.scale, hand_mean=mean)

    def _is_where_it_was(self, stretch: Stretch, *, in_hand: bool) -> bool:
        """Whether the unit was not lifted since the stretch before; where samples are missing, nobody knows.

        In the hand it must have been turned: a person who walks, or a car that drives, carries it on as it is.
        """
        before, cells = self._last if in_hand else self._lain, stretch.cells()
        if before is None:
            return False
        away = int(cells.slot[0] - before.cells().slot[0]) - before.judged
        up, up_before = (self.detector.scale.up(np.array(each.mean[:3])) for each in (stretch, before))
        turned_deg = angle_deg(up, up_before)
        return turned_deg < _TURNED_DEG if in_hand else away < cells_in(MOVED_S) and turned_deg < MOVED_DEG
