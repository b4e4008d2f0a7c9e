"""What the guide does: the actions that the state table names.

An action may answer with another input for the table. What is said is appended to ``events``.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from imufield.guide.cells import Cells
from imufield.guide.checks import HoldUnderTest, Refusal, examine, explain_flags
from imufield.guide.events import (
    Accepted,
    Done,
    Event,
    Hold,
    Holding,
    LinkBack,
    LinkLost,
    Marked,
    Move,
    RefusalCode,
    Rejected,
    Turning,
)
from imufield.guide.observe import guard_cells, observe, trim_stretch
from imufield.guide.plan import Plan
from imufield.guide.positions import Position, angle_deg
from imufield.guide.settings import GuideSettings
from imufield.guide.state_table import TABLE, Input
from imufield.guide.stillness import Judgement, Phase, StillnessDetector
from imufield.guide.wording import floor_event, moved_refusal, not_still_refusal, place_refusal, vector
from imufield.samples import FloatArray


class GuideActions:
    """The actions, and what they remember between two cells.

    Parameters
    ----------
    plan : Plan
    detector : StillnessDetector
    settings : GuideSettings
    """

    def __init__(self, plan: Plan, detector: StillnessDetector, settings: GuideSettings) -> None:
        self.plan = plan
        self.detector = detector
        self.settings = settings
        self.events: list[Event] = []
        self.announced = False
        """Whether the noise floor was said."""
        self.now_s = math.nan
        """Sample clock at the end of the cell in hand."""
        self.judgement: Judgement | None = None
        self.position: int | None = None
        """Where the hold under way belongs."""
        self.fraction = 0.0
        self.rested: int | None = None
        """Position accepted last, as long as the unit may still lie there."""
        self._rest_direction: FloatArray | None = None
        self._moved_cells = 0
        self._moved_deg = 0.0
        self._refusal: Refusal | None = None
        self._hold: HoldUnderTest | None = None
        self._linger_direction: FloatArray | None = None
        self._linger_from_s = math.nan
        self._linger_cosine = math.cos(math.radians(settings.linger_deg))
        self._said: dict[str, float] = {}
        names = {transition.action for row in TABLE.values() for transition in row.values()}
        self.by_name: dict[str, Callable[[], Input | None]] = {name: getattr(self, name) for name in names}

    def due(self, what: str, every_s: float) -> bool:
        """Whether something said again and again is due; a time before the last one means a new clock, so it is."""
        last = self._said.get(what, -math.inf)
        if 0 <= self.now_s - last < every_s - 1e-6:
            return False
        self._said[what] = self.now_s
        return True

    def reject(self, refusal: Refusal, position: str | None = None) -> None:
        """Say why something is refused."""
        self.events.append(
            Rejected(
                self.now_s,
                position,
                refusal.reason,
                refusal.words,
                refusal.remedy,
                refusal.measured,
                refusal.limit,
                refusal.unit,
                refusal.axis,
            )
        )

    def _reject_hold(self) -> None:
        if self._refusal is not None:
            self.reject(self._refusal, None if self.position is None else self._current().name)

    def _forget_hold(self) -> None:
        self.position, self._hold, self.fraction = None, None, 0.0

    def _current(self) -> Position:
        if self.position is None:
            raise RuntimeError("no hold is under way")
        return self.plan.position(self.position)

    def _direction(self, mean_raw: FloatArray) -> FloatArray:
        """Return where up is in the body frame from raw accelerometer rates (3,): a unit vector."""
        force = self.detector.scale.specific_force(mean_raw)
        norm = np.linalg.norm(force)
        return force / norm if norm > 0 else np.full(3, np.nan)

    def announce_floor(self) -> None:
        """Say the noise floor, and what comes first."""
        floor = self.detector.floor
        if floor is None:
            return
        self.announced = True
        self.now_s = floor.start_s + floor.duration_s
        self.events.append(floor_event(self.now_s, floor, self.detector))
        lying = self.plan.nearest(self._direction(floor.mean[:3]), pending=True)
        if lying is not None and lying.angle_deg <= self.plan.tolerance_deg:
            self.plan.first = lying.index
        self.propose()

    def propose(self) -> None:
        """Say what comes next."""
        index = self.plan.proposed()
        if index is None:
            return
        position = self.plan.position(index)
        if index in self.plan.wanted_again:
            why = "to be measured again; the older measurement counts until then"
        elif index == self.plan.first and not self.plan.accepted:
            why = "it lies there already"
        elif not self.plan.accepted:
            why = "the first of the list; any other order is fine"
        else:
            why = "next in an order that keeps drift and error parameters apart; any pending position is taken"
        accepted, planned = len(self.plan.accepted), len(self.plan.scheme)
        self.events.append(Move(self.now_s, position.name, vector(position.direction), position.words, why, accepted, planned))

    def show_turning(self) -> None:
        """Say where the unit points, a few times a second, and what keeps it from being still where it lingers."""
        target = self.plan.proposed()
        if self.judgement is None or target is None:
            return
        direction = self._direction(self.judgement.cells.mean[self.judgement.row, :3])
        self._note_lingering(self.judgement, direction)
        if not self.due("turning", self.settings.repeat_s):
            return
        nearest = self.plan.nearest(direction, pending=True) if np.isfinite(direction).all() else None
        if nearest is None:
            return
        goal = self.plan.position(target)
        name = self.plan.position(nearest.index).name
        off_target = angle_deg(goal.direction, direction)
        self.events.append(Turning(self.now_s, vector(direction), name, nearest.angle_deg, goal.name, off_target))

    def _note_lingering(self, judgement: Judgement, direction: FloatArray) -> None:
        """Say what moves when somebody waits for the guide: the direction stays, the unit is not still."""
        before = self._linger_direction
        if before is None or not self.now_s >= self._linger_from_s or not float(before @ direction) > self._linger_cosine:
            self._linger_direction, self._linger_from_s = direction, self.now_s
        elif self.now_s - self._linger_from_s > self.settings.linger_s and judgement.phase is Phase.MOVING:
            activity = self.detector.explain(judgement)
            if activity.ratio > 1 and self.due("not still", self.settings.remind_s):
                self.reject(not_still_refusal(activity))

    def recognise(self) -> Input:
        """Find the position that the unit lies in."""
        direction = self._direction(np.array(self.detector.stretch.mean[:3]))
        pending, nearest = self.plan.nearest(direction, pending=True), self.plan.nearest(direction, pending=False)
        if nearest is None:
            return Input.SAME
        if self.rested is not None and self._was_lifted():
            self.rested = None
        if self.rested is not None and self.plan.same_direction(nearest.index, self.rested):
            return Input.SAME
        tolerance = self.plan.tolerance_deg
        if pending is not None and pending.angle_deg <= tolerance:
            self.position = pending.index
            return Input.NEAR
        self._refusal = place_refusal(self.plan, nearest, pending)
        return Input.REFUSED

    def begin_hold(self) -> None:
        """Say that the hold begins."""
        self._linger_direction = None
        self.fraction, self._hold = 0.0, None
        position = self._current()
        direction = self._direction(np.array(self.detector.stretch.mean[:3]))
        angle = angle_deg(position.direction, direction)
        self.events.append(Hold(self.now_s, position.name, position.words, angle, self.settings.hold_s))

    def count(self) -> Input | None:
        """Count the cells of a hold; when there are enough, see whether enough remain after trimming."""
        settings = self.detector.settings
        wanted = settings.cells(self.settings.hold_s)
        needed = wanted + 2 * guard_cells(self.detector.limits, settings)
        stretch = self.detector.stretch
        self.fraction = min(stretch.judged / needed, 1.0)
        if stretch.judged >= needed:
            cells = stretch.cells()
            cells = cells[trim_stretch(cells, self.detector.limits, settings)]
            if len(cells) >= wanted or (stretch.judged > len(stretch) and len(cells)):
                self._hold = self._under_test(cells)
                return Input.LONG_ENOUGH
        if self.due("holding", self.settings.repeat_s):
            left_s = max(needed - stretch.judged, 0) * settings.cell_s
            self.events.append(Holding(self.now_s, self._current().name, self.fraction, left_s))
        return None

    def _under_test(self, cells: Cells) -> HoldUnderTest | None:
        floor = self.detector.floor
        return (
            None
            if floor is None
            else HoldUnderTest(cells, floor, self.detector.limits, self.detector.scale, self.settings.checks)
        )

    def judge(self) -> Input:
        """Examine the hold."""
        self._refusal = None if self._hold is None else examine(self._hold)
        if self._refusal is None:
            return Input.GOOD
        passing = (RefusalCode.DRIFTING, RefusalCode.KNOCKED, RefusalCode.SAMPLE_LOSS, RefusalCode.START_UP)
        return Input.AGAIN if self._refusal.reason in passing else Input.REFUSED

    def accept(self) -> Input | None:
        """Take the observation and say what comes next."""
        index, hold = self.position, self._hold
        if index is None or hold is None:
            return None
        position = self._current()
        observation = observe(hold.cells, hold.limits, position.name, position.direction)
        replaces = self.plan.accept(index, observation)
        direction = self._direction(observation.mean_raw)
        sigma = math.sqrt(float(np.diag(observation.covariance_raw).max())) / (hold.scale.accelerometer or math.nan)
        self.events.append(
            Accepted(
                self.now_s,
                position.name,
                vector(direction),
                angle_deg(position.direction, direction),
                observation.start_s,
                observation.duration_s,
                sigma,
                observation.temperature_degc,
                len(self.plan.accepted),
                len(self.plan.scheme),
                replaces,
            )
        )
        self.rested, self._rest_direction = index, direction
        self._forget_hold()
        if self.plan.proposed() is None:
            return Input.COMPLETE
        self.propose()
        return None

    def refuse(self) -> None:
        """Say why the hold is refused; the unit must be moved."""
        self._reject_hold()
        self._forget_hold()

    def measure_again(self) -> None:
        """Say why the hold is refused and begin anew where the unit lies."""
        self._reject_hold()
        self.fraction = 0.0
        self.detector.restart()

    def interrupt(self) -> None:
        """Refuse a hold that ended too early."""
        judgement = self.judgement
        if judgement is None or judgement.ended is None:
            return
        guards = 2 * guard_cells(self.detector.limits, self.detector.settings)
        held_s = max(judgement.ended.judged - guards, 0) * self.detector.settings.cell_s
        activity = self.detector.explain(judgement)
        if activity.ratio <= self.detector.settings.leave_factor:
            cells = judgement.cells[judgement.row : judgement.row + 1]
            self._refusal = explain_flags(cells, 0.0, 1 - self.settings.checks.lost_share)
            self._reject_hold()
        elif held_s >= self.settings.silent_s:
            self._refusal = moved_refusal(activity, self.detector.settings.leave_factor, held_s, self.settings.hold_s)
            self._reject_hold()
        self._forget_hold()
        self.lift()

    def lift(self) -> None:
        """Begin to watch whether the unit is lifted or only knocked."""
        self._moved_cells, self._moved_deg = 0, 0.0

    def rest(self) -> None:
        """Wait for the unit to be moved."""

    def note_motion(self, judgement: Judgement) -> None:
        """Remember how long and how far the unit has moved."""
        self._moved_cells += judgement.phase is Phase.MOVING
        if self._rest_direction is not None:
            direction = self._direction(judgement.cells.mean[judgement.row, :3])
            self._moved_deg = max(self._moved_deg, angle_deg(self._rest_direction, direction))

    def _was_lifted(self) -> bool:
        moved_s = self._moved_cells * self.detector.settings.cell_s
        return moved_s > self.settings.moved_s or self._moved_deg > self.settings.moved_deg

    def pause(self) -> None:
        """Stop measuring."""
        self.events.append(Marked(self.now_s, "pause", None, "paused; nothing is measured until you go on"))

    def resume(self) -> None:
        """Go on measuring."""
        self.detector.restart()
        self.events.append(Marked(self.now_s, "pause", None, "going on"))
        self.propose()

    def lose_link(self) -> None:
        """Say that the link is gone; a hold under way is given up."""
        self.detector.interrupt()
        self._forget_hold()
        self.events.append(LinkLost(self.now_s, len(self.plan.accepted), len(self.plan.scheme)))

    def find_link(self) -> None:
        """Say that the link is back."""
        self.events.append(LinkBack(self.now_s))
        if self.announced:
            self.propose()
        # The sample clock may start anew.
        self.now_s = math.nan

    def finish(self) -> None:
        """Say that the session is over."""
        accepted, planned, missing = len(self.plan.accepted), len(self.plan.scheme), self.plan.missing()
        words = "all positions are measured" if not missing else f"finished with {accepted} of {planned} positions"
        self.events.append(Done(self.now_s, accepted, planned, missing, words))
