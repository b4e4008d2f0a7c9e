"""What the guide does: the actions that the state table names.

An action may answer with another input for the table. One recognises the position (near, measured already, near none). Beside
them: where the unit rested last and whether it was moved since, and whether it lingers without becoming still. The operator's
retake, skip and undo are marks: ``guide``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imufield.guide import refusals
from imufield.guide.cross_checks.centre import FEWEST_STILLS, may_hide_offset
from imufield.guide.cross_checks.sides import SidesCheck
from imufield.guide.events import Done, Hold, Holding, LinkBack, LinkLost, Marked, RefusalCode, Turning, vector
from imufield.guide.hold.checks import LOST_SHARE, check_gravity, examine, explain_flags
from imufield.guide.hold.observe import observe
from imufield.guide.hold.output import HoldOutput
from imufield.guide.lead.advice import Adviser, time_advice
from imufield.guide.lead.hold_under_way import HoldUnderWay
from imufield.guide.lead.plan import Plan
from imufield.guide.lead.settings import MOVED_DEG, MOVED_S, GuideSettings
from imufield.guide.lead.speaker import REMIND_S, REPEAT_S, Speaker, accepted_event, floor_event, move_event
from imufield.guide.lead.state_table import Input
from imufield.guide.lead.stream_watch import StreamWatch
from imufield.guide.lead.turns import TurnLeader
from imufield.guide.positions import Scheme, angle_deg
from imufield.guide.refusals import Refusal
from imufield.guide.stillness.detector import LONGEST_KEPT_S, StillnessDetector
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import LEAVE_FACTOR, Judgement, Phase, Stretch
from imufield.samples import CELL_S, FloatArray
from imufield.sentences import Sentences

sentence = Sentences(__package__)

_SILENT_S = 1.0  # A hold that ends within this time (guard bands off) was a pause in a turn; nobody needs to hear of it.
_IN_A_ROW = 2  # Holds that end by motion before the guide says what to do otherwise.
# Refusals that pass if the unit is left where it is.
_PASSING = (
    RefusalCode.DRIFTING,
    RefusalCode.KNOCKED,
    RefusalCode.SAMPLE_LOSS,
    RefusalCode.FROZEN,
    RefusalCode.START_UP,
    RefusalCode.TREMBLING,
    RefusalCode.SWAYING,
)
# Nobody puts a unit down again within this while the link is gone; one that nobody touched stays within a tenth of it.
_MOVED_UNSEEN_DEG = 0.5
# A unit that keeps its direction this long without becoming still: somebody waits for the guide.
_LINGER_S = 5.0
_HOLD_MARGIN_S = 10.0  # A stretch is kept for longer than the hold: guard bands, and ends that are cut off.
_LINGER_COSINE = math.cos(math.radians(5.0))


class Resting:
    """The position accepted last, as long as the unit may still be there."""

    def __init__(self) -> None:
        self.position: int | None = None
        self.unobserved = False  # Samples are missing since: it may have been moved meanwhile.
        self._direction: FloatArray | None = None
        self.lift()

    def begin(self, position: int, direction: FloatArray) -> None:
        """Remember where the unit rests; ``direction`` is that of up in the body, unit vector (3,)."""
        self.position, self._direction, self.unobserved = position, direction, False
        # The way here was observed already; only a move from here makes the next rest another one.
        self.lift()

    def measure_anew(self, plan: Plan, position: int) -> None:
        """Let a unit that still rests at this position be measured there once more."""
        if self.position is not None and plan.same_direction(self.position, position):
            self.position = None

    def lift(self) -> None:
        """Begin to watch whether the unit is lifted or only knocked."""
        self._moved_cells, self._moved_deg = 0, 0.0

    def follow(self, direction: FloatArray, *, moving: bool) -> None:
        """Add a cell that is not still, and where it has up."""
        self._moved_cells += moving
        if self._direction is not None:
            self._moved_deg = max(self._moved_deg, angle_deg(self._direction, direction))

    def check(self, direction: FloatArray) -> int | None:
        """Return the position where the unit still rests, forgotten where it was moved; ``direction`` is that of up now."""
        lifted = self._moved_cells * CELL_S > MOVED_S or self._moved_deg > MOVED_DEG
        before = self._direction
        if lifted or (self.unobserved and before is not None and angle_deg(before, direction) > _MOVED_UNSEEN_DEG):
            self.position = None
        return self.position


class Lingering:
    """Watches for a unit that keeps its direction and does not become still."""

    def __init__(self) -> None:
        self._direction: FloatArray | None = None
        self._from_s = math.nan

    def lasts(self, now_s: float, direction: FloatArray) -> bool:
        """Add where up is in the body, unit vector (3,); return whether the unit has lingered there for long enough."""
        before = self._direction
        # Written so that NaN begins anew, and so does a clock that was set back.
        if before is None or not now_s >= self._from_s or not float(np.dot(before, direction)) > _LINGER_COSINE:
            self._direction, self._from_s = direction, now_s
            return False
        return now_s - self._from_s > _LINGER_S


class GuideActions:
    """The parts of a session, the actions, and what they remember between two cells.

    Parameters
    ----------
    scheme : Scheme
    scale : RoughScale
    settings : GuideSettings
    """

    def __init__(self, scheme: Scheme, scale: RoughScale, settings: GuideSettings) -> None:
        longest_s = max(LONGEST_KEPT_S, settings.longest_hold_s + _HOLD_MARGIN_S)
        self.plan = Plan(scheme)
        self.detector = StillnessDetector(scale, hand=True, longest_s=longest_s)
        self.speaker = Speaker()
        self.hold = HoldUnderWay(self.detector, settings.hold_target, longest_s)
        self.adviser = Adviser(self.plan, settings)
        self.turns = TurnLeader(settings.rotations)
        self.watch = StreamWatch(self.detector, self.speaker)
        self.resting = Resting()
        self.announced = False  # Whether the noise floor was announced.
        self.judgement: Judgement | None = None
        self._lingering = Lingering()
        self._sides = SidesCheck()
        self._moved_in_a_row = 0  # Holds that ended by motion, since the last one accepted.

    def _reject_hold(self) -> None:
        position = self.hold.position
        self.speaker.reject(self.hold.refusal, None if position is None else self.plan.position(position).name)

    def up_now(self) -> FloatArray:
        """Return where up is in the body by the latest cell, unit vector (3,), NaN while not known."""
        if self.judgement is None:
            return np.full(3, np.nan)
        return self.detector.scale.up(self.judgement.cells.mean[self.judgement.row, :3])

    def note_motion(self, phase: Phase) -> None:
        """Remember how long and how far the unit has moved."""
        up = self.up_now()
        self._sides.follow(up)
        self.resting.follow(up, moving=phase is Phase.MOVING)

    def announce_floor(self) -> None:
        """Announce the noise floor and the first position."""
        floor = self.detector.floor
        if floor is None:
            return
        self.announced = True
        self.hold.first_judged_s = floor.start_s
        self.speaker.now_s = floor.start_s + floor.duration_s
        self.speaker.say(floor_event(self.speaker.now_s, floor, self.detector))
        time = self.adviser.session_time(floor, self.detector.scale)
        if time is not None:
            self.hold.target = time.hold_target
            self.speaker.say(time_advice(self.speaker.now_s, time))
        nearest = self.plan.nearest(self.detector.scale.up(floor.mean[:3]), pending=True)
        if nearest is not None and nearest.angle_deg <= self.plan.tolerance_deg:
            self.plan.first = nearest.index
        self.propose()

    def propose(self) -> None:
        """Announce the next position or turn."""
        index = self.plan.proposed()
        if index is None:
            self.propose_turn()
        else:
            self.speaker.say(move_event(self.speaker.now_s, self.plan, index))

    def propose_turn(self) -> None:
        """Announce the next whole turn."""
        self.speaker.say(*self.turns.next(self.speaker.now_s))

    def show_turning(self) -> None:
        """Tell where the unit points, a few times a second, and what keeps it from being still where it lingers."""
        target, judgement, speaker = self.plan.proposed(), self.judgement, self.speaker
        if judgement is None or target is None:
            return
        direction = self.up_now()
        if self._lingering.lasts(speaker.now_s, direction) and judgement.phase is Phase.MOVING:
            activity = self.detector.explain(judgement)
            if activity.ratio > 1 and speaker.due("not still", REMIND_S):
                speaker.reject(activity.refusal(refusals.NOT_STILL))
        if not speaker.due("turning", REPEAT_S):
            return
        nearest = self.plan.nearest(direction, pending=True) if np.isfinite(direction).all() else None
        if nearest is None:
            return
        goal = self.plan.position(target)
        event = Turning(
            time_s=speaker.now_s,
            direction=vector(direction),
            position=self.plan.position(nearest.index).name,
            angle_deg=nearest.angle_deg,
            target=goal.name,
            target_angle_deg=angle_deg(goal.direction, direction),
        )
        speaker.say(event)

    def leave_side(self, still: Stretch) -> None:
        """Add a still stretch that has ended, and what it shows of the others."""
        asked = self.plan.proposed()
        self.watch.leave_side(still)
        self._judge_anew()
        if self.plan.proposed() != asked:
            self.propose()

    def _judge_anew(self, more: Sequence[float] = ()) -> None:
        """Judge what was accepted by the offset that all stills show, with the mean of one more that goes on."""
        before = self.detector.scale
        self.watch.centre(more)
        scale = self.detector.scale
        if not np.array_equal(scale.raw_zero, before.raw_zero):
            renamed = self.plan.place_anew(lambda observation: scale.up(observation.mean_raw))
            self.speaker.say(self.adviser.offset_advice(self.speaker.now_s, before, scale, renamed=renamed))
        self.take_back()

    def judge_restored(self, index: int) -> None:
        """Judge what an undo has brought back by all that the session has shown since, and fit anew."""
        scale = self.detector.scale
        self.plan.place_anew(lambda observation: scale.up(observation.mean_raw), self.plan.accepted.keys() & {index})
        self.take_back()
        self.adviser.fit_again(scale)

    def recognise(self) -> Input:
        """Find the position that the unit is in."""
        plan = self.plan
        self.hold.refusal = None
        direction = self.detector.scale.up(np.array(self.detector.stretch.mean[:3]))
        pending, nearest = plan.nearest(direction, pending=True), plan.nearest(direction, pending=False)
        if nearest is None:
            return Input.SAME
        rests_at = self.resting.check(direction)
        if rests_at is not None and plan.same_direction(nearest.index, rests_at):
            return Input.SAME
        target = plan.proposed()
        if target is not None:
            asked = plan.position(target).direction
            self.speaker.reject(self._sides.note(asked, direction, chosen=bool(plan.accepted)))
        if pending is not None and pending.angle_deg <= plan.tolerance_deg:
            self.hold.position = pending.index
            self.hold.refusal = self.watch.warmth.refusal(self.plan)
            return Input.NEAR if self.hold.refusal is None else Input.REFUSED
        if nearest.angle_deg <= plan.tolerance_deg:
            self.hold.refusal = refusals.ALREADY_DONE.refusal(
                nearest.angle_deg,
                plan.tolerance_deg,
                position=plan.position(nearest.index).name,
                left=refusals.what_is_left([plan.position(k).name for k in plan.pending()]),
            )
            return Input.REFUSED
        closest = pending or nearest
        # The picture shows what is proposed; the words must not ask for another side.
        wanted = plan.position(closest.index if target is None else target)
        hides = may_hide_offset(np.array(self.detector.stretch.mean[:3]), self.detector.scale)
        self.hold.refusal = (refusals.NOT_NEAR_BY_OFFSET if hides else refusals.NOT_NEAR).refusal(
            closest.angle_deg,
            plan.tolerance_deg,
            nearest=plan.position(closest.index).name,
            wanted=wanted.name,
            wanted_words=wanted.words,
            sides=FEWEST_STILLS,
        )
        return Input.REFUSED

    def begin_hold(self) -> None:
        """Announce that the hold begins."""
        self._lingering = Lingering()
        self.hold.begin()
        if self.hold.position is None:
            return
        position = self.plan.position(self.hold.position)
        direction = self.detector.scale.up(np.array(self.detector.stretch.mean[:3]))
        angle = angle_deg(position.direction, direction)
        self.speaker.say(Hold(self.speaker.now_s, position.name, position.words, angle, self.hold.expected_s))

    def count(self) -> Input | None:
        """Count the cells of a hold; when there are enough, check whether enough remain after trimming."""
        hold, speaker = self.hold, self.speaker
        if hold.evaluate():
            return Input.LONG_ENOUGH
        if hold.position is not None and speaker.due("holding", REPEAT_S):
            speaker.say(Holding(speaker.now_s, self.plan.position(hold.position).name, hold.fraction, hold.left_s))
        return None

    def judge(self) -> Input:
        """Examine the hold."""
        hold = self.hold
        measured = hold.measured
        hold.refusal = self.watch.warmth.refusal(self.plan)
        if hold.refusal is None and measured is not None:
            found = examine(measured) or check_gravity(measured.cells.mean[:, :3].mean(axis=0), measured.scale)
            hold.output = output = HoldOutput.of(measured.cells)
            self.watch.outputs.add(output, again=hold.again_at is not None and hold.again_at == hold.position)
            hold.refusal = self.watch.outputs.refusal(output, found)
            self.take_back()
        if hold.refusal is None:
            return Input.GOOD
        return Input.AGAIN if hold.refusal.reason in _PASSING else Input.REFUSED

    def take_back(self) -> None:
        """Withdraw what was accepted before later holds and stills showed what is wrong with it."""
        scale = self.detector.scale
        for index, observation in list(self.plan.accepted.items()):
            refusal = self.watch.outputs.refusal(observation.output, check_gravity(observation.mean_raw, scale))
            if refusal is not None:
                self.plan.take_back(index)
                self.speaker.reject(refusals.taken_back(refusal, observation.name), observation.name)
                self.adviser.fit_again(scale)

    def accept(self) -> Input | None:
        """Add the observation to the plan and announce what comes next."""
        plan, adviser, now_s = self.plan, self.adviser, self.speaker.now_s
        index, hold = self.hold.position, self.hold.measured
        if index is None or hold is None:
            return None
        position = plan.position(index)
        hand_mean, output = hold.hand_mean, self.hold.output
        observation = observe(hold.cells, hold.limits, position.name, position.direction, hand_mean=hand_mean, output=output)
        observation = self.watch.outputs.with_resolution(observation)
        is_revisit = index == plan.revisiting
        replaces = plan.accept(index, observation)
        self.hold.learn(hold)
        adviser.fit_again(self.detector.scale)
        event = accepted_event(
            now_s,
            observation,
            hold.scale,
            plan,
            replaces=replaces,
            fit=adviser.fit,
            forecast=adviser.forecast,
            others=adviser.compared.get(index),
        )
        self.speaker.say(event)
        self._lingering = Lingering()
        self.hold.forget()
        self._moved_in_a_row = 0
        if is_revisit:
            self.speaker.say(*adviser.drift_advice(now_s, self.detector.scale, index))
        self.speaker.say(*adviser.advise(now_s))
        self._judge_anew(observation.mean_raw.tolist())
        # Only now: this very hold may have shown that it is another side.
        up = self.detector.scale.up(observation.mean_raw)
        nearest = plan.nearest(up, pending=False)
        self.resting.begin(index if nearest is None else nearest.index, up)
        return self.go_on()

    def go_on(self) -> Input | None:
        """Announce what comes next, or answer that nothing does."""
        if self.plan.proposed() is None:
            self.adviser.ask_again()
        if self.plan.proposed() is not None:
            self.propose()
            return None
        return Input.TURNS if self.turns.left else Input.COMPLETE

    def begin_turn(self) -> None:
        """Follow a turn from the end of a still stretch."""
        if self.judgement is not None:
            self.turns.begin(self.judgement, self.detector.scale)

    def follow_turn(self) -> None:
        """Add one cell of a turn."""
        if self.judgement is not None:
            self.turns.follow(self.judgement, self.detector.scale)

    def see_turn(self) -> Input | None:
        """Once the unit has rested, find out whether the move before was one of the turns that are wanted."""
        if not self.turns.rest(self.detector):
            return None
        made = self.turns.end(self.speaker.now_s, self.detector.stretch.mean, self.detector.scale)
        if made is None:
            return None
        if isinstance(made, Refusal):
            self.speaker.reject(made)
        else:
            self.speaker.say(made)
        self.propose_turn()
        return None if self.turns.left else Input.COMPLETE

    def refuse(self) -> None:
        """Tell why the hold is refused; the unit must be moved."""
        self._reject_hold()
        self.hold.forget()

    def measure_again(self) -> None:
        """Tell why the hold is refused and begin anew where the unit is."""
        self._reject_hold()
        self.hold.again_at = self.hold.position
        self.hold.begin()
        self.detector.restart()

    def interrupt(self) -> None:
        """Refuse a hold that ended too early."""
        judgement = self.judgement
        if judgement is None or judgement.ended is None:
            return
        lasted_s = self.hold.lasted_s(judgement.ended)
        activity = self.detector.explain(judgement)
        if activity.ratio <= LEAVE_FACTOR:
            # Nothing moved: samples are missing.
            cells = judgement.cells[judgement.row : judgement.row + 1]
            self.hold.refusal = explain_flags(cells, 1.0, LOST_SHARE)
            self._reject_hold()
        elif lasted_s >= _SILENT_S:
            self._moved_in_a_row += 1
            self.hold.refusal = activity.refusal(
                refusals.MOVED if self._moved_in_a_row < _IN_A_ROW else refusals.MOVED_AGAIN,
                LEAVE_FACTOR,
                what="shook" if activity.kind == "vibration" else "moved",
                lasted_s=lasted_s,
                hold_s=round(self.hold.expected_s, 1),
                times=self._moved_in_a_row,
            )
            self._reject_hold()
        self.hold.forget()
        self.lift()

    def give_up(self) -> Input | None:
        """End the hold as the operator wants; where the unit lies now, none begins before it is moved."""
        if self.hold.position is not None:
            self.resting.begin(self.hold.position, self.up_now())
        self.hold.forget()
        return self.go_on()

    def lift(self) -> None:
        """Begin to watch whether the unit is lifted or only knocked."""
        self.resting.lift()
        self._lingering = Lingering()

    def rest(self) -> Input | None:
        """Wait for the unit to be moved, or for its temperature to be steady where nothing else is in the way."""
        refusal = self.hold.refusal
        if refusal is None or refusal.reason is not RefusalCode.WARMING_UP or self.watch.warmth.refusal(self.plan):
            return None
        self.detector.restart()
        return Input.AGAIN

    def pause(self) -> None:
        """Stop measuring."""
        self.speaker.say(Marked(self.speaker.now_s, "pause", None, sentence("guide_actions.paused")))

    def resume(self) -> Input | None:
        """Go on measuring."""
        self.detector.restart()
        self.speaker.say(Marked(self.speaker.now_s, "pause", None, sentence("guide_actions.resumed")))
        return self.go_on()

    def lose_link(self) -> None:
        """Announce that the link is gone; a hold under way is given up."""
        self.detector.interrupt()
        self.hold.history.clear()
        self.hold.first_judged_s = -math.inf
        self.watch.warmth.clear()
        self.turns.forget_move()
        self.hold.forget()
        self.resting.unobserved = True
        self.speaker.say(LinkLost(self.speaker.now_s, len(self.plan.accepted), len(self.plan.scheme)))

    def find_link(self) -> Input | None:
        """Announce that the link is back."""
        words = sentence("guide_actions.link_back", accepted=len(self.plan.accepted), planned=len(self.plan.scheme))
        self.speaker.say(LinkBack(self.speaker.now_s, words))
        answer = self.go_on() if self.announced else None
        # The sample clock may start anew.
        self.speaker.now_s = math.nan
        return answer

    def reopen(self) -> None:
        """Go on with a session that was finished, as after a lost link."""
        self.turns.take_up()
        self.lose_link()

    def finish(self) -> None:
        """Announce that the session is over."""
        self.turns.give_up()
        self.speaker.say(*self.adviser.final_advice(self.speaker.now_s))
        accepted, planned, missing = len(self.plan.accepted), len(self.plan.scheme), self.plan.missing()
        words: str = sentence(
            "guide_actions.finished" if missing else "guide_actions.all_measured", accepted=accepted, planned=planned
        )
        if names := self.adviser.suspect_names:
            words += f"; {sentence('guide_actions.in_doubt', names=names)}"
        self.speaker.say(Done(self.speaker.now_s, accepted, planned, missing, words))
