"""What the guide does: the actions that the state table names.

An action may answer with another input for the table.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from imufield.guide import refusals
from imufield.guide.cross_checks.sides import SidesCheck
from imufield.guide.events import Done, Hold, Holding, LinkBack, LinkLost, Marked, RefusalCode, Turning, Vector, vector
from imufield.guide.hold.checks import LOST_SHARE, examine, explain_flags
from imufield.guide.hold.observe import observe
from imufield.guide.lead.advice import Adviser
from imufield.guide.lead.hold_under_way import HoldUnderWay
from imufield.guide.lead.plan import Nearest, Plan
from imufield.guide.lead.resting import Lingering, Resting
from imufield.guide.lead.speaker import REMIND_S, REPEAT_S, Speaker, accepted_event, floor_event, move_event
from imufield.guide.lead.state_table import Input
from imufield.guide.lead.stream_watch import StreamWatch
from imufield.guide.lead.turns import TurnLeader
from imufield.guide.positions import angle_deg
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.detector import StillnessDetector
from imufield.guide.stillness.stretch import LEAVE_FACTOR, Judgement, Phase

# No position is accepted first while the temperature changes faster than this: the bias of a chip would follow it.
_WARM_UP_DEGC_MIN = 0.5
_SILENT_S = 1.0  # A hold that ends within this time (guard bands off) was a pause in a turn; nobody needs to hear of it.
_IN_A_ROW = 2  # Holds that end by motion before the guide says what to do otherwise.
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
    """The actions of a session, and what they remember between two cells. The parts are those of the session."""

    def __init__(
        self,
        *,
        plan: Plan,
        detector: StillnessDetector,
        speaker: Speaker,
        hold: HoldUnderWay,
        adviser: Adviser,
        turns: TurnLeader,
        watch: StreamWatch,
    ) -> None:
        self._plan = plan
        self._detector = detector
        self._speaker = speaker
        self._hold = hold
        self._adviser = adviser
        self._turns = turns
        self._watch = watch
        self.resting = Resting()
        self.goes_on_cold = False  # The operator does not wait for the temperature.
        self.announced = False  # Whether the noise floor was announced.
        self.judgement: Judgement | None = None
        self._sides = SidesCheck()
        self._lingering = Lingering()
        self._moved_in_a_row = 0  # Holds that ended by motion, since the last one accepted.

    def run(self, name: str) -> Input | None:
        """Run the action of a name; return its answer."""
        action: Callable[[], Input | None] = getattr(self, name)
        return action()

    def _reject_hold(self) -> None:
        position = self._hold.position
        self._speaker.reject(self._hold.refusal, None if position is None else self._plan.position(position).name)

    def direction_now(self) -> Vector | None:
        """Return where up is in the body by the latest cell, None while not known."""
        if self.judgement is None:
            return None
        direction = self._detector.scale.up(self.judgement.cells.mean[self.judgement.row, :3])
        return vector(direction) if np.isfinite(direction).all() else None

    def note_motion(self, judgement: Judgement) -> None:
        """Remember how long and how far the unit has moved."""
        direction = self._detector.scale.up(judgement.cells.mean[judgement.row, :3])
        self._sides.follow(direction)
        self.resting.follow(direction, moving=judgement.phase is Phase.MOVING)

    def announce_floor(self) -> None:
        """Announce the noise floor and the first position."""
        floor = self._detector.floor
        if floor is None:
            return
        self.announced = True
        self._hold.first_judged_s = floor.start_s
        self._speaker.now_s = floor.start_s + floor.duration_s
        self._speaker.say(floor_event(self._speaker.now_s, floor, self._detector))
        nearest = self._plan.nearest(self._detector.scale.up(floor.mean[:3]), pending=True)
        if nearest is not None and nearest.angle_deg <= self._plan.tolerance_deg:
            self._plan.first = nearest.index
        self.propose()

    def propose(self) -> None:
        """Announce the next position or turn."""
        index = self._plan.proposed()
        if index is None:
            self.propose_turn()
        else:
            self._speaker.say(move_event(self._speaker.now_s, self._plan, index))

    def propose_turn(self) -> None:
        """Announce the next whole turn."""
        self._speaker.say(*self._turns.next(self._speaker.now_s))

    def show_turning(self) -> None:
        """Tell where the unit points, a few times a second, and what keeps it from being still where it lingers."""
        target, judgement, speaker = self._plan.proposed(), self.judgement, self._speaker
        if judgement is None or target is None:
            return
        direction = self._detector.scale.up(judgement.cells.mean[judgement.row, :3])
        if self._lingering.lasts(speaker.now_s, direction) and judgement.phase is Phase.MOVING:
            activity = self._detector.explain(judgement)
            if activity.ratio > 1 and speaker.due("not still", REMIND_S):
                speaker.reject(activity.refusal(refusals.NOT_STILL))
        if not speaker.due("turning", REPEAT_S):
            return
        nearest = self._plan.nearest(direction, pending=True) if np.isfinite(direction).all() else None
        if nearest is None:
            return
        goal = self._plan.position(target)
        event = Turning(
            time_s=speaker.now_s,
            direction=vector(direction),
            position=self._plan.position(nearest.index).name,
            angle_deg=nearest.angle_deg,
            target=goal.name,
            target_angle_deg=angle_deg(goal.direction, direction),
        )
        speaker.say(event)

    def recognise(self) -> Input:
        """Find the position that the unit is in."""
        plan = self._plan
        direction = self._detector.scale.up(np.array(self._detector.stretch.mean[:3]))
        pending, nearest = plan.nearest(direction, pending=True), plan.nearest(direction, pending=False)
        if nearest is None:
            return Input.SAME
        rests_at = self.resting.check(direction)
        if rests_at is not None and plan.same_direction(nearest.index, rests_at):
            return Input.SAME
        target = plan.proposed()
        if target is not None:
            asked = plan.position(target).direction
            self._speaker.reject(self._sides.note(asked, direction, chosen=bool(plan.accepted)))
        if pending is not None and pending.angle_deg <= plan.tolerance_deg:
            self._hold.position = pending.index
            return Input.NEAR
        self._hold.refusal = self._refuse_place(nearest, pending or nearest)
        return Input.REFUSED

    def _refuse_place(self, nearest: Nearest, closest: Nearest) -> Refusal:
        """Return the refusal of a still unit that is in no pending position; ``closest`` is of the pending ones, if any."""
        plan, limit = self._plan, self._plan.tolerance_deg
        if nearest.angle_deg <= limit:
            name, left = plan.position(nearest.index).name, refusals.what_is_left(plan.missing())
            return refusals.ALREADY_DONE.refusal(nearest.angle_deg, limit, position=name, left=left)
        # The picture shows what is proposed; the words must not ask for another side.
        target = plan.proposed()
        wanted = plan.position(closest.index if target is None else target)
        name = plan.position(closest.index).name
        return refusals.NOT_NEAR.refusal(closest.angle_deg, limit, nearest=name, wanted=wanted.name, wanted_words=wanted.words)

    def begin_hold(self) -> None:
        """Announce that the hold begins."""
        self._lingering.forget()
        self._hold.begin()
        if self._hold.position is None:
            return
        position = self._plan.position(self._hold.position)
        direction = self._detector.scale.up(np.array(self._detector.stretch.mean[:3]))
        angle = angle_deg(position.direction, direction)
        self._speaker.say(Hold(self._speaker.now_s, position.name, position.words, angle, self._hold.latest_s))

    def count(self) -> Input | None:
        """Count the cells of a hold; when there are enough, check whether enough remain after trimming."""
        hold, speaker = self._hold, self._speaker
        if hold.evaluate():
            return Input.LONG_ENOUGH
        if hold.position is not None and speaker.due("holding", REPEAT_S):
            speaker.say(Holding(speaker.now_s, self._plan.position(hold.position).name, hold.fraction, hold.left_s))
        return None

    def judge(self) -> Input:
        """Examine the hold."""
        hold = self._hold
        hold.refusal = None if hold.measured is None else examine(hold.measured) or self._refuse_cold()
        if hold.refusal is None:
            return Input.GOOD
        return Input.AGAIN if hold.refusal.reason in _PASSING else Input.REFUSED

    def _refuse_cold(self) -> Refusal | None:
        """Refuse to begin while the instrument warms up."""
        slope = self._watch.warmth.slope_degc_min
        if self._plan.accepted or self.goes_on_cold or abs(slope) <= _WARM_UP_DEGC_MIN:
            return None
        return refusals.WARMING_UP.refusal(abs(slope), _WARM_UP_DEGC_MIN, slope=slope)

    def accept(self) -> Input | None:
        """Add the observation to the plan and announce what comes next."""
        plan, adviser, now_s = self._plan, self._adviser, self._speaker.now_s
        index, hold = self._hold.position, self._hold.measured
        if index is None or hold is None:
            return None
        position = plan.position(index)
        observation = observe(hold.cells, hold.limits, position.name, position.direction, hand_mean=hold.hand_mean)
        is_revisit = index == plan.revisiting
        replaces = plan.accept(index, observation)
        self._hold.learn(hold)
        adviser.fit_again(self._detector.scale)
        self._speaker.say(accepted_event(now_s, observation, hold.scale, plan, replaces=replaces, fit=adviser.fit))
        self.resting.begin(index, self._detector.scale.up(observation.mean_raw))
        self._lingering.forget()
        self._hold.forget()
        self._moved_in_a_row = 0
        if is_revisit:
            self._speaker.say(*adviser.drift_advice(now_s, self._detector.scale))
        self._speaker.say(*adviser.advise(now_s))
        return self.go_on()

    def go_on(self) -> Input | None:
        """Announce what comes next, or answer that nothing does."""
        if self._plan.proposed() is None:
            self._adviser.ask_again()
        if self._plan.proposed() is not None:
            self.propose()
            return None
        return Input.TURNS if self._turns.left else Input.COMPLETE

    def begin_turn(self) -> None:
        """Follow a turn from the end of a still stretch."""
        if self.judgement is not None:
            self._turns.begin(self.judgement, self._detector.scale)

    def follow_turn(self) -> None:
        """Add one cell of a turn."""
        if self.judgement is not None:
            self._turns.follow(self.judgement, self._detector.scale)

    def see_turn(self) -> Input | None:
        """Once the unit has rested, find out whether the move before was one of the turns that are wanted."""
        if not self._turns.rest(self._detector):
            return None
        made = self._turns.end(self._speaker.now_s, self._detector.stretch.mean, self._detector.scale)
        if made is None:
            return None
        if isinstance(made, Refusal):
            self._speaker.reject(made)
        else:
            self._speaker.say(made)
        self.propose_turn()
        return None if self._turns.left else Input.COMPLETE

    def refuse(self) -> None:
        """Tell why the hold is refused; the unit must be moved."""
        self._reject_hold()
        self._hold.forget()

    def measure_again(self) -> None:
        """Tell why the hold is refused and begin anew where the unit is."""
        self._reject_hold()
        self._hold.begin()
        self._detector.restart()

    def interrupt(self) -> None:
        """Refuse a hold that ended too early."""
        judgement = self.judgement
        if judgement is None or judgement.ended is None:
            return
        lasted_s = self._hold.lasted_s(judgement.ended)
        activity = self._detector.explain(judgement)
        if activity.ratio <= LEAVE_FACTOR:
            # Nothing moved: samples are missing.
            cells = judgement.cells[judgement.row : judgement.row + 1]
            self._hold.refusal = explain_flags(cells, 0.0, 1 - LOST_SHARE)
            self._reject_hold()
        elif lasted_s >= _SILENT_S:
            self._moved_in_a_row += 1
            sentence = refusals.MOVED if self._moved_in_a_row < _IN_A_ROW else refusals.MOVED_AGAIN
            self._hold.refusal = activity.refusal(
                sentence,
                LEAVE_FACTOR,
                what="shook" if activity.kind == "vibration" else "moved",
                lasted_s=lasted_s,
                hold_s=self._hold.latest_s,
                times=self._moved_in_a_row,
            )
            self._reject_hold()
        self._hold.forget()
        self.lift()

    def lift(self) -> None:
        """Begin to watch whether the unit is lifted or only knocked."""
        self.resting.lift()
        self._lingering.forget()

    def rest(self) -> None:
        """Wait for the unit to be moved."""

    def pause(self) -> None:
        """Stop measuring."""
        self._speaker.say(Marked(self._speaker.now_s, "pause", None, "paused; nothing is measured until you go on"))

    def resume(self) -> Input | None:
        """Go on measuring."""
        self._detector.restart()
        self._speaker.say(Marked(self._speaker.now_s, "pause", None, "going on"))
        return self.go_on()

    def lose_link(self) -> None:
        """Announce that the link is gone; a hold under way is given up."""
        self._detector.interrupt()
        self._hold.history.clear()
        self._hold.first_judged_s = -math.inf
        self._watch.warmth.clear()
        self._turns.forget_move()
        self._hold.forget()
        self.resting.lose_link()
        self._speaker.say(LinkLost(self._speaker.now_s, len(self._plan.accepted), len(self._plan.scheme)))

    def find_link(self) -> Input | None:
        """Announce that the link is back."""
        done = f"{len(self._plan.accepted)} of {len(self._plan.scheme)}"
        self._speaker.say(LinkBack(self._speaker.now_s, f"going on, {done} done; a hold that was under way begins anew"))
        answer = self.go_on() if self.announced else None
        # The sample clock may start anew.
        self._speaker.now_s = math.nan
        return answer

    def reopen(self) -> None:
        """Go on with a session that was finished early, as after a lost link."""
        self._turns.take_up()
        self.lose_link()

    def finish(self) -> None:
        """Announce that the session is over."""
        self._turns.give_up()
        self._speaker.say(*self._adviser.final_advice(self._speaker.now_s))
        accepted, planned, missing = len(self._plan.accepted), len(self._plan.scheme), self._plan.missing()
        words = "all positions are measured" if not missing else f"finished with {accepted} of {planned} positions"
        if self._adviser.suspects.now:
            words += f"; still in doubt: {', '.join(self._adviser.suspects.names)}"
        self._speaker.say(Done(self._speaker.now_s, accepted, planned, missing, words))
