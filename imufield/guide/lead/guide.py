"""The guide: leads one person through the positions. Samples in, events out; no I/O, no clock but the samples' own.

``state_table`` says what happens when; ``guide_actions`` holds the actions. What a mark of the operator does (retake, skip,
undo) is here. Everything is decided between two cells of the sample clock, so the same recording with the same marks gives
the same events, however it is cut: a mark takes effect when the cell in which it was made is complete.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imufield.calibrate.model.observations import Observations
from imufield.dataclass import dataclass, replace
from imufield.guide.cross_checks.axes import AxesCheck
from imufield.guide.events import ACTIONS, Event, Marked, RefusalCode, Vector, vector
from imufield.guide.hold.observe import gather
from imufield.guide.lead.guide_actions import GuideActions
from imufield.guide.lead.live import LiveFeed, Signals
from imufield.guide.lead.settings import GuideSettings
from imufield.guide.lead.state_table import TABLE, Input, State
from imufield.guide.positions import Scheme
from imufield.guide.stillness.cells import CellBuilder, Cells
from imufield.guide.stillness.limits import Activity
from imufield.guide.stillness.scale import RoughScale
from imufield.guide.stillness.stretch import Judgement, Phase
from imufield.samples import CELL_S, Samples, SampleUnits, interval_of
from imufield.sentences import Sentences

sentence = Sentences(__package__)

# What the operator says that is an input of the table and nothing else.
_INPUTS = {"pause": Input.PAUSE, "finish": Input.FINISH, "reopen": Input.RESUMED}
_RECENT_CELLS = 10  # A second: rate and temperature that a live view shows.


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """State of a session for a live view, beside the events.

    Attributes
    ----------
    target, position : str or None
        The position proposed, and the one under way.
    fraction : float
        Part of the hold that is done.
    suspects, again : tuple of str
        Measured positions that the others contradict, and those to be measured once more.
    revisiting : str or None
        Measured position asked for once more at the end, as a check for drift.
    activity : Activity or None
        Stillness of the latest cell against its limit; without a link nobody knows.
    rate_hz : float
        Over the last second; NaN before.
    lost_cells : int
        Cells with missing or unusable samples so far.
    direction, target_direction : tuple of float or None
        Where up is in the body now, unit vector, None before the first sample or in free fall; and where it should be.
    forecast : dict or None
        1 sigma of the parameters now, see ``Accepted``; None until there are four positions.
    leave_one_out_m_s2 : dict of float
        Of the measured positions; empty until there are four.
    signals : Signals or None
        The live feed; None before the first.
    marks : tuple of str
        What the operator may say now with an effect: actions as ``Guide.mark`` takes them.
    """

    state: State
    target: str | None
    position: str | None
    fraction: float
    activity: Activity | None
    rate_hz: float
    lost_cells: int
    temperature_degc: float
    accepted: tuple[str, ...]
    skipped: tuple[str, ...]
    suspects: tuple[str, ...]
    again: tuple[str, ...]
    revisiting: str | None
    planned: int
    direction: Vector | None
    target_direction: Vector | None
    in_hand: bool
    forecast: dict[str, float] | None
    leave_one_out_m_s2: dict[str, float]
    signals: Signals | None
    marks: tuple[str, ...]


class Guide:
    """A guided session.

    Parameters
    ----------
    scheme : Scheme
    units : SampleUnits
    scale : RoughScale, optional
        What is known of the raw units; by default what their names say.
    settings : GuideSettings, optional
    """

    def __init__(
        self, scheme: Scheme, units: SampleUnits, *, scale: RoughScale | None = None, settings: GuideSettings | None = None
    ) -> None:
        self.units = units
        self.state = State.LEARNING
        self.time_s = math.nan  # Sample clock of the latest sample.
        self._actions = actions = GuideActions(scheme, scale or RoughScale.of_units(units), settings or GuideSettings())
        self.plan, self.detector, self.adviser = actions.plan, actions.detector, actions.adviser
        self._speaker, self._watch = actions.speaker, actions.watch
        self._builder = CellBuilder()
        self._marks: list[tuple[int, str, str | None]] = []  # Slot of the cell, action and position.
        self._feed = LiveFeed()

    @property
    def done(self) -> bool:
        """Whether nothing is left to do."""
        return self.state is State.DONE

    @property
    def finished_early(self) -> bool:
        """Whether the operator ended it with something left that was asked for."""
        return self.done and (self.plan.proposed() is not None or bool(self._actions.turns.given_up))

    @property
    def turns(self) -> tuple[int, int]:
        """How many whole turns were made, and how many are planned."""
        return self._actions.turns.made, self._actions.turns.planned

    def asked_to_finish(self) -> Marked:
        """Return the answer to a first request to finish: what there would be, and how to confirm it."""
        turned, turns = self.turns
        words = sentence(
            "guide.finish_with_turns" if turns else "guide.finish",
            accepted=len(self.plan.accepted),
            planned=len(self.plan.scheme),
            turned=turned,
            turns=turns,
        )
        return Marked(self.time_s, "finish", None, words)

    def feed(self, samples: Samples) -> list[Event]:
        """Process the next samples and return the events."""
        if not len(samples):
            return []
        if self.state is State.LOST:
            self._handle(Input.LINK_BACK)
        self.time_s = float(samples.time_s[-1])
        # Of the axes' own thermometers nothing is asked here, and samples are kept and joined.
        if samples.sensor_temperature_degc is not None:
            samples = replace(samples, sensor_temperature_degc=None)
        self._feed.hear(samples)
        self._actions.hold.history.add(samples)
        cells = self._builder.feed(samples)
        if cells is not None:
            self._process(cells)
        self._actions.hold.history.prune(self._actions.hold.history_s)
        return self._speaker.take()

    def mark(self, action: str, time_s: float, position: str | None = None) -> list[Event]:
        """Process what the operator says: retake, skip, undo, pause, finish, go_on or reopen.

        ``retake`` and ``skip`` may name a position. The mark takes effect when the cell of ``time_s`` is complete; so on replay
        all marks may be given beforehand. Without a link it takes effect at once.
        """
        if action not in ACTIONS:
            raise ValueError(f"`action` is {action!r}, not one of {', '.join(ACTIONS)}")
        if self.state in (State.LOST, State.DONE) or math.isnan(time_s):
            self._apply_mark(action, position)
        else:
            self._marks.append((int(interval_of(np.array([time_s]), CELL_S)[0]), action, position))
            self._marks.sort(key=lambda mark: mark[0])
        return self._speaker.take()

    def link_lost(self) -> list[Event]:
        """Note that no samples arrive any more; nothing measured is lost.

        The link is back with the next samples, whose clock may have started anew.
        """
        self._apply_marks_left()
        self._builder = CellBuilder()
        self._watch.forget_clock()
        self._handle(Input.LINK_LOST)
        return self._speaker.take()

    def flush(self) -> list[Event]:
        """Judge the unfinished cell: the recording ends here."""
        cells = self._builder.flush()
        if cells is not None:
            self._process(cells)
        self._apply_marks_left()
        return self._speaker.take()

    def observations(self) -> Observations:
        """Return the accepted observations, in order of acceptance."""
        with_resolution = self._watch.outputs.with_resolution
        return gather([with_resolution(observation) for observation in self.plan.accepted.values()], self.units)

    def turn_rests(self) -> Observations:
        """Return the stills between the whole turns, which the gyroscope's calibration begins and ends each turn with."""
        return gather(self._actions.turns.rests, self.units)

    def sticking(self) -> tuple[str, ...]:
        """Return a sentence for each output whose codes stick."""
        return self._watch.outputs.sticking()

    def check_axes(self) -> AxesCheck:
        """Compare the turns by accelerometer and gyroscope between the stills so far."""
        return self._watch.check_axes()

    def snapshot(self) -> Snapshot:
        """Return the state for a live view."""
        plan, hold, judgement, up = self.plan, self._actions.hold, self._actions.judgement, self._feed.up(self.detector.scale)
        target = plan.proposed() if self._actions.announced else None
        rate_hz = temperature_degc = math.nan
        recent = self._feed.newest(_RECENT_CELLS)
        if recent is not None:
            span_s = float(recent.slot[-1] - recent.slot[0] + 1) * CELL_S
            # A clock that was set back leaves no span.
            rate_hz = float(recent.count.sum()) / span_s if span_s > 0 else math.nan
            temperature_degc = float(recent.temperature_degc[-1])
        return Snapshot(
            state=self.state,
            target=None if target is None else plan.position(target).name,
            position=None if hold.position is None else plan.position(hold.position).name,
            fraction=hold.fraction,
            activity=None if judgement is None or self.state is State.LOST else self.detector.explain(judgement),
            rate_hz=rate_hz,
            lost_cells=self._watch.bad_cells,
            temperature_degc=temperature_degc,
            accepted=tuple(plan.position(i).name for i in plan.accepted),
            skipped=tuple(plan.position(i).name for i in sorted(plan.skipped)),
            suspects=self.adviser.suspect_names,
            again=tuple(plan.position(i).name for i in plan.wanted_again),
            revisiting=None if plan.revisiting is None else plan.position(plan.revisiting).name,
            planned=len(plan.scheme),
            direction=vector(up) if np.isfinite(up).all() else None,
            target_direction=None if target is None else vector(plan.position(target).direction),
            in_hand=self.detector.in_hand,
            forecast=self.adviser.forecast,
            leave_one_out_m_s2={found.name: found.leave_one_out_m_s2 for found in self.adviser.compared.values()},
            signals=self._feed.signals(self.detector.scale),
            marks=tuple(self._marks_with_effect()),
        )

    def _marks_with_effect(self) -> Iterator[str]:
        plan, known = self.plan, TABLE[self.state]
        if plan.accepted:
            yield "retake"
        if plan.proposed() is not None or self._held() is not None or self.state is State.ROLLING:
            yield "skip"
        if plan.can_undo:
            yield "undo"
        yield from (action for action, given in _INPUTS.items() if given in known and action != "reopen")
        refusal = self._actions.hold.refusal
        if refusal is not None and refusal.reason is RefusalCode.WARMING_UP and not self._watch.warmth.goes_on_cold:
            yield "go_on"

    def _process(self, cells: Cells) -> None:
        """Judge finished cells in order, each mark right after the cell in which it was made."""
        while self._marks and len(cells) and bool((cells.slot >= self._marks[0][0]).any()):
            upto = int(np.argmax(cells.slot >= self._marks[0][0])) + 1
            self._judge(cells[:upto])
            cells = cells[upto:]
            self._apply_mark(*self._marks.pop(0)[1:])
        if len(cells):
            self._judge(cells)

    def _judge(self, cells: Cells) -> None:
        self._feed.add(cells)
        # One by one while the noise floor is not known: the events must not depend on where a block was cut.
        while len(cells) and self.detector.floor is None:
            first, cells = cells[:1], cells[1:]
            self._watch.follow(first, 0, silent=self.done)
            for judgement in self.detector.judge(first):
                self._follow(judgement)
            if self.detector.floor is None:
                self._watch.explain_waiting(first)
        for judgement in self.detector.judge(cells):
            self._watch.follow(judgement.cells, judgement.row, silent=self.done)
            self._follow(judgement)

    def _follow(self, judgement: Judgement) -> None:
        """Give the state table what a cell meant."""
        self._actions.judgement = judgement
        self._speaker.advance(judgement.cells, judgement.row)
        if not self._actions.announced and Input.FLOOR in TABLE[self.state]:
            self._handle(Input.FLOOR)
        if judgement.ended is not None:
            self._handle(Input.ENDED)
            if not self.done:
                self._actions.leave_side(judgement.ended)
        if judgement.phase is Phase.STILL:
            self._handle(Input.STILL)
        else:
            self._actions.note_motion(judgement.phase)
            self._handle(Input.MOVING)
        self._watch.follow_move(judgement, len(self.plan.accepted), len(self.plan.scheme))

    def _handle(self, happened: Input) -> None:
        """Look up the transition, run its action, and handle its answer."""
        answer: Input | None = happened
        while answer is not None:
            transition = TABLE[self.state].get(answer)
            if transition is None:
                return
            self.state = transition.to
            answer = getattr(self._actions, transition.action)()

    def _apply_marks_left(self) -> None:
        """Apply the marks whose cell will not be completed any more."""
        while self._marks:
            self._apply_mark(*self._marks.pop(0)[1:])

    def _apply_mark(self, action: str, name: str | None) -> None:
        plan, now_s = self.plan, self._speaker.now_s
        if action in _INPUTS:
            self._apply_input(action)
            return
        held = self._held()
        answers = {"retake": self._retake, "skip": self._skip, "undo": self._undo, "go_on": self._go_on_cold}
        index, words = answers[action](name)
        self._speaker.say(Marked(now_s, action, None if index is None else plan.position(index).name, words))
        if action == "skip" and self.state is State.ROLLING and index is None:
            self._actions.propose_turn()
            if not self._actions.turns.left:
                self._handle(Input.COMPLETE)
        elif held is not None and (not plan.is_pending(held) or (action == "skip" and index == held)):
            self._handle(Input.UNWANTED)
        elif plan.proposed() is None:
            answer = self._actions.go_on()
            if answer is not None:
                self._handle(answer)
        elif index is not None:
            if Input.REOPENED in TABLE[self.state]:
                self.detector.restart()
                self._handle(Input.REOPENED)
            elif self._actions.announced:
                self._actions.propose()

    def _apply_input(self, action: str) -> None:
        if action == "pause" and Input.PAUSE not in TABLE[self.state]:
            self._speaker.say(Marked(self._speaker.now_s, action, None, sentence("guide.nothing_to_pause")))
        self._handle(_INPUTS[action])

    def _held(self) -> int | None:
        """Return the position of the hold under way."""
        return self._actions.hold.position if self.state is State.HOLDING else None

    def _retake(self, name: str | None) -> tuple[int | None, str]:
        last = next(reversed(self.plan.accepted), None)
        suspects = [suspect for suspect in self.adviser.suspects if suspect not in self.plan.wanted_again]
        # The line of the last one says that it is repeated where it is a suspect, be another worse.
        index = self.plan.find(name) if name else last if last in suspects or not suspects else suspects[0]
        if index is None or index not in self.plan.accepted:
            return None, sentence("guide.not_measured" if name else "guide.nothing_to_retake", position=name)
        self.plan.want_again(index)
        self._actions.resting.measure_anew(self.plan, index)
        return index, sentence("guide.retake", position=self.plan.position(index).name)

    def _skip(self, name: str | None) -> tuple[int | None, str]:
        index = self.plan.find(name) if name else self.plan.proposed() if (held := self._held()) is None else held
        if index is None and name is None and self.state is State.ROLLING:
            return None, sentence("guide.skip_turn", turn=self._actions.turns.skip().name)
        if index is None or not self.plan.is_pending(index):
            return None, sentence("guide.nothing_to_skip")
        self.plan.skip(index)
        return index, sentence("guide.skip", position=self.plan.position(index).name)

    def _go_on_cold(self, _name: str | None) -> tuple[int | None, str]:
        self._watch.warmth.goes_on_cold = True
        return None, sentence("guide.goes_on_cold")

    def _undo(self, _name: str | None) -> tuple[int | None, str]:
        undone = self.plan.undo()
        if undone is None:
            return None, sentence("guide.nothing_to_undo")
        action, index = undone
        self._actions.judge_restored(index)
        if self.plan.is_pending(index):
            self._actions.resting.measure_anew(self.plan, index)
        return index, sentence("guide.undo", action=action, position=self.plan.position(index).name)
