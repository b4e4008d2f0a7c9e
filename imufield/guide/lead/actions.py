"""What the guide does: the actions that the state table names.

An action may answer with another input for the table. What is said is appended to ``events``.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from imufield.guide.cross_checks.running_fit import RunningFit, running_fit
from imufield.guide.cross_checks.sides import SidesCheck
from imufield.guide.events import (
    Done,
    Event,
    Hold,
    Holding,
    LinkBack,
    LinkLost,
    Marked,
    Move,
    RefusalCode,
    Topic,
    Turning,
    Vector,
)
from imufield.guide.hold.checks import HoldUnderTest, Refusal, examine, explain_flags
from imufield.guide.hold.observe import observe
from imufield.guide.lead.advice import (
    Doubts,
    drift_advice,
    final_scale_advice,
    scale_advice,
    scheme_advice,
    target_advice,
)
from imufield.guide.lead.hold_under_way import Weighing
from imufield.guide.lead.plan import Plan
from imufield.guide.lead.refusals import (
    accepted_event,
    floor_event,
    moved_refusal,
    not_still_refusal,
    place_refusal,
    vector,
    warming_refusal,
)
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import TABLE, Input
from imufield.guide.lead.turn_leader import TurnLeader
from imufield.guide.positions import Position, angle_deg
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.stretch import Judgement, Phase
from imufield.guide.stillness.warmth import Warmth
from imufield.samples import FloatArray

CLEARLY_MORE = 1.5
"""A position is proposed before its turn where its gain is so many times larger: the order that drift cannot imitate is worth
more than a little gain."""
# Refusals that pass if the unit is left where it is.
_PASSING = (
    RefusalCode.DRIFTING,
    RefusalCode.KNOCKED,
    RefusalCode.SAMPLE_LOSS,
    RefusalCode.START_UP,
    RefusalCode.TREMBLING,
    RefusalCode.SWAYING,
    RefusalCode.WARMING_UP,
)


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
        self.weighing = Weighing(detector, settings)
        self.warmth = Warmth(detector.settings.cell_s)
        self.go_cold = False  # The operator said to go on although the temperature changes.
        self.fit: RunningFit | None = None
        self.doubts = Doubts()
        self.turns = TurnLeader(settings, detector.settings.cell_s)
        self._advised: set[str] = set()
        self._sides = SidesCheck()
        self.events: list[Event] = []
        self.announced = False  # Whether the noise floor was said.
        self.now_s = math.nan  # Sample clock at the end of the cell in hand.
        self.judgement: Judgement | None = None
        self.position: int | None = None  # Where the hold under way belongs.
        self.rested: int | None = None  # Position accepted last, as long as the unit may still lie there.
        self._rest_direction: FloatArray | None = None
        self._moved_cells = 0
        self._moved_deg = 0.0
        self._was_unseen = False  # Samples are missing since the last position: it may have been moved without being seen.
        self._let_go = 0  # Holds in a row that ended by motion.
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
        self.events.append(refusal.event(self.now_s, position))

    def _reject_hold(self) -> None:
        if self._refusal is not None:
            self.reject(self._refusal, None if self.position is None else self._current().name)

    def _forget_hold(self) -> None:
        self.position, self._hold = None, None
        self.weighing.begin()

    def _current(self) -> Position:
        if self.position is None:
            raise RuntimeError("no hold is under way")
        return self.plan.position(self.position)

    def _direction(self, mean_raw: FloatArray) -> FloatArray:
        """Return where up is in the body frame from raw accelerometer rates (3,): a unit vector."""
        force = self.detector.scale.specific_force(mean_raw)
        norm = np.linalg.norm(force)
        return force / norm if norm > 0 else np.full(3, np.nan)

    def direction_now(self) -> Vector | None:
        """Return where up is in the body by the latest cell, None while not known."""
        if self.judgement is None:
            return None
        direction = self._direction(self.judgement.cells.mean[self.judgement.row, :3])
        return vector(direction) if np.isfinite(direction).all() else None

    def announce_floor(self) -> None:
        """Say the noise floor, and what comes first."""
        floor = self.detector.floor
        if floor is None:
            return
        self.announced = True
        self.weighing.first_judged_s = floor.start_s
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
            self.propose_turn()
            return
        position = self.plan.position(index)
        accepted, planned = len(self.plan.accepted), len(self.plan.scheme)
        why = self._why(index)
        self.events.append(
            Move(
                time_s=self.now_s,
                position=position.name,
                direction=vector(position.direction),
                words=position.words,
                why=why,
                accepted=accepted,
                planned=planned,
            )
        )

    def _why(self, index: int) -> str:
        if index == self.plan.revisiting:
            return "the first one again: a check for drift, replaces nothing"
        if index in self.plan.wanted_again:
            return "to be measured again; the older measurement counts until then"
        if index == self.plan.first and not self.plan.accepted:
            return "it lies there already"
        if not self.plan.accepted:
            return "the first of the list; any other order is fine"
        if index == self.plan.preferred:
            return "it helps most now: what is known least shows best there; any pending position is taken"
        return "next in an order that keeps drift and error parameters apart; any pending position is taken"

    def propose_turn(self) -> None:
        """Say which whole turn comes next."""
        self.events += self.turns.next(self.now_s)

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
        self.events.append(
            Turning(
                time_s=self.now_s,
                direction=vector(direction),
                position=name,
                angle_deg=nearest.angle_deg,
                target=goal.name,
                target_angle_deg=off_target,
            )
        )

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
        if self.rested is not None and (self._was_lifted() or self._was_moved_unseen(direction)):
            self.rested = None
        if self.rested is not None and self.plan.same_direction(nearest.index, self.rested):
            return Input.SAME
        self._check_side(direction)
        tolerance = self.plan.tolerance_deg
        if pending is not None and pending.angle_deg <= tolerance:
            self.position = pending.index
            return Input.NEAR
        self._refusal = place_refusal(self.plan, nearest, pending)
        return Input.REFUSED

    def _check_side(self, direction: FloatArray) -> None:
        """Say when the sides shown contradict the accelerometer's axes."""
        target = self.plan.proposed()
        doubt = (
            None
            if target is None
            else self._sides.note(self.plan.position(target).direction, direction, chosen=bool(self.plan.accepted))
        )
        if doubt is not None:
            self.reject(doubt)

    def begin_hold(self) -> None:
        """Say that the hold begins."""
        self._linger_direction = None
        self.weighing.begin()
        self._hold = None
        position = self._current()
        direction = self._direction(np.array(self.detector.stretch.mean[:3]))
        angle = angle_deg(position.direction, direction)
        self.events.append(Hold(self.now_s, position.name, position.words, angle, self.weighing.latest_s))

    def count(self) -> Input | None:
        """Count the cells of a hold; when there are enough, see whether enough remain after trimming."""
        self._hold = self.weighing.look()
        if self._hold is not None:
            return Input.LONG_ENOUGH
        if self.due("holding", self.settings.repeat_s):
            self.events.append(Holding(self.now_s, self._current().name, self.weighing.fraction, self.weighing.left_s))
        return None

    def judge(self) -> Input:
        """Examine the hold."""
        self._refusal = None if self._hold is None else examine(self._hold) or self._cold()
        if self._refusal is None:
            return Input.GOOD
        return Input.AGAIN if self._refusal.reason in _PASSING else Input.REFUSED

    def _cold(self) -> Refusal | None:
        """Refuse to begin while the instrument warms up."""
        if self.plan.accepted or self.go_cold:
            return None
        return warming_refusal(self.warmth.slope_degc_min, self.settings.warm_up_degc_min)

    def accept(self) -> Input | None:
        """Take the observation and say what comes next."""
        index, hold = self.position, self._hold
        if index is None or hold is None:
            return None
        position = self._current()
        observation = observe(hold.cells, hold.limits, position.name, position.direction, held=hold.held)
        revisit = index == self.plan.revisiting
        replaces = self.plan.accept(index, observation)
        self.weighing.learn(hold)
        direction = self._direction(observation.mean_raw)
        self.fit_again()
        self.events.append(accepted_event(self.now_s, observation, hold.scale, self.plan, replaces=replaces, fit=self.fit))
        self.rested, self._rest_direction, self._was_unseen = index, direction, False
        # What led here was seen before; only a move from here makes the next rest another one.
        self.lift()
        self._forget_hold()
        self._let_go = 0
        if revisit:
            self._advise_drift()
        self._advise()
        return self.go_on()

    def go_on(self) -> Input | None:
        """Say what comes next, or that nothing does."""
        if self.plan.proposed() is None:
            self._ask_again()
        if self.plan.proposed() is not None:
            self.propose()
            return None
        return Input.TURNS if self.turns.left else Input.COMPLETE

    def _ask_again(self) -> None:
        """Ask for doubtful positions once more, each once, and then for the first one, as a check for drift."""
        for name in self.doubts.ask_again():
            if (index := self.plan.find(name)) is not None:
                self.plan.want_again(index)
        first = self.plan.first_accepted
        unseen = self.plan.revisited is None and "revisit" not in self._advised
        if self.plan.proposed() is None and self.settings.revisit_first and unseen and first is not None:
            self._advised.add("revisit")
            self.plan.revisiting = first

    def fit_again(self) -> None:
        """Fit everything measured so far, and choose the next position where another helps clearly more."""
        observations = list(self.plan.accepted.values())
        self.fit = running_fit(observations, self.detector.scale, self.settings.gravity_m_s2)
        self.doubts.follow(self.fit)
        self.plan.preferred = None
        pending = self.plan.pending()
        if self.fit is None or len(pending) < 2:
            return
        gain = self.fit.gain(np.array([self.plan.position(i).direction for i in pending]))
        hurried = self.settings.target_bias_ug is not None or self.settings.target_scale_ppm is not None
        if gain.max() > (1.0 if hurried else CLEARLY_MORE) * gain[0]:
            self.plan.preferred = pending[int(np.argmax(gain))]

    def _advise(self) -> None:
        """Say what the running fit shows that the operator may want to act on; each thing once."""
        if self.fit is None:
            return
        self.events += self.doubts.say(self.now_s, self.fit, self.plan)
        for advice in (
            target_advice(self.now_s, self.fit, self.settings),
            scheme_advice(self.now_s, self.fit, self.plan),
            scale_advice(self.now_s, self.fit),
        ):
            if advice is not None and (key := f"{advice.topic.value} {advice.position}") not in self._advised:
                self._advised.add(key)
                self.events.append(advice)

    def _advise_drift(self) -> None:
        first = self.plan.first_accepted
        if first is None or self.plan.revisited is None:
            return
        before = self.plan.accepted[first]
        self.events.append(drift_advice(self.now_s, before, self.plan.revisited, self.detector.scale, fit=self.fit))

    def _advise_scale(self) -> None:
        """Say at the end what the common scale is against the earlier one, or the nominal one where that was not said."""
        told = f"{Topic.SCALE.value} None" in self._advised and self.settings.earlier_scale_raw is None
        scale = None if self.fit is None or told else final_scale_advice(self.now_s, self.fit, self.settings)
        if scale is not None:
            self.events.append(scale)

    def begin_turn(self) -> None:
        """Follow a turn from the end of a still stretch."""
        if self.judgement is not None:
            self.turns.begin(self.judgement, self.detector.scale)

    def follow_turn(self) -> None:
        """Take one cell of a turn."""
        if self.judgement is not None:
            self.turns.follow(self.judgement, self.detector.scale)

    def see_turn(self) -> Input | None:
        """See, once the unit has rested, whether the move before was one of the turns that are wanted."""
        if not self.turns.rest(self.detector):
            return None
        made = self.turns.end(self.detector.stretch.mean, self.detector.scale)
        if made is None:
            return None
        if isinstance(made, Refusal):
            self.reject(made)
        else:
            self.events.append(self.turns.turned(self.now_s, made))
        self.propose_turn()
        return None if self.turns.left else Input.COMPLETE

    def refuse(self) -> None:
        """Say why the hold is refused; the unit must be moved."""
        self._reject_hold()
        self._forget_hold()

    def measure_again(self) -> None:
        """Say why the hold is refused and begin anew where the unit lies."""
        self._reject_hold()
        self.weighing.begin()
        self.detector.restart()

    def interrupt(self) -> None:
        """Refuse a hold that ended too early."""
        judgement = self.judgement
        if judgement is None or judgement.ended is None:
            return
        guards = 2 * self.weighing.guard(in_hand=False)
        held_s = max(judgement.ended.judged - guards, 0) * self.detector.settings.cell_s
        activity = self.detector.explain(judgement)
        if activity.ratio <= self.detector.settings.leave_factor:
            cells = judgement.cells[judgement.row : judgement.row + 1]
            self._refusal = explain_flags(cells, 0.0, 1 - self.settings.checks.lost_share)
            self._reject_hold()
        elif held_s >= self.settings.silent_s:
            self._let_go += 1
            self._refusal = moved_refusal(
                activity, self.detector.settings.leave_factor, (held_s, self.weighing.latest_s), self._let_go
            )
            self._reject_hold()
        self._forget_hold()
        self.lift()

    def lift(self) -> None:
        """Begin to watch whether the unit is lifted or only knocked."""
        self._moved_cells, self._moved_deg = 0, 0.0
        self._linger_direction = None

    def rest(self) -> None:
        """Wait for the unit to be moved."""

    def note_motion(self, judgement: Judgement) -> None:
        """Remember how long and how far the unit has moved."""
        self._moved_cells += judgement.phase is Phase.MOVING
        self._sides.follow(self._direction(judgement.cells.mean[judgement.row, :3]))
        if self._rest_direction is not None:
            direction = self._direction(judgement.cells.mean[judgement.row, :3])
            self._moved_deg = max(self._moved_deg, angle_deg(self._rest_direction, direction))

    def _was_lifted(self) -> bool:
        moved_s = self._moved_cells * self.detector.settings.cell_s
        return moved_s > self.settings.moved_s or self._moved_deg > self.settings.moved_deg

    def _was_moved_unseen(self, direction: FloatArray) -> bool:
        """Whether the unit does not lie as it did before samples were missing."""
        before = self._rest_direction
        return self._was_unseen and before is not None and angle_deg(before, direction) > self.settings.moved_unseen_deg

    def pause(self) -> None:
        """Stop measuring."""
        self.events.append(Marked(self.now_s, "pause", None, "paused; nothing is measured until you go on"))

    def resume(self) -> Input | None:
        """Go on measuring."""
        self.detector.restart()
        self.events.append(Marked(self.now_s, "pause", None, "going on"))
        return self.go_on()

    def lose_link(self) -> None:
        """Say that the link is gone; a hold under way is given up."""
        self.detector.interrupt()
        self.weighing.history.clear()
        self.warmth.clear()
        self.weighing.first_judged_s = -math.inf
        self.turns.forget_move()
        self._forget_hold()
        self._was_unseen = True
        self.events.append(LinkLost(self.now_s, len(self.plan.accepted), len(self.plan.scheme)))

    def find_link(self) -> Input | None:
        """Say that the link is back."""
        done = f"{len(self.plan.accepted)} of {len(self.plan.scheme)}"
        self.events.append(LinkBack(self.now_s, f"going on, {done} done; a hold that was under way begins anew"))
        answer = self.go_on() if self.announced else None
        # The sample clock may start anew.
        self.now_s = math.nan
        return answer

    def reopen(self) -> None:
        """Go on with a session that was finished early, as after a lost link."""
        self.turns.take_up()
        self.lose_link()

    def finish(self) -> None:
        """Say that the session is over."""
        self.turns.give_up()
        self._advise_scale()
        accepted, planned, missing = len(self.plan.accepted), len(self.plan.scheme), self.plan.missing()
        words = "all positions are measured" if not missing else f"finished with {accepted} of {planned} positions"
        if self.doubts.now:
            words += f"; still in doubt: {', '.join(one.name for one in self.doubts.now)}"
        self.events.append(Done(self.now_s, accepted, planned, missing, words))
